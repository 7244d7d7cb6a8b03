"""report.html of one run or of several: needs nothing else, shows what a run holds, says what it lacks."""

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

from polhode.cli.main import main
from polhode.config.backend_settings import Backend
from polhode.pipeline.uniform_density import assumed_properties
from polhode.records.estimate import Disturbances, Impulse
from polhode.report import finding, finish_run, write_comparison, write_report
from polhode.report.comparison import NO_VALUE, side_by_side
from polhode.report.convergence_figures import convergence_figures
from polhode.report.motion_figures import straight_line_residual
from polhode.report.plot_style import BAND, Figure, on
from polhode.report.polhode_and_inertia_figures import confidence_ellipse, largest_k1, torque_free_path
from polhode.report.residual_figures import rms_per_frame, sigma_found
from polhode.report.shape_figures import thin_mesh
from polhode.report.tables import check_rows, inertia_rows, metric_rows, run_rows, sigma_rows, with_sigma
from polhode.report.template import inflated
from polhode.run_directory.archives import write_measurements
from polhode.run_directory.outputs import write_estimate
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from polhode.run_directory.summary import build_summary, read_summary
from polhode.run_directory.summary_schema import Check, Intervals, ShapeFindings
from polhode.run_directory.trajectory_file import trajectory_of
from polhode.runtime.errors import InputError
from tests.pipeline.stored_run import stored
from tests.report.conftest import UNKNOWN_UNTIL, unpacked

MOTION = [
    "polhode",
    "mesh",
    "centre-of-mass",
    "angular-velocity",
    "attitude",
    "inertia-ratios",
    "energy-momentum",
]
CONVERGENCE = ["convergence-mass", "convergence-states"]
TRACKS = ["observations", "landmarks-over-time"]
FIGURES = [*MOTION, *CONVERGENCE, "residual-histogram", "residual-rms", *TRACKS, "sparse-map"]
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&"


