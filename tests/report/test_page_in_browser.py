"""report.html in a browser: what it draws, moves, folds and prints, in both schemes."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.report import write_comparison
from tests.browser import CONTRAST, OVERFLOW, browser_path, draw_all, headless

pytestmark = pytest.mark.skipif(browser_path() is None, reason="no Chromium; .ci/run installs it")

STATE = """() => ({
    picture: document.getElementById("film").src,
    eye: Object.values(document.getElementById("plot-mesh").layout.scene.camera.eye),
    point: Number(document.getElementById("plot-polhode").data.at(-1).x[0]),
    line: document.querySelector("#plot-centre-of-mass ~ .moment").style.left,
    words: document.querySelector(".clock output").textContent,
})"""
SKETCH = """name => {
    const canvas = document.querySelector("#plot-" + name + " canvas.sketch");
    return Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
}"""
NOTE_TEXTS = """() => {
    window.texts = [];
    CanvasRenderingContext2D.prototype.fillText = text => texts.push(text);
}"""
GROUND = "document.getElementById('plot-attitude').layout.plot_bgcolor"


@contextmanager
def opened(browser: Any, file: Path, script: bool = True) -> Iterator[Any]:
    """The page at a quarter of a screen's pixels; nothing fails in it, and nothing else is loaded."""
    size = {"width": 390, "height": 2400}
    more = {"color_scheme": "light", "java_script_enabled": script, "device_scale_factor": 0.25}
    page = browser.new_context(viewport=size, **more).new_page()
    errors: list[str] = []
    requests: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: requests.append(request.url))
    page.goto(file.as_uri())
    yield page
    assert errors == [] and [url for url in requests if not url.startswith("data:")] == [file.as_uri()]
    page.context.close()


def require_readable(page: Any) -> None:
    assert page.evaluate(OVERFLOW) == 0
    contrast, text = page.evaluate(CONTRAST)
    assert contrast >= 4.5, text


def test_the_page_of_a_run(run_folder: Path, tmp_path: Path) -> None:
    with headless() as browser:
        with opened(browser, run_folder / "report.html", script=False) as page:
            # tables and pictures need no script
            assert page.locator("#numbers table").first.is_visible()
            assert page.locator("#film").bounding_box()["height"] > 50
            assert page.locator(".plot").first.inner_text() == "This figure needs JavaScript."
            assert not page.locator(".clock").is_visible()
        with opened(browser, run_folder / "report.html") as page:
            solid_figures_are_flat_until_they_are_touched(page)
            draw_all(page)
            require_readable(page)
            page.set_viewport_size({"width": 1400, "height": 4000})
            draw_all(page)
            one_slider_moves_picture_body_polhode_and_plots(page)
            page.locator("#plot-attitude").scroll_into_view_if_needed()
            page.locator(".side .switch").click()
            assert page.evaluate("document.documentElement.dataset.scheme") == "dark"
            page.wait_for_function(f"{GROUND} !== '#ffffff'")
            require_readable(page)
            print_is_light_unfolded_and_as_wide_as_the_paper(page)
        write_comparison([run_folder, run_folder], tmp_path / "two.html")
        with opened(browser, tmp_path / "two.html") as page:
            draw_all(page)
            require_readable(page)


def solid_figures_are_flat_until_they_are_touched(page: Any) -> None:
    for name in ("mesh", "polhode"):
        page.wait_for_selector(f"#plot-{name} canvas.sketch")
    assert page.locator("#plot-mesh.js-plotly-plot").count() == 0
    page.wait_for_selector(".clock:not([hidden])")
    for name in ("mesh", "polhode"):
        page.locator(".clock input").fill("0")
        first = np.array(page.evaluate(SKETCH, name)).reshape(-1, 4)
        assert 0.03 < np.mean(first[:, 3] > 0) < 0.9, "the body, and the paper around it"
        page.locator(".clock input").fill("12")
        assert np.any(np.array(page.evaluate(SKETCH, name)).reshape(-1, 4) != first), "the slider moves it"
    page.evaluate(NOTE_TEXTS)
    page.locator(".clock input").fill("3")
    numbers = {text for text in page.evaluate("texts") if re.fullmatch("\u2212?[0-9.]+", text)}
    assert {"\u221250", "0", "50"} <= numbers, "on the axes"
    page.locator("#plot-mesh .turn").click()
    page.wait_for_selector("#plot-mesh.js-plotly-plot canvas")
    assert page.locator("#plot-mesh canvas.sketch").count() == 0
    assert page.locator("#plot-sparse-map.js-plotly-plot").count() == 0, "one at a time"


def one_slider_moves_picture_body_polhode_and_plots(page: Any) -> None:
    states = []
    for frame in ("0", "23"):
        page.locator(".clock input").fill(frame)
        states.append(page.evaluate(STATE))
    first, last = states
    assert first["words"] == "frame 1 of 24, 0.0 s" and last["words"] == "frame 24 of 24, 11.5 s"
    assert first["picture"] != last["picture"] and first["picture"].startswith("data:image/webp;base64,")
    assert np.linalg.norm(np.subtract(first["eye"], last["eye"])) > 0.1
    assert abs(first["point"] - last["point"]) > 1e-3
    assert float(last["line"].removesuffix("px")) > float(first["line"].removesuffix("px")) + 100


def print_is_light_unfolded_and_as_wide_as_the_paper(page: Any) -> None:
    page.evaluate(
        "addEventListener('beforeprint', () => { window.seen = ["
        "document.querySelectorAll('details:not([open]):not(.menu)').length,"
        "document.getElementById('plot-attitude').layout.plot_bgcolor,"
        "document.getElementById('plot-centre-of-mass').layout.width] })"
    )
    paper = page.pdf(prefer_css_page_size=True, print_background=True)
    folded, ground, width_px = page.evaluate("seen")
    assert (folded, ground) == (0, "#ffffff") and 900 < width_px < 1100
    assert 6 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 30
    assert not page.locator("#configuration pre").is_visible(), "folded again"
