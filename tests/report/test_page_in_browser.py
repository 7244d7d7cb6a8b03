"""report.html in a browser: what it draws, moves, folds and prints, in both schemes."""

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.report import write_comparison, write_report
from polhode.run_directory.film import GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX
from tests.browser import CONTRAST, OVERFLOW, browser_path, draw_all, headless
from tests.pipeline.stored_run import stored
from tests.report.test_convergence import online_of

pytestmark = pytest.mark.skipif(browser_path() is None, reason="no Chromium; .ci/run installs it")

WIDTH_PX = 390
PIXELS_OF_A_PX = 0.25
"""Fewer pixels than a screen has, and the same layout"""
FRAMES = (0, 8, 16, 23)
"""Of the film"""


@dataclass
class Opened:
    """A page of the browser, and what went wrong in it."""

    page: Any
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with headless() as started:
        yield started


@pytest.fixture(scope="module")
def run_folder(example: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with everything that a report shows but masks."""
    folder = tmp_path_factory.mktemp("browser") / "tumbler"
    _write_film(folder / "pictures")
    stored(
        folder, example, example.surface, online_of(example.estimate),
        timing_s={"frontend": 12.0}, warnings=["the calibration was taken as right"],
        pictures={"frame 0: 150 inliers (blue)": _png(np.full((90, 90), 70, dtype=np.uint8))},
    )  # fmt: skip
    (folder / "metrics.json").write_text('{"rmse_position_m": 1e-4, "mesh": {"chamfer_mm": 0.4}}')
    write_report(folder)
    return folder


def _write_film(folder: Path) -> None:
    """A film in which a bright square moves to the right, one picture for each of ``FRAMES``."""
    folder.mkdir(parents=True)
    width = round(GIF_SCALE * (3 * PANEL_PX + 2 * GAP_PX))
    pictures = []
    for k in range(len(FRAMES)):
        picture = np.full((round(GIF_SCALE * (HEAD_PX + PANEL_PX + 54)), width), 30, dtype=np.uint8)
        picture[100:150, 20 + 60 * k : 70 + 60 * k] = 220
        pictures.append(Image.fromarray(picture).convert("P"))
    pictures[0].save(folder / "model.gif", save_all=True, append_images=pictures[1:], duration=100)
    rows = [f"{frame},0,1" for frame in FRAMES]
    (folder / "model.csv").write_text("\n".join(["frame,timestamp_ns,sunlit", *rows]) + "\n")


def _png(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


@pytest.fixture(scope="module")
def pages(browser: Any, run_folder: Path) -> Iterator[dict[str, Opened]]:
    """The page in both schemes, everything drawn."""
    found = {
        scheme: _opened(browser, (run_folder / "report.html").as_uri(), scheme)
        for scheme in ("light", "dark")
    }
    for each in found.values():
        draw_all(each.page)
    yield found
    for each in found.values():
        each.page.context.close()


def _opened(browser: Any, address: str, scheme: str = "light", script: bool = True) -> Opened:
    context = browser.new_context(
        viewport={"width": WIDTH_PX, "height": 900},
        color_scheme=scheme,
        java_script_enabled=script,
        device_scale_factor=PIXELS_OF_A_PX,
    )
    opened = Opened(context.new_page())
    opened.page.on("pageerror", lambda error: opened.errors.append(str(error)))
    opened.page.on(
        "console", lambda message: opened.errors.append(message.text) if message.type == "error" else None
    )
    opened.page.on("request", lambda request: opened.requests.append(request.url))
    opened.page.goto(address)
    return opened


def test_nothing_fails_and_nothing_is_loaded(pages: dict[str, Opened], run_folder: Path) -> None:
    for each in pages.values():
        assert each.errors == []
        assert [url for url in each.requests if not url.startswith("data:")] == [
            (run_folder / "report.html").as_uri()
        ]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_fits_and_can_be_read(scheme: str, pages: dict[str, Opened]) -> None:
    assert pages[scheme].page.evaluate(OVERFLOW) == 0
    contrast, text = pages[scheme].page.evaluate(CONTRAST)
    assert contrast >= 4.5, text


def test_one_slider_moves_picture_body_polhode_and_plots(pages: dict[str, Opened]) -> None:
    page = pages["light"].page
    page.set_viewport_size({"width": 1400, "height": 4000})
    draw_all(page)
    state = """() => ({
        picture: document.getElementById("film").src,
        eye: Object.values(document.getElementById("plot-mesh").layout.scene.camera.eye),
        point: Number(document.getElementById("plot-polhode").data.at(-1).x[0]),
        line: document.querySelector("#plot-centre-of-mass ~ .moment").style.left,
        words: document.querySelector(".clock output").textContent,
    })"""
    slider = page.locator(".clock input")
    slider.fill("0")
    first = page.evaluate(state)
    slider.fill("23")
    last = page.evaluate(state)
    assert first["words"] == "frame 1 of 24, 0.0 s" and last["words"] == "frame 24 of 24, 11.5 s"
    assert first["picture"] != last["picture"] and first["picture"].startswith("data:image/webp;base64,")
    assert np.linalg.norm(np.subtract(first["eye"], last["eye"])) > 0.1
    assert abs(first["point"] - last["point"]) > 1e-3
    assert float(last["line"].removesuffix("px")) > float(first["line"].removesuffix("px")) + 100


def test_the_switch_changes_the_scheme_and_the_figures(pages: dict[str, Opened]) -> None:
    page = pages["dark"].page
    page.set_viewport_size({"width": 1400, "height": 900})
    ground = "document.getElementById('plot-attitude').layout.plot_bgcolor"
    page.locator("#plot-attitude").scroll_into_view_if_needed()
    before = page.evaluate(ground)
    assert before != "#ffffff"
    page.locator(".side .switch").click()
    assert page.evaluate("document.documentElement.dataset.scheme") == "light"
    page.wait_for_function(f"{ground} === '#ffffff'")
    page.locator(".side .switch").click()
    page.wait_for_function(f"{ground} === '{before}'")


def test_print_is_light_unfolded_and_as_wide_as_the_paper(pages: dict[str, Opened]) -> None:
    page = pages["dark"].page
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


def test_solid_figures_are_flat_until_they_are_touched(browser: Any, run_folder: Path) -> None:
    opened = _opened(browser, (run_folder / "report.html").as_uri())
    page = opened.page
    page.set_viewport_size({"width": 1400, "height": 2400})
    page.wait_for_selector("#plot-mesh canvas.sketch")
    page.wait_for_selector("#plot-polhode canvas.sketch")
    assert page.locator("#plot-mesh.js-plotly-plot").count() == 0
    pixels = """name => {
        const canvas = document.querySelector("#plot-" + name + " canvas.sketch");
        return Array.from(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data);
    }"""
    page.wait_for_selector(".clock:not([hidden])")
    for name in ("mesh", "polhode"):
        page.locator(".clock input").fill("0")
        first = np.array(page.evaluate(pixels, name)).reshape(-1, 4)
        assert 0.03 < np.mean(first[:, 3] > 0) < 0.9, "the body, and the paper around it"
        page.locator(".clock input").fill("12")
        assert np.any(np.array(page.evaluate(pixels, name)).reshape(-1, 4) != first), "the slider moves it"
    page.locator("#plot-mesh .turn").click()
    page.wait_for_selector("#plot-mesh.js-plotly-plot canvas")
    assert page.locator("#plot-mesh canvas.sketch").count() == 0
    assert page.locator("#plot-sparse-map.js-plotly-plot").count() == 0, "one at a time"
    page.wait_for_selector("#plot-attitude.js-plotly-plot", timeout=60_000)
    assert opened.errors == []
    page.context.close()


def test_tables_and_pictures_need_no_script(browser: Any, run_folder: Path) -> None:
    opened = _opened(browser, (run_folder / "report.html").as_uri(), script=False)
    page = opened.page
    assert page.locator("#numbers table").first.is_visible() and page.locator("#film").is_visible()
    assert page.locator("#film").bounding_box()["height"] > 50
    assert page.locator(".plot").first.inner_text() == "This figure needs JavaScript."
    assert not page.locator(".clock").is_visible()
    page.context.close()


def test_the_page_about_several_runs_fits_a_phone(browser: Any, run_folder: Path, tmp_path: Path) -> None:
    write_comparison([run_folder, run_folder], tmp_path / "two.html")
    opened = _opened(browser, (tmp_path / "two.html").as_uri(), "dark")
    opened.page.set_viewport_size({"width": 390, "height": 844})
    draw_all(opened.page)
    assert opened.page.evaluate(OVERFLOW) == 0 and opened.errors == []
    assert opened.page.evaluate(CONTRAST)[0] >= 4.5
    opened.page.context.close()
