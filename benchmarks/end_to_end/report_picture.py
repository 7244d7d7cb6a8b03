"""A part of a run's report, as a browser shows it, for the documentation.

    python -m benchmarks.end_to_end.report_picture RUN --rows 0 1700 [--columns 240 1200] -o PNG

Chromium renders the page without a window, with every figure drawn; rows and columns are pixels of the page
from its upper left. ``--section`` takes a whole section or figure instead, by its id in the page: ``checks``,
``plot-inertia-ratios``; then its figures alone are drawn.
"""

import io
from pathlib import Path
from typing import Annotated

from PIL import Image
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.end_to_end.report_page import draw_all, headless

HEIGHT_PX = 1000
"""Of the window; the page is longer, and its bar at the lower edge is hidden."""
STILL = ".clock, .moment { display: none !important } * { animation: none !important }"


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="The picture.")],
    rows: Annotated[tuple[int, int], arg(help="First and last row of the page [px].")] = (0, 1700),
    width: Annotated[int, arg(help="Of the page [px].")] = 1200,
    columns: Annotated[
        tuple[int, int] | None, arg(help="First and last column; all of them unless given.")
    ] = None,
    section: Annotated[
        str | None, arg(help="Instead of rows and columns: id of a section or a figure.")
    ] = None,
) -> None:
    """Write the picture."""
    page = run / "report.html"
    left, right = columns or (0, width)
    if not page.is_file():
        raise SystemExit(f"{page}: no such report")
    with Image.open(io.BytesIO(whole_page(page, width, section))) as image:
        part = image.convert("RGB")
    if section is None:
        part = part.crop((left, rows[0], right, rows[1]))
    output.parent.mkdir(parents=True, exist_ok=True)
    part.quantize(256).save(output, optimize=True)
    print(output)


def whole_page(file: Path, width_px: int, section: str | None) -> bytes:
    """The page, or a section of it, as a PNG. Raises SystemExit: no browser, or no such section."""
    with headless() as browser:
        page = browser.new_page(viewport={"width": width_px, "height": HEIGHT_PX}, color_scheme="light")
        page.goto(file.resolve().as_uri())
        if section is None:
            draw_all(page)
            page.add_style_tag(content=STILL)
            return page.screenshot(full_page=True)
        found = page.locator(f"[id='{section}']")
        if found.count() == 0:
            ids = page.evaluate("[...document.querySelectorAll('.section')].map(each => each.id)")
            raise SystemExit(f"{section}: no such section; there are {', '.join(ids)}")
        page.evaluate("id => polhodeReport.drawAll(document.getElementById(id))", section)
        page.add_style_tag(content=STILL)
        return found.screenshot()


if __name__ == "__main__":
    command(main)
