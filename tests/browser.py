"""A report in headless Chromium, from the disk and without a graphics processor; the layout of its texts."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
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
