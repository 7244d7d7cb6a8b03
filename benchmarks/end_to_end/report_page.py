"""What a run's report costs its reader: size, time to the first view and to the figures, overflow, contrast.

    python -m benchmarks.end_to_end.report_page RUN [--repeats 3]

Headless Chromium opens the page from the disk, without a graphics processor: three-dimensional figures are
drawn by the processor. Times are those of the clock, from the start of the navigation, and the processor time
of all processes of the browser beside them, which a loaded machine changes less.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from benchmarks.command import command

if TYPE_CHECKING:
    from playwright.sync_api import Browser, CDPSession, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZES_PX = ((390, 844), (1400, 900), (2560, 1440))
"""A phone, a laptop, a large screen"""
SCHEMES = ("light", "dark")
OPTIONS = (
    "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
TIMEOUT_MS = 120_000

OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
CONTRAST = """() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (color) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = color;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const luminance = (color) => color.slice(0, 3).reduce((sum, each, k) => {
    const part = each / 255;
    const light = part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
    return sum + [0.2126, 0.7152, 0.0722][k] * light;
  }, 0);
  const ground = (node) => {
    for (let each = node; each; each = each.parentElement) {
      const color = rgba(getComputedStyle(each).backgroundColor);
      if (color[3] > 127) return color;
    }
    return [255, 255, 255, 255];
  };
  let least = [99, ""];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
    if (!text || node.closest("script, style, noscript, svg, .js-plotly-plot")) continue;
    if (!node.checkVisibility()) continue;
    const pair = [luminance(rgba(getComputedStyle(node).color)), luminance(ground(node))];
    pair.sort((a, b) => a - b);
    const contrast = (pair[1] + 0.05) / (pair[0] + 0.05);
    if (contrast < least[0]) least = [contrast, text.slice(0, 40)];
  }
  return least;
}"""
"""Least contrast of a text with what is behind it, and the text (WCAG 2 asks for 4.5)."""


@dataclass(frozen=True)
class Opening:
    """Seconds from the start of the navigation, and processor seconds of the browser."""

    first_view_s: float
    in_view_s: float
    """until every figure in view is drawn"""
    all_s: float
    """until every figure of the page is drawn, without scrolling"""
    first_view_cpu_s: float
    in_view_cpu_s: float
    all_cpu_s: float


def browser_path() -> str | None:
    """The browser: $CHROMIUM, or the first of ``BROWSERS`` that is installed; None: there is none."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def headless() -> "Iterator[Browser]":
    """A browser without a window. Raises SystemExit where there is none."""
    from playwright.sync_api import sync_playwright

    path = browser_path()
    if path is None:
        raise SystemExit(f"there is no browser: install one of {', '.join(BROWSERS)}, or set CHROMIUM")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(OPTIONS))
        try:
            yield browser
        finally:
            browser.close()


def draw_all(page: "Page") -> None:
    """Draw what is not in view, too."""
    page.evaluate("polhodeReport.drawAll()")
    page.wait_for_function("document.body.dataset.drawn === 'yes'", timeout=TIMEOUT_MS)


def opened(browser: "Browser", address: str, size_px: tuple[int, int], scheme: str) -> Opening:
    """Open the page once and close it."""
    session = browser.new_browser_cdp_session()
    choice: Any = scheme
    context = browser.new_context(viewport={"width": size_px[0], "height": size_px[1]}, color_scheme=choice)
    try:
        page = context.new_page()
        start = _cpu_s(session)
        page.goto(address, wait_until="commit")
        page.wait_for_function("performance.getEntriesByName('first-contentful-paint').length", polling=20)
        first = _cpu_s(session)
        page.wait_for_function("document.body?.dataset.shown", timeout=TIMEOUT_MS, polling=20)
        shown = _cpu_s(session)
        draw_all(page)
        everything = _cpu_s(session)
        paint_ms, shown_ms, now_ms = page.evaluate(
            "[performance.getEntriesByName('first-contentful-paint')[0].startTime,"
            " Number(document.body.dataset.shown), performance.now()]"
        )
    finally:
        context.close()
    return Opening(
        1e-3 * paint_ms,
        1e-3 * shown_ms,
        1e-3 * now_ms,
        first - start,
        shown - start,
        everything - start,
    )


def _cpu_s(session: "CDPSession") -> float:
    processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
    return float(sum(each["cpuTime"] for each in processes))


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    repeats: Annotated[int, arg(help="Openings of each size and scheme; medians are printed.")] = 3,
) -> None:
    """Print the table."""
    file = run / "report.html"
    if not file.is_file():
        raise SystemExit(f"{file}: no such report")
    address = file.resolve().as_uri()
    load, processors = os.getloadavg()[0], os.cpu_count()
    print(f"size {file.stat().st_size / 1e6:.2f} MB; load of the machine {load:.1f}, {processors} processors")
    print("seconds by the clock (processor seconds); contrast: least of all texts")
    heads = "".join(f"{each:>15}" for each in ("first view", "in view", "all figures"))
    print(f"{'size':>10} {'scheme':>6}{heads} {'overflow':>9} {'contrast':>9}")
    with headless() as browser:
        for size_px in SIZES_PX:
            for scheme in SCHEMES:
                times = [opened(browser, address, size_px, scheme) for _ in range(repeats)]
                overflow_px, contrast = _looks(browser, address, size_px, scheme)
                cells = "".join(f"{_cell(times, each):>15}" for each in ("first_view", "in_view", "all"))
                size = f"{size_px[0]}x{size_px[1]}"
                print(f"{size:>10} {scheme:>6}{cells} {overflow_px:>6} px {contrast:>9.1f}")


def _cell(times: list[Opening], name: str) -> str:
    wall, cpu = (median(getattr(each, f"{name}{kind}") for each in times) for kind in ("_s", "_cpu_s"))
    return f"{wall:.2f} ({cpu:.2f})"


def _looks(browser: "Browser", address: str, size_px: tuple[int, int], scheme: str) -> tuple[int, float]:
    """Overflow [px] with everything drawn, and the least contrast of a text."""
    choice: Any = scheme
    context = browser.new_context(viewport={"width": size_px[0], "height": size_px[1]}, color_scheme=choice)
    try:
        page = context.new_page()
        page.goto(address)
        draw_all(page)
        return int(page.evaluate(OVERFLOW)), float(page.evaluate(CONTRAST)[0])
    finally:
        context.close()


if __name__ == "__main__":
    command(main)
