"""The report's account of the causal estimate, of final standard deviations and of the other starts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.geometry.lie import make_pose
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.report.convergence_figures import convergence_figures
from polhode.report.plot_style import BAND, Figure, on
from polhode.report.tables import run_rows, sigma_rows
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from tests.pipeline.stored_run import stored

UNKNOWN_UNTIL = 9


def online_of(motion: MotionEstimate) -> OnlineEstimate:
    """As if the final estimate had been known causally, in another G; undetermined in the first frames."""
    F, mass = len(motion.r_N), motion.mass
    shift = make_pose(np.eye(3), [0.01, 0.02, -0.03])
    determined = np.arange(F)[:, None] >= np.array([UNKNOWN_UNTIL, UNKNOWN_UNTIL, 0, F])
    variance = np.where(determined, 1e-6, np.inf)
    cov_k, cov_com = np.zeros((F, 2, 2)), np.zeros((F, 3, 3))
    cov_axes = np.tile(np.diag([1e-6, np.inf, 1e-6]), (F, 1, 1))
    cov_k[:, [0, 1], [0, 1]] = variance[:, :2]
    cov_com[:, [0, 1, 2], [0, 1, 2]] = variance[:, 2:3]
    return OnlineEstimate(
        timestamps_ns=motion.timestamps_ns,
        r_N=motion.r_N,
        v_N=motion.v_N,
        R_NP=motion.R_NP,
        w_P=motion.w_P,
        covariance=4.0 * motion.covariance,
        X_NG=motion.X_NG @ shift,
        k=np.tile([mass.k1, mass.k2], (F, 1)),
        cov_k=cov_k,
        com_G=np.tile(mass.com_G - shift[:3, 3], (F, 1)),
        cov_com_G=cov_com,
        R_GP=np.tile(mass.R_GP, (F, 1, 1)),
        cov_R_GP=cov_axes,
        determined=determined,
    )


@pytest.fixture(scope="module")
def content(example: Any, tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return _content(example, example.estimate, tmp_path_factory.mktemp("convergence") / "run")


def _content(example: Any, estimate: MotionEstimate, folder: Path) -> StoredRun:
    stored(folder, example, online=online_of(example.estimate), estimate=estimate)
    return read_stored_run(folder, "run")


def test_what_was_not_determined_yet_is_a_gap(content: StoredRun) -> None:
    mass, states, differences = convergence_figures(content)
    keys = [figure.key for figure in (mass, states, differences)]
    assert keys == ["convergence-mass", "convergence-states", "convergence-differences"]
    curve = next(trace for trace in mass.data if trace.get("name") == "k1")
    known = np.isfinite(curve["y"])
    np.testing.assert_array_equal(np.flatnonzero(known), np.arange(UNKNOWN_UNTIL, len(known)))
    assert f"k1 from frame {UNKNOWN_UNTIL + 1} on" in mass.caption
    assert "the centre of mass from frame 1 on" in mass.caption and "the axes never" in mass.caption
    assert convergence_figures(replace(content, online=None)) == []


def test_the_causal_estimate_is_drawn_against_the_smoothed_one(content: StoredRun) -> None:
    mass, states, differences = convergence_figures(content)

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
        assert set(curves(differences, panel)) == {"x", "y", "z"}
        for curve in curves(differences, panel).values():
            np.testing.assert_allclose(curve, 0.0, atol=1e-5)
        state = curves(states, panel)
        np.testing.assert_allclose(state["causal"], 2.0 * state["smoothed"], rtol=1e-5)


def test_final_sigmas_are_listed_with_their_units(content: StoredRun) -> None:
    rows = {row.name.split(",")[0]: row for row in sigma_rows(content)}
    assert rows["position"].cells == ("0.3", "0.3", "0.3") and rows["position"].unit == "mm"
    assert rows["inertia ratio k1"].cells == ("0.002",) and rows["inertia ratio k2"].cells == ("0.006",)
    assert rows["position"].along_axes and not rows["inertia ratio k1"].along_axes
    assert float(rows["attitude"].cells[0]) == pytest.approx(np.rad2deg(2e-3), rel=1e-2)


def test_undetermined_sigmas_have_no_bound(example: Any, undetermined: Any, tmp_path: Path) -> None:
    rows = {
        row.name.split(",")[0]: row
        for row in sigma_rows(_content(example, undetermined.estimate, tmp_path / "run"))
    }
    assert rows["position"].cells == ("0.3", "no bound", "0.3")
    assert rows["centre of mass"].cells[1] == "no bound"
    assert rows["inertia ratio k1"].cells == rows["inertia ratio k2"].cells == ("no bound",)


def test_the_other_starts_are_told_in_words(example: Any, tmp_path: Path) -> None:
    others = {"momentum": 0.6, "oblate": 2.5, "prolate": 114.0, "flat across": float("inf")}
    estimate = replace(example.estimate, solver=replace(example.estimate.solver, runner_up=others))
    rows = {row.name: row.value for row in run_rows(_content(example, estimate, tmp_path / "run"))}
    assert rows["start from momentum"] == "ended in the same minimum"
    assert rows["start from oblate"] == "ended in another minimum, whose cost is higher by 2.5"
    assert rows["start from prolate"] == "ended in another minimum, whose cost is higher by 114"
    assert rows["start from flat across"] == "did not converge"
