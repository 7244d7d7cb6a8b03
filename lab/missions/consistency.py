"""Whether errors are as large as the sigmas say: normalised squared errors and coverage, of runs and pooled.

The normalised squared error of n components, e^T C^-1 e, is n on average. Errors of the states in one run
depend on one another in time, so a run gives one sample of each quantity: its mean over the frames. The band
takes each run as one draw from a chi-squared distribution, as if its errors never changed: the widest band
that is possible. Only components that a run claims count.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from lab.robustness.judge import Errors, TrueMotion, errors_of
from polhode.backend.problem.inertia import FORMS
from polhode.config.loader import load_config
from polhode.records.metrics import MIN_COVERAGE, States
from polhode.report.evaluation import inertia_parameter_error
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import read_trajectory, target_poses

QUANTITIES = ("position", "velocity", "attitude", "rate", "inertia", "axes", "com")
SIGMAS = 3.0
MIN_NEES = 0.45
"""Of the mean over its expectation: below, the bands are more than 1.5 times as wide as needed."""
Entry = dict[str, Any]


def consistency_of(run: Path, summary: Summary, truth: TrueMotion) -> dict[str, Entry]:
    """By quantity of one run: the mean of its normalised squared error, how many components it has on average
    (both per frame), and how many of all components are within three sigma. Absent: not claimed at all.
    """
    found = errors_of(run, summary, truth)
    found["inertia"] = _inertia_errors(run, summary, truth)
    out = {name: entry_of(errors) for name, errors in found.items()}
    return {name: entry for name, entry in out.items() if entry["total"]}


def entry_of(found: Errors) -> Entry:
    """Of one quantity: "nees", "expected", "inside", "total"."""
    squared, inside = 0.0, 0
    for error, covariance, claimed in zip(found.errors, found.covariance, found.claimed, strict=True):
        e, C = error[claimed], covariance[np.ix_(claimed, claimed)]
        sigma = np.sqrt(np.diagonal(C))
        inside += int(np.sum(np.abs(e) <= SIGMAS * sigma))
        # metres and radians differ by orders of magnitude: solved with correlations
        whitened = e / sigma
        squared += float(whitened @ np.linalg.lstsq(C / np.outer(sigma, sigma), whitened, rcond=1e-12)[0])
    frames, total = len(found.errors), int(found.claimed.sum())
    return {
        "nees": float(f"{squared / frames:.4g}"),
        "expected": float(f"{total / frames:.4g}"),
        "inside": inside,
        "total": total,
    }


def _inertia_errors(run: Path, summary: Summary, truth: TrueMotion) -> Errors:
    """Of the solver's five parameters; G is held at the first frame, so the true moments are put there."""
    assert summary.inertia is not None
    table, own = read_trajectory(run), truth.truth
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    R_NG = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))[0, :3, :3]
    R_GP = R_NG.T @ own.R_NP[int(np.searchsorted(truth.stamps_ns, estimate.timestamps_ns[0]))]
    form = FORMS[load_config(run / "config.yaml").backend.inertia]
    J_G = R_GP @ np.diag(own.moments) @ R_GP.T
    error = inertia_parameter_error(np.array(summary.inertia.J_G), J_G, form)
    rows = [[np.inf if v is None else v for v in row] for row in summary.inertia.cov_J]
    covariance = np.array(rows, dtype=np.float64)
    return Errors(error[None], covariance[None], np.isfinite(np.diagonal(covariance))[None])


def pooled(entries: Sequence[Entry]) -> Entry:
    """Of several runs: mean squared error over its expectation ("ratio") with its 95 % band ("low", "high"),
    share of the components within three sigma ("coverage"), and of the "runs" how many.
    """
    expected = sum(entry["expected"] for entry in entries)
    if not expected:
        return {"runs": 0, "ratio": None, "low": None, "high": None, "coverage": None}
    low, high = band(expected)
    return {
        "runs": len(entries),
        "ratio": sum(entry["nees"] for entry in entries) / expected,
        "low": low,
        "high": high,
        "coverage": sum(entry["inside"] / entry["total"] * entry["expected"] for entry in entries) / expected,
    }


def band(components: float) -> tuple[float, float]:
    """95 % of the means of so many squared standard normal variables lie between."""
    low, high = chi2.ppf([0.025, 0.975], components) / components
    return float(low), float(high)


def holds(result: Entry) -> bool:
    """Whether the pooled errors are neither too large nor too small for their sigmas."""
    if result["ratio"] is None:
        return True
    in_band = max(result["low"], MIN_NEES) <= result["ratio"] <= result["high"]
    return bool(in_band and result["coverage"] >= MIN_COVERAGE)
