"""report.html in a browser: what it draws, moves, folds and prints, at three widths and in both schemes.

The stored pictures are coarse: a cell of ``CELL_PX`` pixels of the page is one of theirs. After an intended
change they are renewed, to be looked at before they are committed, by

    RENEW_PICTURES=1 python -m pytest tests/pipeline/report/test_page_in_browser.py
"""

import base64
import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from PIL import Image

from polhode.config import Config
from polhode.pipeline.report import write_comparison, write_report
from polhode.pipeline.run_directory.film import GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX
from polhode.pipeline.run_directory.outputs import write_online_estimate
from tests.browser import CONTRAST, OVERFLOW, browser_path, draw_all, headless
from tests.pipeline.report.test_convergence import online_of
from tests.pipeline.stored_run import write_run

pytestmark = pytest.mark.skipif(browser_path() is None, reason="no Chromium; .ci/run installs it")

STORED = Path(__file__).with_name("pictures")
WIDTHS_PX = (390, 1400, 2560)
CELL_PX = 24
PIXELS_OF_A_PX = 0.25
"""Fewer pixels than a screen has, and the same layout: the stored pictures are coarser still."""
MAX_MEAN, MAX_HIGH = 3.0, 60.0
"""Largest mean and 99.5th percentile of the differences from a stored picture [8-bit levels]."""
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
    folder.mkdir()
    write_online_estimate(folder, online_of(example.estimate))
    _write_film(folder / "pictures")
    write_run(
        folder, config=Config(), tracks=example.tracks, estimate=example.estimate, surface=example.surface,
        timing_s={"frontend": 12.0}, warnings=["the calibration was taken as right"],
        pictures={"frame 0: 150 inliers (blue)": _png(np.full((90, 90), 70, dtype=np.uint8))},
    )  # fmt: skip
    (folder / "metrics.json").write_text('{"rmse_position_m": 1e-4, "mesh": {"chamfer_mm": 0.4}}')
    write_report(folder)
    return folder


def _write_film(folder: Path) -> None:
    """A film in which a bright square moves to the right, one picture for each of ``FRAMES``."""
    folder.mkdir()
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
def same_font(run_folder: Path) -> str:
    """The address of the page with the font that matplotlib ships: the same picture on every machine."""
    font = (Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf").read_bytes()
    face = f"data:font/ttf;base64,{base64.b64encode(font).decode('ascii')}"
    style = f"@font-face {{ font-family: Same; src: url({face}); }} * {{ font-family: Same !important; }}"
    text = (run_folder / "report.html").read_text()
    text = text.replace("default-src 'none'", "default-src 'none'; font-src data:", 1)
    copy = run_folder.parent / "same_font.html"
    copy.write_text(text.replace("</style>", style + "</style>", 1))
    return copy.as_uri()


@pytest.fixture(scope="module")
def pages(browser: Any, same_font: str) -> Iterator[dict[str, Opened]]:
    """The page in both schemes, everything drawn."""
    found = {scheme: _opened(browser, same_font, scheme) for scheme in ("light", "dark")}
    for each in found.values():
        each.page.evaluate("document.fonts.ready")
        draw_all(each.page)
    yield found
    for each in found.values():
        each.page.context.close()


def _opened(browser: Any, address: str, scheme: str = "light", script: bool = True) -> Opened:
    context = browser.new_context(
        viewport={"width": WIDTHS_PX[0], "height": 900},
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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", WIDTHS_PX)
def test_the_page_looks_as_stored(width_px: int, scheme: str, pages: dict[str, Opened]) -> None:
    page = pages[scheme].page
    page.set_viewport_size({"width": width_px, "height": 900})
    page.evaluate("scrollTo(0, 0)")
    draw_all(page)
    assert page.evaluate(OVERFLOW) == 0
    with Image.open(io.BytesIO(page.screenshot(full_page=True))) as whole:
        size = (width_px // CELL_PX, round(whole.height * width_px / whole.width / CELL_PX))
        cells = np.asarray(whole.convert("RGB").resize(size, Image.Resampling.BOX))
    file = STORED / f"{width_px}_{scheme}.png"
    if os.environ.get("RENEW_PICTURES"):
        STORED.mkdir(exist_ok=True)
        Image.fromarray(cells).save(file, optimize=True)
    with Image.open(file) as stored:
        assert abs(stored.height - size[1]) <= 0.02 * stored.height
        expected = np.asarray(stored.convert("RGB").resize(size, Image.Resampling.BOX), dtype=np.float64)
    away = np.abs(cells - expected)
    assert away.mean() < MAX_MEAN and np.percentile(away, 99.5) < MAX_HIGH


def test_nothing_fails_and_nothing_is_loaded(pages: dict[str, Opened], same_font: str) -> None:
    for each in pages.values():
        assert each.errors == []
        assert [url for url in each.requests if not url.startswith("data:")] == [same_font]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read(scheme: str, pages: dict[str, Opened]) -> None:
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


def test_contents_stay_in_view_and_open_what_is_folded(pages: dict[str, Opened]) -> None:
    page = pages["light"].page
    page.set_viewport_size({"width": 1400, "height": 900})
    page.locator("#truth > summary").click()
    assert not page.locator("#truth table").first.is_visible()
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    link = page.locator(".side a", has_text="Against the truth")
    assert page.evaluate("document.querySelector('.side').getBoundingClientRect().top") > -1
    link.click()
    assert page.locator("#truth table").first.is_visible()
    # What the numbers mean is said where they stand.
    page.locator("#truth .terms summary").last.click()
    assert "mean of accuracy and completion" in page.locator("#truth").inner_text()


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


def test_what_is_not_in_view_is_drawn_for_a_print(browser: Any, run_folder: Path) -> None:
    opened = _opened(browser, (run_folder / "report.html").as_uri())
    drawn = "document.querySelectorAll('.drawing:is(.js-plotly-plot, :has(canvas.sketch))').length"
    opened.page.wait_for_function(f"{drawn} === document.querySelectorAll('.drawing').length", timeout=60_000)
    assert opened.page.evaluate("scrollY") == 0 and opened.errors == []
    opened.page.context.close()


def test_the_figures_of_a_part_are_drawn_without_the_others(browser: Any, run_folder: Path) -> None:
    opened = _opened(browser, (run_folder / "report.html").as_uri())
    for name, part in (("plot-polhode", ""), ("plot-residual-rms", ".closest('.section')")):
        opened.page.evaluate(f"polhodeReport.drawAll(document.getElementById('{name}'){part})")
        assert opened.page.locator(f"#{name}.js-plotly-plot").count() == 1
    assert opened.page.locator("#plot-mesh.js-plotly-plot").count() == 0
    opened.page.context.close()


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
