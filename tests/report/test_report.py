"""report.html: needs nothing but itself, shows what the run holds, says what it lacks."""

import base64
import json
import re
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.integrate import solve_ivp

from polhode.report import finding, finish_run, write_comparison, write_report
from polhode.report.motion_figures import straight_line_residual
from polhode.report.plot_style import band, packed
from polhode.report.polhode_and_inertia_figures import (
    confidence_ellipse,
    largest_k1,
    torque_free_path,
)
from polhode.report.residual_figures import rms_per_frame, sigma_found
from polhode.report.shape_figures import thin_mesh
from polhode.report.tables import (
    check_panel,
    inertia_rows,
    metric_rows,
    nees_sentences,
    run_rows,
    with_sigma,
)
from polhode.report.template import inflated
from polhode.run_directory.archives import write_measurements
from polhode.run_directory.outputs import write_estimate
from polhode.run_directory.stored_run import read_stored_run
from polhode.run_directory.summary import build_summary, read_summary
from polhode.run_directory.summary_schema import Check, Intervals
from polhode.run_directory.trajectory_file import trajectory_of
from polhode.runtime.errors import InputError
from tests.pipeline.stored_run import stored

FIGURES = [
    "polhode", "mesh", "centre-of-mass", "angular-velocity", "attitude", "inertia-ratios", "energy-momentum",
    "residual-histogram", "residual-rms", "observations", "landmarks-over-time", "sparse-map",
]  # fmt: skip


