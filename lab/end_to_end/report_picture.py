"""A part of a run's report, as a browser shows it, for the documentation.

    python -m lab.end_to_end.report_picture RUN --rows 0 1700 [--columns 240 1200] -o PNG

Needs Chromium and playwright (``pip install 'polhode[browser]'``). Every figure is drawn; rows and columns
are pixels of the page from its upper left. ``--section`` takes a whole section or figure instead, by its id
in the page: ``checks``, ``plot-inertia-ratios``; then its figures alone are drawn.
"""

import io
from pathlib import Path
from typing import Annotated

from PIL import Image
from tyro.conf import Positional, arg

from lab.command import command
from tests.browser import draw_all, headless

WIDTH_PX, HEIGHT_PX = 1200, 1000
"""Of the window; the page is longer, and its bar at the lower edge is hidden."""
STILL = ".clock, .moment { display: none !important } * { animation: none !important }"


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="The picture.")],
    rows: Annotated[tuple[int, int], arg(help="First and last row of the page [px].")] = (0, 1700),
    columns: Annotated[tuple[int, int], arg(help="First and last column.")] = (0, WIDTH_PX),
    section: Annotated[str | None, arg(help="Id of a section or figure, instead.")] = None,
) -> None:
    """Write the picture. Raises SystemExit: no report, no browser, or no such section."""
    file = run / "report.html"
    if not file.is_file():
        raise SystemExit(f"{file}: no such report")
    with headless() as browser:
        page = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX}, color_scheme="light")
        page.goto(file.resolve().as_uri())
        shown = page.locator("body" if section is None else f"[id='{section}']")
        if shown.count() == 0:
            ids = page.evaluate("[...document.querySelectorAll('.section')].map(each => each.id)")
            raise SystemExit(f"{section}: no such section; there are {', '.join(ids)}")
        if section is None:
            draw_all(page)
        else:
            page.evaluate("id => polhodeReport.drawAll(document.getElementById(id))", section)
        page.add_style_tag(content=STILL)
        content = page.screenshot(full_page=True) if section is None else shown.screenshot()
    with Image.open(io.BytesIO(content)) as image:
        part = image.convert("RGB")
    if section is None:
        part = part.crop((columns[0], rows[0], columns[1], rows[1]))
    output.parent.mkdir(parents=True, exist_ok=True)
    part.quantize(256).save(output, optimize=True)


if __name__ == "__main__":
    command(main)
