"""A run against what was true: errors of what it claims, in its own sigmas and in physical units.

Claimed is what has a finite sigma: components of the states in each frame; of the constants those that the
run calls determined. The truth of a frame is that of the instant at which its left image was taken, whatever
the clock said. Of constants that change in mid-run the worse of both errors counts, as the run gives one
value.

A claim is wrong if its error exceeds ``SIGMAS`` of its sigmas and a floor that matters in practice
(``FLOORS``).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, log_so3
from polhode.geometry.rigid_body import HALF_TURNS, best_half_turn
from polhode.records.metrics import States, state_errors
from polhode.records.truth import Truth
from polhode.run_directory.archives import read_covariance
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.runtime.errors import InputError

SIGMAS = 5.0
FLOORS = {
    "position": (1.0, "mm"),
    "velocity": (1.0, "mm/s"),
    "attitude": (0.5, "deg"),
    "rate": (0.1, "deg/s"),
    "com": (1.0, "mm"),
    "k": (0.02, ""),
    "axes": (1.0, "deg"),
}
"""Errors that matter at a target of ``SIZE_M``, with their units: smaller ones are not wrong, whatever the
sigma. Lengths and velocities grow with the target."""
SIZE_M = 0.3
_UNITS = {"mm": 1e3, "mm/s": 1e3, "deg": np.rad2deg(1.0), "deg/s": np.rad2deg(1.0), "": 1.0}
_STATES = {"position": "position", "velocity": "velocity", "attitude": "attitude", "angular_velocity": "rate"}


class TrueMotion(Protocol):
    """What a run is judged by: of a ``Recording``, or of a sequence on disk."""

    @property
    def stamps_ns(self) -> Ints:
        """(F,) as written"""

    @property
    def truth(self) -> Truth:
        """At the F instants at which the left images were taken"""

    @property
    def later(self) -> Truth | None:
        """Constants after a change of the target; None: they do not change"""


@dataclass(frozen=True)
class Errors:
    """Errors of one quantity, with their covariance, in each of F frames (a constant: F is 1)."""

    errors: Array
    """(F, n) [m, m/s, rad, rad/s, or none]"""
    covariance: Array
    """(F, n, n)"""
    claimed: Bools
    """(F, n) components with a finite sigma; of the constants, those that the run calls determined"""


@dataclass(frozen=True)
class Claim:
    """Errors of one quantity: its claimed components, in all frames."""

    errors: Array
    """(n,) [m, m/s, rad, rad/s, or none]"""
    sigma: Array
    """(n,)"""


def judged(run: Path, recording: TrueMotion, size_m: float = SIZE_M) -> dict[str, Any]:
    """What the run says, and for each quantity that it claims the errors: typical, worst, in sigmas.

    "status" and "warnings" are those of summary.json, "checks" has value, limit and whether it is beyond of
    each check; "claims" is empty where there is no estimate. size_m: of the target.
    """
    summary = read_summary(run)
    said: dict[str, Any] = {
        "status": summary.status,
        "warnings": summary.warnings,
        "frames_used": summary.frames_used,
    }
    said["checks"] = {check.name: (check.value, check.limit, bool(check.reason)) for check in summary.checks}
    if summary.com_G is None:
        return {**said, "claims": {}, "wrong": []}
    claims = {
        name: entry_of(name, claim, size_m) for name, claim in claims_of(run, summary, recording).items()
    }
    wrong = [name for name, entry in claims.items() if entry["wrong"]]
    return {**said, "claims": claims, "wrong": wrong, "noise": summary.noise and summary.noise.model_dump()}


def floor_of(name: str, size_m: float) -> float:
    """Error of a quantity that matters at a target of this size, in the unit of FLOORS."""
    floor, unit = FLOORS[name]
    return floor * (size_m / SIZE_M if unit.startswith("mm") else 1.0)


def entry_of(name: str, claim: Claim, size_m: float = SIZE_M) -> dict[str, Any]:
    """Worst and typical error of a claim, in its sigmas and in the units of FLOORS; whether it is wrong."""
    floor, unit = floor_of(name, size_m), FLOORS[name][1]
    size = np.abs(claim.errors) * _UNITS[unit]
    ratio = np.abs(claim.errors) / np.maximum(claim.sigma, 1e-300)
    return {
        "wrong": bool(np.any((ratio > SIGMAS) & (size > floor))),
        "worst_sigmas": round(float(ratio.max()), 2),
        "typical_sigmas": round(float(np.sqrt(np.mean(ratio**2))), 2),
        "worst": float(f"{size.max():.3g}"),
        "typical": float(f"{np.sqrt(np.mean(size**2)):.3g}"),
        "sigma": float(f"{np.median(claim.sigma) * _UNITS[unit]:.3g}"),
    }


def claims_of(run: Path, summary: Summary, recording: TrueMotion) -> dict[str, Claim]:
    """By quantity; one that the run does not claim at all is absent."""
    out = {}
    for name, found in errors_of(run, summary, recording).items():
        sigma = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
        if found.claimed.any():
            out[name] = Claim(found.errors[found.claimed], sigma[found.claimed])
    return out


def errors_of(run: Path, summary: Summary, recording: TrueMotion) -> dict[str, Errors]:
    """Errors of each quantity of FLOORS, claimed or not. Raises InputError for another recording's run."""
    table, covariance = read_trajectory(run), read_covariance(run).covariance
    estimate = States(table.timestamps_ns, table.r_N, table.v_N, table.R_NP, table.w_P)
    rows = np.searchsorted(recording.stamps_ns, estimate.timestamps_ns)
    if not np.array_equal(recording.stamps_ns[rows], estimate.timestamps_ns):
        raise InputError(f"{run}: not a run of this recording")
    own = recording.truth
    truth = States(estimate.timestamps_ns, own.r_N[rows], own.v_N[rows], own.R_NP[rows], own.w_P[rows])
    out: dict[str, Errors] = {}
    half_turn = best_half_turn(estimate.R_NP, truth.R_NP)
    for n, (name, errors) in enumerate(state_errors(estimate, truth, half_turn).items()):
        block = covariance[:, 3 * n : 3 * n + 3, 3 * n : 3 * n + 3]
        out[_STATES[name]] = Errors(errors, block, np.isfinite(np.diagonal(block, axis1=1, axis2=2)))
    X_NG = target_poses(estimate, np.array(summary.R_GP), np.array(summary.com_G))
    each = [_constants(summary, X_NG[0], truth, own)]
    if recording.later is not None:
        each.append(_constants(summary, X_NG[0], truth, recording.later, before=own))
    for name, first in each[0].items():
        # the worse of the two
        errors = np.max([np.abs(constants[name].errors) for constants in each], axis=0)
        out[name] = replace(first, errors=errors) if len(each) > 1 else first
    return out