class _Page(HTMLParser):
    """Collects what a browser would load, and the figures."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.text = file.read_text()
        self.loads: list[str] = []
        self.figures: dict[str, Any] = {}
        self.attributes: set[str] = set()
        self.words = ""
        self._inside: str | None = None
        self.feed(self.text)

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

    def traces(self, figure: str, name: str) -> list[Any]:
        return [each for each in self.figures[figure]["data"] if each.get("name") == name]


def _page(folder: Path) -> _Page:
    return _Page(folder / "report.html")


def test_every_figure_is_there_and_nothing_is_loaded_from_anywhere(run_folder: Path) -> None:
    page = _page(run_folder)
    assert list(page.figures) == FIGURES
    assert all(figure["data"] for figure in page.figures.values())
    assert "tumbler" in page.words and "0.3042 ± 0.0020" in page.words
    assert "Images" in page.words and "Configuration" in page.words
    assert all(re.match(r"(a #|img data:image/)", load) for load in page.loads), page.loads
    assert not re.search(r"(src|href)\s*=\s*[\"'`\\]*https?://|@import|url\(\s*[\"']?http", page.text)
    assert "default-src 'none'" in page.text


def test_undetermined_is_said_in_words_and_draws_no_band(undetermined: Any, tmp_path: Path) -> None:
    page = _page(stored(tmp_path / "run", undetermined, None))
    assert "pure spin: no torque-free wobble to see" in page.words
    assert "this motion does not determine k1 and k2" in page.words
    assert "The position along y is not determined by the data: no band is drawn." in page.words
    assert "no bound" in page.words and "No surface" in page.words
    assert page.traces("inertia-ratios", "estimate") and not page.traces("inertia-ratios", "3σ")
    assert list(page.figures) == [name for name in FIGURES if name not in ("mesh", *CONVERGENCE)]
    found = sigma_rows(read_stored_run(tmp_path / "run", ""))
    cells = {name.split(",")[0]: cells for name, _, cells in found}
    assert cells["position"] == ("0.3", "no bound", "0.3") and cells["centre of mass"][1] == "no bound"
    assert cells["inertia ratio k1"] == cells["inertia ratio k2"] == ("no bound",)


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
    (box, _) = page.traces("inertia-ratios", "possible range")
    assert np.allclose(unpacked(box["x"]), [0.0, 0.61, 0.61, 0.0, 0.0])
    for name in ("sparse-map", "mesh"):
        (drawn,) = page.traces(name, "centre of mass: possible range")
        ends = np.stack([unpacked(drawn[each]) for each in "xyz"])
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
    assert list(page.figures) == (TRACKS if tracks_found else [])


def test_metrics_enter_when_the_report_is_made_again_unless_they_are_of_another_run(
    example: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = stored(tmp_path / "run", example, None)
    own = sha256((folder / "summary.json").read_bytes()).hexdigest()
    metrics = {"rmse_position_m": 1.25e-4, "error_k1": 0.002, "error_k2": -0.004, "nees": {"inertia": None}}
    for more in ({}, {"summary_sha256": own}, {"summary_sha256": "0" * 64}):
        is_own = more.get("summary_sha256", own) == own
        (folder / "metrics.json").write_text(json.dumps({**metrics, **more}))
        write_report(folder)
        page = _page(folder)
        assert len(page.traces("inertia-ratios", "truth")) == (2 if is_own else 0)
        for words in ("Against the truth", "RMSE position [mm]"):
            assert (words in page.words) == is_own
        assert ("metrics.json: of another run" in caplog.text) != is_own
    assert [entry.name for entry in folder.iterdir() if entry.name.startswith(".")] == []


def test_the_panel_of_checks_begins_with_what_is_in_doubt_and_folds_what_is_not_possible(
    example: Any, tmp_path: Path
) -> None:
    checks = (
        Check(name="rows: step", value=0.05, limit=0.3, unit="px"),
        Check(name="shared landmarks", value=2.0, limit=6.0, at_least=True, reason="nothing connects them"),
        Check(name="attitudes", limit=0.1, unit="deg"),
    )
    summary = build_summary(example.tracks, example.estimate, example.surface, {}, checks=checks)
    found = check_rows(summary)
    rows = [(row.name, row.value, row.expected, row.kind) for row in found]
    assert rows[:2] == [
        ("shared landmarks", "2", "at least 6", "doubt"),
        ("rows: step", "0.05 px", "at most 0.3 px", "holds"),
    ]
    folded = {row.name: row.expected for row in found if row.kind == "impossible"}
    assert folded["attitudes"] == "at most 0.1 deg"
    write_estimate(tmp_path, example.tracks, example.estimate)
    finish_run(tmp_path, summary)
    assert read_summary(tmp_path / "summary.json").checks[:3] == checks
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
    (folder / "pictures").mkdir(exist_ok=True)
    (folder / "secret.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "pictures" / "captions.json").write_text(json.dumps({name: "a caption"}))
    with pytest.raises(InputError, match=message):
        read_stored_run(folder, "run")


def test_values_have_the_digits_that_their_sigma_allows_and_the_finding_has_rate_axis_and_ratios(
    example: Any,
) -> None:
    assert with_sigma(0.031723, 0.00213) == "0.0317 ± 0.0021"
    assert with_sigma(14.238, 0.14) == "14.24 ± 0.14" and with_sigma(1234.5, 38.0) == "1234 ± 38"
    assert with_sigma(0.3, None) == with_sigma(0.3, float("inf")) == "0.3"
    summary = build_summary(example.tracks, example.estimate, example.surface, {})
    path = replace(trajectory_of(example.estimate), w_P=np.tile([0.0, 0.02, 1.0], (24, 1)))
    assert finding(summary, path) == (
        "The target rotates at 9.55 RPM about its principal axis z (smallest moment) and drifts at 3.0 mm/s; "
        "its inertia ratios are k1 = 0.3042 ± 0.0020 and k2 = 0.2803 ± 0.0060."
    )
    # the moments have the sigmas of the ratios
    assert summary.inertia is not None
    for sigma, words in ((0.03, "1.500 ± 0.030"), (None, "1.5")):
        given = {"moments": [1.5, 1.0, 0.8], "sigma_moments": [sigma, 0.0, 0.04]}
        found = summary.model_copy(update={"inertia": summary.inertia.model_copy(update=given)})
        (row,) = (each for each in inertia_rows(found) if "moments" in each.name)
        assert row.value == f"{words} : 1 (exact) : 0.800 ± 0.040"


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
    aligned = "attitude error [deg]: median, after the constant rotation of the axes is removed"
    assert [(row.name, row.value, row.unit, row.determined) for row in metric_rows(metrics)] == [
        ("RMSE velocity [mm/s]", "0.2", "", True),
        (aligned, "0.02", "", True),
        ("prediction error [mm]: 10 s after the last image", "2", "", True),
        ("mesh: completeness 3mm", "0.9", "", True),
        ("NEES: position", "3", "expected 0.22 to 9.35", True),
        ("NEES: inertia", "15.4", "expected 0.83 to 12.8", False),
        ("NEES: axes", "–", "", True),
        ("coverage 3sigma: velocity", "0.95", "expected 0.99 to 1", False),
        ("truth in interval: k1", "True", "expected True", True),
        ("truth in interval: k2", "False", "expected True", False),
    ]


def test_the_histogram_has_the_noise_of_the_tables_and_rms_counts_inliers_only(
    run_folder: Path, content: StoredRun, example: Any
) -> None:
    assert content.tracks is not None and content.residuals is not None
    noise = content.summary.noise
    assert noise is not None
    sigma_px = sigma_found(content.tracks, noise)
    expected = [noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px]
    np.testing.assert_allclose(np.median(sigma_px, axis=0), expected, rtol=1e-12)
    shown = {row.name: row.value for row in run_rows(content)}
    # a power known within half a decade: an amplitude within a quarter
    assert shown["disturbance acceleration"] == "0.001, within a factor of 1.8"
    page = _page(run_folder)
    for name in ("noise of u, v", "noise of the disparity"):
        assert page.words.count(f"{shown[name]} px of") >= 2, "in both captions"
    (drawn,) = page.traces("residual-histogram", "u")
    centres, density = unpacked(drawn["x"]), unpacked(drawn["y"])
    normalised = content.residuals.residuals_px[:, 0] / sigma_px[:, 0]
    inside = np.abs(normalised) <= 5.0
    assert density.sum() * (centres[1] - centres[0]) == pytest.approx(np.mean(inside), rel=1e-3)
    spread = np.sqrt(np.average(centres**2, weights=density))
    assert spread == pytest.approx(np.sqrt(np.mean(normalised[inside] ** 2)), rel=0.03)
    rms = rms_per_frame(content.tracks, content.residuals)
    here = (example.tracks.frame == 4) & (example.estimate.inlier_weight >= 0.5)
    np.testing.assert_allclose(rms[4], np.sqrt(np.mean(example.estimate.residuals_px[here] ** 2, axis=0)))
    assert np.all(np.isnan(rms[11])), "bridged"


def test_the_drawn_polhode_is_the_motion_of_a_free_body(example: Any) -> None:
    moments, w0 = example.estimate.mass.moments, example.estimate.w_P[0]
    time_s = np.array([0.0, 0.5, 1.0])

    def euler(t: float, w: np.ndarray) -> np.ndarray:
        return np.asarray(-np.cross(w, moments * w) / moments)

    exact = solve_ivp(euler, (0, 1), w0, t_eval=time_s, rtol=1e-11, atol=1e-13).y.T
    path = torque_free_path(time_s, exact, moments)
    dense = solve_ivp(euler, (0, 1), w0, t_eval=np.linspace(0, 1, len(path)), rtol=1e-11, atol=1e-13).y.T
    np.testing.assert_allclose(path, dense, atol=1e-6)


def test_shapes_that_are_drawn_have_their_closed_forms() -> None:
    k2 = np.array([0.0, 0.4, 2.0])
    Jxx, Jyy, Jzz = np.exp(largest_k1(k2)), 1.0, np.exp(-k2)
    np.testing.assert_allclose(Jxx, Jyy + Jzz)
    covariance = np.array([[4.0, -1.5], [-1.5, 1.0]])
    points = confidence_ellipse(np.array([1.0, 2.0]), covariance, 3.0) - [1.0, 2.0]
    distance = np.sqrt(np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points))
    np.testing.assert_allclose(distance, 3.0)
    time_s = np.linspace(0, 10, 20)
    p = np.array([1.0, 2.0, 3.0]) + np.outer(time_s, [0.1, -0.2, 0.3])
    sigma = np.tile([0.1, np.inf, 0.1], (20, 1))
    np.testing.assert_allclose(straight_line_residual(time_s, p, sigma), 0.0, atol=1e-12)
    # thinning keeps the shape
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    vertices, faces, source = thin_mesh(sphere, 5000)
    assert 1500 < len(faces) <= 5000
    small = trimesh.Trimesh(vertices, faces, process=False)
    assert small.area == pytest.approx(sphere.area, rel=0.02)
    radii = np.linalg.norm(vertices, axis=1)
    assert radii.min() > 0.098 and radii.max() <= 0.1 + 1e-12
    assert np.all(np.linalg.norm(sphere.vertices[source] - vertices, axis=1) < 0.01)


def test_the_causal_estimate_is_drawn_against_the_smoothed_one(content: StoredRun) -> None:
    mass, states = convergence_figures(content)
    known = np.isfinite(next(trace for trace in mass.data if trace.get("name") == "k1")["y"])
    np.testing.assert_array_equal(np.flatnonzero(known), np.arange(UNKNOWN_UNTIL, len(known)))
    assert f"k1 from frame {UNKNOWN_UNTIL + 1} on" in mass.caption
    assert "the centre of mass from frame 1 on" in mass.caption and "the axes never" in mass.caption
    assert convergence_figures(replace(content, online=None)) == []

    def curves(figure: Figure, panel: int) -> dict[str, np.ndarray]:
        """The lines of a panel by name, without bands and final values."""
        data = [trace for trace in figure.data if trace["yaxis"] == on(panel)["yaxis"]]
        return {trace["name"]: trace["y"] for trace in data if trace["name"] not in (BAND, "final value")}

    # the centre of mass in the final frame G; the axes as small rotations from the final ones
    offset, axes = curves(mass, 3), curves(mass, 4)
    assert set(offset) == set(axes) == {"x", "y", "z"} and np.isnan(axes["y"]).all()
    for curve in (*offset.values(), axes["x"], axes["z"]):
        np.testing.assert_allclose(curve, 0.0, atol=1e-5)
    np.testing.assert_allclose(curves(mass, 8)["x"], np.rad2deg(1e-3), rtol=1e-5)
    for panel in (1, 2, 3, 4):
        state = curves(states, panel)
        np.testing.assert_allclose(state["causal"], 2.0 * state["smoothed"], rtol=1e-5)
    rows = {name.split(",")[0]: (unit, cells) for name, unit, cells in sigma_rows(content)}
    assert rows["position"] == ("mm", ("0.3", "0.3", "0.3"))
    assert rows["inertia ratio k1"] == ("", ("0.002",)) and rows["inertia ratio k2"] == ("", ("0.006",))
    assert float(rows["attitude"][1][0]) == pytest.approx(np.rad2deg(2e-3), rel=1e-2)


def test_the_other_starts_are_told_in_words(example: Any, tmp_path: Path) -> None:
    others = {"momentum": 0.6, "oblate": 2.5, "prolate": 114.0, "flat across": float("inf")}
    estimate = replace(example.estimate, solver=replace(example.estimate.solver, runner_up=others))
    run = stored(tmp_path / "run", example, estimate=estimate)
    rows = {row.name: row.value for row in run_rows(read_stored_run(run, "run"))}
    assert rows["start from momentum"] == "ended in the same minimum"
    assert rows["start from oblate"] == "ended in another minimum, whose cost is higher by 2.5"
    assert rows["start from prolate"] == "ended in another minimum, whose cost is higher by 114"
    assert rows["start from flat across"] == "did not converge"


def test_kilograms_unknown_pushes_and_what_is_assumed_stand_apart(example: Any, tmp_path: Path) -> None:
    mass = replace(
        example.estimate.mass, mass_kg=4.56, sigma_mass_kg=0.07,
        inertia_scale_kg_m2=0.0234, sigma_inertia_scale_kg_m2=np.inf,
    )  # fmt: skip
    first_ns = int(example.estimate.timestamps_ns[0])
    push = Impulse(
        first_ns + 2 * 10**9, first_ns + 3 * 10**9, np.array([0.0, -0.004, 0.003]), np.full(3, 1e-4),
        np.array([0.1, 0.0, 0.2]), np.full(3, np.inf),
    )  # fmt: skip
    step = np.zeros((1, 3))
    steps = np.array([push.start_ns]), np.array([push.end_ns])
    disturbances = Disturbances(*steps, step, step + 0.1, step, step + 0.1, (push,))
    estimate = replace(example.estimate, mass=mass, disturbances=disturbances)
    assumed, _ = assumed_properties(mass, example.surface, Backend(mass_kg=4.5))
    write_estimate(tmp_path, example.tracks, estimate)
    shape = ShapeFindings(assumed=assumed)
    finish_run(tmp_path, build_summary(example.tracks, estimate, example.surface, {}, shape=shape))
    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["inertia"]["mass_kg"] == 4.56 and content["inertia"]["sigma_scale_kg_m2"] is None
    assert content["assumed"]["mass_kg"] == 4.5
    (pulse,) = content["unknown_pushes"]
    assert (pulse["start_s"], pulse["end_s"]) == (2.0, 3.0)
    assert pulse["sigma_delta_w_P"] == [None, None, None]
    page = _page(tmp_path).words
    for words in ("In kilograms, from known", "4.560 ± 0.070", "Unknown forces", "Assumed, not estimated"):
        assert words in page
    assert (tmp_path / "pushes.csv").is_file()
    # a later round without pushes leaves no table of an earlier one
    write_estimate(tmp_path, example.tracks, example.estimate)
    assert not (tmp_path / "pushes.csv").exists()


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
    write_report(run, tmp_path / "one.html")
    write_comparison([run, run], tmp_path / "two.html")
    for page in (_Page(tmp_path / "one.html"), _Page(tmp_path / "two.html")):
        assert "<script>alert" not in page.text and "<img src=x" not in page.text
        assert "&lt;script&gt;alert(1)" in page.text
        assert "onerror" not in page.attributes and "img x" not in page.loads


def test_several_runs_share_one_page_and_a_number_that_one_does_not_hold_is_a_dash(
    run_folder: Path, undetermined: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finish_run(tmp_path, build_summary(None, None, None, {}, failure="no consistent motion"))
    spinner = stored(tmp_path / "spinner", undetermined, timing_s={"backend": 2.0})
    runs, output = [run_folder, spinner, tmp_path], tmp_path / "all.html"
    assert main(["report", *map(str, runs), "-o", str(output)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(str(output))
    page = _Page(output)
    assert all(f"<th>{run.name}</th>" in page.text for run in runs)
    assert "no consistent motion" in page.text
    assert not re.findall(r"(?:src|href)\s*=\s*['\"]?https?:", page.text)
    assert [trace["name"] for trace in page.figures["rates"]["data"]] == ["tumbler", "spinner"]
    for name, symbol in (("tumbler", "circle"), ("spinner", "circle-open")):
        assert page.traces("ratios", name)[0]["marker"]["symbol"] == symbol
    assert len(page.traces("ratios", "3σ")) == 1
    table = dict(side_by_side([read_stored_run(run, run.name) for run in runs]))
    assert table["solver"] == ["ipopt, 7 iterations"] * 2 + [NO_VALUE]
    assert all(len(cells) == len(runs) for cells in table.values())
    # the frame G is each run's own
    assert not any(name.startswith("centre of mass") for name in table)
    # two of one name have their paths
    other = tmp_path / "other" / "spinner"
    other.parent.mkdir()
    spinner.rename(other)
    again = stored(tmp_path / "spinner", undetermined)
    write_comparison([other, again], tmp_path / "page.html")
    assert all(f"<th>{folder}</th>" in (tmp_path / "page.html").read_text() for folder in (other, again))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("RUN none -o page.html", "none"),
        ("empty -o page.html", "give the folder of a run"),
        ("-o page.html", "a run is missing"),
        ("RUN -o /dev/null/page.html", "part of this path is a file"),
        ("RUN -o empty", "is a folder"),
        ("RUN broken -o page.html", "line 1: not valid JSON"),
    ],
)
def test_a_mistake_is_one_line_and_exit_2(
    arguments: str, words: str, run_folder: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    for name in ("empty", "broken"):
        (tmp_path / name).mkdir()
    (tmp_path / "broken" / "summary.json").write_text("{")
    monkeypatch.chdir(tmp_path)
    assert main(["report", *arguments.replace("RUN", str(run_folder)).split()]) == 2
    stderr = capsys.readouterr().err
    assert words in stderr and stderr.count("\n") == 1
    assert not (tmp_path / "page.html").exists()
