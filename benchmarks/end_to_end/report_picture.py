"""A part of a run's report, as a browser shows it, for the documentation.

    python -m benchmarks.end_to_end.report_picture RUN --rows 0 1700 [--columns 240 1200] -o PNG

Chromium renders the page without a window; rows and columns are pixels of the page from its upper left.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

from PIL import Image
from tyro.conf import Positional, arg

from benchmarks.command import command

BELOW_PX = 100
"""More of the page than is shown: a bar at the lower edge of the window is cut away"""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="The picture.")],
    rows: Annotated[tuple[int, int], arg(help="First and last row of the page [px].")] = (0, 1700),
    width: Annotated[int, arg(help="Of the page [px].")] = 1200,
    columns: Annotated[
        tuple[int, int] | None, arg(help="First and last column; all of them unless given.")
    ] = None,
) -> None:
    """Write the picture."""
    page, browser = run / "report.html", next(filter(None, map(shutil.which, BROWSERS)), None)
    left, right = columns or (0, width)
    if not page.is_file():
        raise SystemExit(f"{page}: no such report")
    if browser is None:
        raise SystemExit(f"there is no browser: install one of {', '.join(BROWSERS)}")
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "page.png"
        words = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        # the plots are drawn by the page's own scripts
        words += ["--virtual-time-budget=20000", f"--screenshot={whole}"]
        words += [f"--window-size={width},{rows[1] + BELOW_PX}"]
        subprocess.run([*words, page.resolve().as_uri()], check=True, capture_output=True)
        with Image.open(whole) as image:
            part = image.convert("RGB").crop((left, rows[0], right, rows[1]))
        output.parent.mkdir(parents=True, exist_ok=True)
        part.quantize(128).save(output, optimize=True)
    print(output)


if __name__ == "__main__":
    command(main)