def _constants(
    summary: Summary, X_NG_first: Array, truth: States, constants: Truth, before: Truth | None = None
) -> dict[str, Errors]:
    """Errors of k1, k2, the centre of mass along the principal axes and the axes about them.

    The estimate's G is where the first frame puts it; the true one is there too. ``before``: constants at the
    first frame, if others apply later.
    """
    assert summary.inertia is not None and summary.identifiable_components is not None
    first = before or constants
    X_NG_true = target_poses(
        States(truth.timestamps_ns[:1], truth.r_N[:1], truth.v_N[:1], truth.R_NP[:1], truth.w_P[:1]),
        first.R_GP,
        first.com_G,
    )[0]
    X_GG = inverse_pose(X_NG_first) @ X_NG_true
    R_GP, known, parts = np.array(summary.R_GP), summary.identifiable, summary.identifiable_components
    assert known is not None
    com_error_P = R_GP.T @ (np.array(summary.com_G) - (X_GG[:3, :3] @ constants.com_G + X_GG[:3, 3]))
    between = R_GP.T @ X_GG[:3, :3] @ constants.R_GP
    turn = HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))]
    axes_error = log_so3(between * turn)
    cov_com, cov_axes = (
        np.array(
            [[np.inf if v is None else v for v in row] for row in (matrix or ())], dtype=np.float64
        ).reshape(3, 3)
        for matrix in (summary.cov_com_G, summary.cov_R_GP)
    )
    cov_k = np.array(
        [[np.inf if v is None else v for v in row] for row in summary.inertia.cov], dtype=np.float64
    )
    with np.errstate(invalid="ignore"):
        cov_com_P = R_GP.T @ cov_com @ R_GP
    k_error = np.array([summary.inertia.k1 - constants.k1, summary.inertia.k2 - constants.k2])
    table = {
        "com": (com_error_P, cov_com_P, parts.com_P),
        "k": (k_error, cov_k, (known.k1, known.k2)),
        "axes": (axes_error, cov_axes, parts.axes_P),
    }
    return {
        name: Errors(
            errors[None], covariance[None], (np.array(flags) & np.isfinite(np.diagonal(covariance)))[None]
        )
        for name, (errors, covariance, flags) in table.items()
    }


DOUBTS = (
    r"contradict",
    r"disturbances appear",
    r"fewer than half of the frames",
    r"determine the direction of rotation",
    r"solver stopped",
    r"connected by the dynamics",
)
"""Warnings that question the whole answer, whatever caused it."""


def doubted(line: dict[str, Any], named: Sequence[str] = ()) -> bool:
    """Whether the run is not "ok", questions its answer, or names the trouble (one of the expressions)."""
    said = [re.search(words, text) for words in (*DOUBTS, *named) for text in line["warnings"]]
    return line["status"] != "ok" or any(said)


OUTCOMES = (
    "wrong and confident",
    "wrong, and said so",
    "right",
    "right, but doubted",
    "failed with a reason",
)


def outcome_of(line: dict[str, Any], named: Sequence[str] = ()) -> str:
    """One of OUTCOMES."""
    if line["status"] == "failed":
        return OUTCOMES[4]
    doubt = doubted(line, named)
    if line["wrong"]:
        return OUTCOMES[1] if doubt else OUTCOMES[0]
    return OUTCOMES[3] if doubt else OUTCOMES[2]