class _Page(HTMLParser):
    """Collects what a browser would load, and the figures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.figures: dict[str, Any] = {}
        self.attributes: set[str] = set()
        self.words = ""
        self._inside: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.attributes |= values.keys()
        self.loads += [f"{tag} {values[name]}" for name in ("src", "href", "data") if values.get(name)]
        if tag in ("script", "style"):
            figure = values.get("class") == "figure"
            self._inside = (values["data-target"] or "").removeprefix("plot-") if figure else ""

    def handle_endtag(self, tag: str) -> None:
        if tag in ("script", "style"):
            self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.figures[self._inside] = json.loads(inflated(data))
        elif self._inside is None:
            self.words += data


def _page(folder: Path) -> _Page:
    return _Page((folder / "report.html").read_text())


@pytest.fixture(scope="module")
def run_folder(example: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "tumbler"
    return stored(folder, example, example.surface, pictures={"frame 3": b"\x89PNG\r\n"})


def test_every_figure_is_there_and_nothing_is_loaded_from_anywhere(run_folder: Path) -> None:
    text, page = (run_folder / "report.html").read_text(), _page(run_folder)
    assert list(page.figures) == FIGURES
    assert all(figure["data"] for figure in page.figures.values())
    assert "tumbler" in page.words and "0.3042 ± 0.0020" in page.words
    assert "Images" in page.words and "Configuration" in page.words
    assert all(re.match(r"(a #|img data:image/)", load) for load in page.loads), page.loads
    assert not re.search(r"(src|href)\s*=\s*[\"'`\\]*https?://|@import|url\(\s*[\"']?http", text)
    assert "default-src 'none'" in text


def test_thinning_keeps_the_shape() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    vertices, faces, source = thin_mesh(sphere, 5000)
    assert 1500 < len(faces) <= 5000
    small = trimesh.Trimesh(vertices, faces, process=False)
    assert small.area == pytest.approx(sphere.area, rel=0.02)
    radii = np.linalg.norm(vertices, axis=1)
    assert radii.min() > 0.098 and radii.max() <= 0.1 + 1e-12
    assert np.all(np.linalg.norm(sphere.vertices[source] - vertices, axis=1) < 0.01)


def test_undetermined_is_said_in_words_and_draws_no_band(undetermined: Any, tmp_path: Path) -> None:
    page = _page(stored(tmp_path / "run", undetermined, None))
    assert "pure spin: no torque-free wobble to see" in page.words
    assert "this motion does not determine k1 and k2" in page.words
    assert "The position along y is not determined by the data: no band is drawn." in page.words
    assert "no bound" in page.words and "No surface" in page.words
    names = [trace.get("name") for trace in page.figures["inertia-ratios"]["data"]]
    assert "estimate" in names and "3σ" not in names
    assert list(page.figures) == [name for name in FIGURES if name != "mesh"]


def test_intervals_are_drawn_as_intervals(undetermined: Any, tmp_path: Path) -> None:
    shift = (None, (-0.05, 0.11), None)
    intervals = Intervals(
        com_G=((-0.15, -0.05, 0.0), (0.07, 0.01, 0.04)), com_shift_P=shift, k1=(0.0, 0.61), k2=(0.02, 2.4),
        bounds=("inside the hull", "density"),
    )  # fmt: skip
    folder = stored(tmp_path / "run", undetermined, undetermined.surface, intervals=intervals)
    page = _page(folder)
    assert "this motion does not determine k1 (from 0.00 to 0.61 is possible) and k2" in page.words
    assert "inside the hull; density." in page.words
    rows = {row.name: row for row in inertia_rows(read_summary(folder))}
    assert rows["k2 = ln(Jyy / Jzz)"].value == "from 0.02 to 2.40"
    along = rows["centre of mass, along the principal axis y"]
    assert (along.value, along.unit) == ("from -50.0 to +110.0", "mm from com_G")
    box = next(t for t in page.figures["inertia-ratios"]["data"] if t.get("name") == "possible range")
    assert np.allclose(_unpacked(box["x"]), [0.0, 0.61, 0.61, 0.0, 0.0])
    for name in ("sparse-map", "mesh"):
        drawn = [t for t in page.figures[name]["data"] if t.get("name") == "centre of mass: possible range"]
        assert len(drawn) == 1
        ends = np.stack([_unpacked(drawn[0][each]) for each in "xyz"])
        assert np.linalg.norm(ends[:, 1] - ends[:, 0]) == pytest.approx(160.0, rel=1e-4)


@pytest.mark.parametrize("tracks_found", [True, False])
def test_a_failed_run_says_why_and_what_is_missing(tracks_found: bool, example: Any, tmp_path: Path) -> None:
    tracks = example.tracks if tracks_found else None
    if tracks is not None:
        write_measurements(tracks, tmp_path / "measurements.npz")
    finish_run(tmp_path, build_summary(tracks, None, None, {}, failure="the frames <fall> apart"))
    page = _page(tmp_path)
    assert "No motion was found: the frames <fall> apart." in page.words
    assert "did not reach an estimate of the motion" in page.words
    assert list(page.figures) == (["observations", "landmarks-over-time"] if tracks_found else [])


def test_metrics_enter_when_the_report_is_made_again_unless_they_are_of_another_run(
    example: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = stored(tmp_path / "run", example, None)
    assert "Against the truth" not in _page(folder).words
    own = sha256((folder / "summary.json").read_bytes()).hexdigest()
    metrics = {"rmse_position_m": 1.25e-4, "error_k1": 0.002, "error_k2": -0.004, "nees": {"inertia": None}}
    for more in ({}, {"summary_sha256": own}, {"summary_sha256": "0" * 64}):
        is_own = more.get("summary_sha256", own) == own
        (folder / "metrics.json").write_text(json.dumps({**metrics, **more}))
        write_report(folder)
        page = _page(folder)
        truth = [each for each in page.figures["inertia-ratios"]["data"] if each.get("name") == "truth"]
        assert len(truth) == (2 if is_own else 0) and "sha256" not in page.words
        for words in ("Against the truth", "RMSE position [mm]"):
            assert (words in page.words) == is_own
        assert ("metrics.json: of another run" in caplog.text) != is_own
    assert [entry.name for entry in folder.iterdir() if entry.name.startswith(".")] == []


CHECKS = (
    Check(name="rows: step", value=0.05, limit=0.3, unit="px"),
    Check(name="shared landmarks", value=2.0, limit=6.0, at_least=True, reason="nothing connects the parts"),
    Check(name="attitudes", limit=0.1, unit="deg"),
)


def test_the_panel_of_checks_begins_with_what_is_in_doubt_and_folds_what_is_not_possible(
    example: Any, tmp_path: Path
) -> None:
    summary = build_summary(example.tracks, example.estimate, example.surface, {}, checks=CHECKS)
    panel = check_panel(summary)
    assert panel is not None
    rows = [(row.name, row.value, row.expected, row.verdict) for row in panel.rows]
    assert rows[:2] == [
        ("shared landmarks", "2", "at least 6", "doubt"),
        ("rows: step", "0.05 px", "at most 0.3 px", "holds"),
    ]
    folded = {row.name: row.expected for row in panel.impossible}
    assert folded["attitudes"] == "at most 0.1 deg"
    write_estimate(tmp_path, example.tracks, example.estimate)
    finish_run(tmp_path, summary)
    assert read_summary(tmp_path / "summary.json").checks[:3] == CHECKS
    words = _page(tmp_path).words
    assert "Can it be trusted?" in words and words.index("shared landmarks") < words.index("rows: step")
    assert f"{len(folded)} more checks are not possible with these data" in words


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../secret.png", "is no file beside it"),
        ("/etc/hostname", "is no file beside it"),
        ("absent.png", "is missing"),
    ],
)
def test_captions_name_no_other_files(example: Any, tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match="no such file"):
        write_report(tmp_path)
    folder = stored(tmp_path / "run", example, None)
    pictures = folder / "pictures"
    pictures.mkdir(exist_ok=True)
    (folder / "secret.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (pictures / "captions.json").write_text(json.dumps({name: "a caption"}))
    with pytest.raises(InputError, match=message):
        read_stored_run(folder, "run")


def test_the_finding_names_rate_axis_and_ratios(example: Any) -> None:
    summary = build_summary(example.tracks, example.estimate, example.surface, {})
    w_P = np.tile([0.0, 0.02, 1.0], (24, 1))
    path = replace(trajectory_of(example.estimate), w_P=w_P)
    assert finding(summary, path) == (
        "The target rotates at 9.55 RPM about its principal axis z (smallest moment) and drifts at 3.0 mm/s; "
        "its inertia ratios are k1 = 0.3042 ± 0.0020 and k2 = 0.2803 ± 0.0060."
    )


def test_a_value_has_the_digits_that_its_sigma_allows() -> None:
    assert with_sigma(0.031723, 0.00213) == "0.0317 ± 0.0021"
    assert with_sigma(14.238, 0.14) == "14.24 ± 0.14" and with_sigma(1234.5, 38.0) == "1234 ± 38"
    assert with_sigma(0.3, None) == with_sigma(0.3, float("inf")) == "0.3"


def test_metrics_are_listed_with_their_units_and_what_is_expected() -> None:
    metrics = {
        "rmse_velocity_m_s": 2e-4,
        "attitude_error_deg": {"median": 0.02},
        "prediction_error_m": {"10": 0.002},
        "mesh": {"completeness_3mm": 0.9},
        "nees": {"position": 3.0, "inertia": 15.4, "axes": None},
        "coverage_3sigma": {"velocity": 0.95},
        "truth_in_interval": {"k1": True, "k2": False},
    }
    assert [(row.name, row.value, row.unit, row.determined) for row in metric_rows(metrics)] == [
        ("RMSE velocity [mm/s]", "0.2", "", True),
        (
            "attitude error [deg]: median, after the constant rotation of the axes is removed",
            *("0.02", "", True),
        ),
        ("prediction error [mm]: 10 s after the last image", "2", "", True),
        ("mesh: completeness 3mm", "0.9", "", True),
        ("NEES: position", "3", "expected 0.22 to 9.35", True),
        ("NEES: inertia", "15.4", "expected 0.83 to 12.8", False),
        ("NEES: axes", "–", "", True),
        ("coverage 3sigma: velocity", "0.95", "expected 0.99 to 1", False),
        ("truth in interval: k1", "True", "expected True", True),
        ("truth in interval: k2", "False", "expected True", False),
    ]


def test_a_nees_outside_of_its_range_is_explained() -> None:
    assert nees_sentences({"nees": {"position": 3.0, "axes": None}}) == [] == nees_sentences({})
    below, above = nees_sentences({"nees": {"position": 0.15, "angular_velocity": 0.1, "inertia": 15.4}})
    assert below.startswith(
        "Below its range is the NEES of position (0.15, at least 0.22 is expected) and angular velocity (0.1,"
    )
    assert "cautious" in below
    assert above.startswith("Above its range is the NEES of inertia (15, at most 12.8 is expected)")


def test_the_histogram_has_the_noise_of_the_tables(run_folder: Path) -> None:
    content = read_stored_run(run_folder, "tumbler")
    assert content.tracks is not None and content.residuals is not None
    noise = content.summary.noise
    assert noise is not None
    sigma_px = sigma_found(content.tracks, noise)
    expected = [noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px]
    np.testing.assert_allclose(np.median(sigma_px, axis=0), expected, rtol=1e-12)
    shown = {row.name: row.value for row in run_rows(content)}
    page = _page(run_folder)
    for name in ("noise of u, v", "noise of the disparity"):
        assert page.words.count(f"{shown[name]} px of") >= 2, "in both captions"
    drawn = next(t for t in page.figures["residual-histogram"]["data"] if t["name"] == "u")
    centres, density = _unpacked(drawn["x"]), _unpacked(drawn["y"])
    normalised = content.residuals.residuals_px[:, 0] / sigma_px[:, 0]
    inside = np.abs(normalised) <= 5.0
    assert density.sum() * (centres[1] - centres[0]) == pytest.approx(np.mean(inside), rel=1e-3)
    spread = np.sqrt(np.average(centres**2, weights=density))
    assert spread == pytest.approx(np.sqrt(np.mean(normalised[inside] ** 2)), rel=0.03)


def test_the_drawn_polhode_is_the_motion_of_a_free_body(example: Any) -> None:
    moments, w0 = example.estimate.mass.moments, example.estimate.w_P[0]
    time_s = np.array([0.0, 0.5, 1.0])

    def euler(t: float, w: np.ndarray) -> np.ndarray:
        return np.asarray(-np.cross(w, moments * w) / moments)

    exact = solve_ivp(euler, (0, 1), w0, t_eval=time_s, rtol=1e-11, atol=1e-13).y.T
    path = torque_free_path(time_s, exact, moments)
    dense = solve_ivp(euler, (0, 1), w0, t_eval=np.linspace(0, 1, len(path)), rtol=1e-11, atol=1e-13).y.T
    np.testing.assert_allclose(path, dense, atol=1e-6)


def test_the_region_of_possible_bodies_ends_at_flat_ones_and_the_ellipse_is_at_its_distance() -> None:
    k2 = np.array([0.0, 0.4, 2.0])
    Jxx, Jyy, Jzz = np.exp(largest_k1(k2)), 1.0, np.exp(-k2)
    np.testing.assert_allclose(Jxx, Jyy + Jzz)
    covariance = np.array([[4.0, -1.5], [-1.5, 1.0]])
    points = confidence_ellipse(np.array([1.0, 2.0]), covariance, 3.0) - [1.0, 2.0]
    distance = np.sqrt(np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points))
    np.testing.assert_allclose(distance, 3.0)


def test_a_band_stops_at_undetermined_frames() -> None:
    traces = band(np.arange(5.0), np.zeros(5), np.array([1.0, 1.0, np.inf, np.inf, 2.0]), "#112233")
    assert [len(trace["x"]) for trace in traces] == [4, 2]
    assert max(traces[1]["y"]) == 2.0
    assert band(np.arange(2.0), np.zeros(2), np.full(2, np.inf), "#112233") == []


def _unpacked(array: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(array["bdata"]), dtype="<" + array["dtype"])


def test_packed_arrays_hold_gaps_and_a_straight_line_leaves_no_residual() -> None:
    np.testing.assert_array_equal(_unpacked(packed([1.0, np.inf, 2.5])), [1.0, np.nan, 2.5])
    assert packed(np.zeros((2, 3)))["shape"] == "2, 3"
    time_s = np.linspace(0, 10, 20)
    p = np.array([1.0, 2.0, 3.0]) + np.outer(time_s, [0.1, -0.2, 0.3])
    sigma = np.full((20, 3), 0.1)
    sigma[:, 1] = np.inf
    np.testing.assert_allclose(straight_line_residual(time_s, p, sigma), 0.0, atol=1e-12)


def test_rms_counts_inliers_only_and_bridged_frames_are_gaps(run_folder: Path, example: Any) -> None:
    content = read_stored_run(run_folder, "tumbler")
    assert content.tracks is not None and content.residuals is not None
    rms = rms_per_frame(content.tracks, content.residuals)
    here = (example.tracks.frame == 4) & (example.estimate.inlier_weight >= 0.5)
    np.testing.assert_allclose(rms[4], np.sqrt(np.mean(example.estimate.residuals_px[here] ** 2, axis=0)))
    assert np.all(np.isnan(rms[11]))


HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&"


def test_texts_of_a_run_are_shown_as_text_and_never_run(example: Any, tmp_path: Path) -> None:
    """Names, warnings, captions, configuration and metrics of a run that someone else gave."""
    run = stored(tmp_path / HOSTILE.replace("/", "_"), example, example.surface, relative=example.relative)
    content = json.loads((run / "summary.json").read_text())
    content["warnings"] = [HOSTILE]
    del content["own_sha256"]
    content["checks"] = [{"name": HOSTILE, "value": 1.0, "limit": 0.0, "unit": HOSTILE, "reason": HOSTILE}]
    content["identifiable_detail"] = {HOSTILE: "not " + HOSTILE}
    content["solver"] |= {"name": HOSTILE, "message": HOSTILE, "runner_up": {HOSTILE: 1.0}}
    (run / "summary.json").write_text(json.dumps(content))
    (run / "metrics.json").write_text(json.dumps({HOSTILE: HOSTILE, "b": {HOSTILE: 1.0, "list": [HOSTILE]}}))
    (run / "config.yaml").write_text(f"# </pre></script>{HOSTILE}\n")
    (run / "pictures").mkdir(exist_ok=True)
    Image.new("L", (8, 8)).save(run / "pictures" / "a.png")
    (run / "pictures" / "captions.json").write_text(json.dumps({"a.png": HOSTILE}))
    pages = [tmp_path / "one.html", tmp_path / "two.html"]
    write_report(run, pages[0])
    write_comparison([run, run], pages[1])
    for page in pages:
        text = page.read_text()
        assert "<script>alert" not in text and "<img src=x" not in text
        assert "&lt;script&gt;alert(1)" in text
        elements = _Page(text)
        assert "onerror" not in elements.attributes and "img x" not in elements.loads
