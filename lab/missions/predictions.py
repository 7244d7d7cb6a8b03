"""Predictions of a run against the truth that came after it: errors, sigmas, regions.

Judged is the body itself, as the covariance of its marks states it: G is exact at the first frame, so that
the true motion of whatever was there is known, whether or not the principal axes are determined.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lab.robustness.judge import SIGMAS, floor_of
from polhode.geometry.lie import Array, Bools, log_so3
from polhode.planning.predict import final_estimates, predict_run
from polhode.planning.prediction import PredictedMotion
from polhode.records.metrics import States, truth_at
from polhode.records.truth import Truth
from polhode.run_directory.trajectory_file import read_trajectory

AHEAD_S = (10.0, 30.0, 60.0)
PARTS = ("position", "velocity", "attitude", "rate")
_SCALE = np.repeat([1e3, 1e3, np.rad2deg(1.0), np.rad2deg(1.0)], 3)


def predictions_of(run: Path, truth: Truth, size_m: float) -> dict[str, Any]:
    """By seconds ahead: "error" and "sigma" (12,) [mm, mm/s, deg, deg/s], "inside" (4,) of the 99 % regions
    of PARTS; "wrong": beyond five sigma and what matters, whatever the status, where no hypothesis of the run
    holds the truth.
    """
    own = truth_at(truth, read_trajectory(run).timestamps_ns[:1])
    errors = [prediction_errors(run, truth, own, n) for n in range(1, len(final_estimates(run)) + 1)]
    floors = np.repeat([floor_of(name, size_m) for name in PARTS], 3)
    beyond = [(np.abs(e) > SIGMAS * s) & (np.abs(e) > floors) for e, s, _ in errors]
    error, sigma, inside = errors[0]
    rows = {
        f"{ahead_s:g}": {
            "error": [float(f"{x:.4g}") for x in error[k]],
            "sigma": [float(f"{x:.4g}") for x in sigma[k]],
            "inside": inside[k].tolist(),
        }
        for k, ahead_s in enumerate(AHEAD_S)
    }
    return {"ahead": rows, "wrong": all(bool(each.any()) for each in beyond)}


def prediction_errors(run: Path, truth: Truth, first: States, hypothesis: int) -> tuple[Array, Array, Bools]:
    """Errors and sigmas (T, 12), and whether each of PARTS is in its region (T, 4); first: the true state."""
    predicted = predict_run(run, AHEAD_S[-1], step_s=AHEAD_S[0], hypothesis=hypothesis)
    rows = np.searchsorted(predicted.time_s, np.array(AHEAD_S) - 1e-6)
    error = body_errors(predicted, read_trajectory(run), truth, first)[rows]
    covariance = predicted.covariance_of_marks[rows]
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    inside = np.zeros((len(rows), len(PARTS)), dtype=np.bool_)
    for n in range(len(PARTS)):
        part = slice(3 * n, 3 * n + 3)
        e = error[:, part]
        squares = np.einsum("ti,ti->t", e, np.linalg.solve(covariance[:, part, part], e[..., None])[..., 0])
        inside[:, n] = np.sqrt(squares) <= predicted.region_sigmas[rows, n]
    return error * _SCALE, sigma * _SCALE, inside


def body_errors(predicted: PredictedMotion, table: Any, truth: Truth, first: States) -> Array:
    """(T, 12) of the point at the estimated centre of mass, and of the axes of the estimated G at first."""
    at = truth_at(truth, predicted.timestamps_ns)
    between = at.R_NP @ first.R_NP[0].T
    R_NG = between @ table.R_NP[0] @ predicted.R_GP.T
    lever_N = between @ (table.r_N[0] - first.r_N[0])
    w_N = at.w_N
    R_NP = predicted.R_NP
    return np.hstack([
        predicted.r_N - (at.r_N + lever_N),
        predicted.v_N - (at.v_N + np.cross(w_N, lever_N)),
        log_so3(np.swapaxes(R_NG @ predicted.R_GP, 1, 2) @ R_NP),
        predicted.w_P - np.einsum("tji,tj->ti", R_NG @ predicted.R_GP, w_N),
    ])  # fmt: skip
