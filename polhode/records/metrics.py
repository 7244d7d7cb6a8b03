"""Errors of an estimate: estimate minus truth.

A half-turn about a principal axis changes the signs of the axes, not the motion: the best of the four is
taken. Nothing else is aligned, except where a metric's definition says so. ``polhode/report/evaluation``
applies them to a run, with the errors of inertia, mesh and prediction.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from polhode.geometry.lie import Array, Ints, log_so3
from polhode.geometry.rigid_body import HALF_TURNS, best_half_turn, propagate
from polhode.geometry.rigid_fit import mean_rotation
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError

_SAME_INSTANT_NS = 1_000
COMPONENTS = {
    **{"position": 3, "velocity": 3, "attitude": 3, "angular_velocity": 3},
    **{"inertia": 5, "com": 3, "axes": 3, "momentum": 2, "momentum_size": 1, "spin": 2},
}
"""Of each quantity with a NEES and a coverage."""
NEES, COVERAGE, COVERAGE_CONSTANTS = "nees", "coverage_3sigma", "coverage_3sigma_constants"
"""Groups of the metrics of a run that have an expected range"""
IN_INTERVAL = "truth_in_interval"
"""Group of the metrics that are expected to be true"""
AXES_REMOVED = "after the constant rotation of the axes is removed"
ALIGNED = {
    "attitude_error_deg": AXES_REMOVED,
    "prediction_error_deg": AXES_REMOVED,
    "attitude_error_with_axes_deg": "of the run's own axes, after half_turn",
}
"""Groups of angles: what is aligned before they are taken; ``principal_axes_error_deg`` is that rotation"""
MESH = "mesh"
MESH_SHARES = {"within_one_sigma": (0.63, 0.73), "within_three_sigma": (0.98, 1.0)}
"""Of the vertices: Gaussian errors would give 0.683 and 0.997"""
MIN_COVERAGE = 0.99
"""Of three standard deviations, which hold 99.7 % of Gaussian errors"""


def expected_range(group: str, name: str) -> tuple[float, float] | None:
    """Where a metric of one run lies if its sigmas are right; None: nothing is expected.

    The 95 % band of a NEES is that of a single draw of the chi-squared distribution: the errors of a run's
    frames depend on one another, in the extreme as if there were one frame.
    """
    if group == MESH:
        return MESH_SHARES.get(name)
    if name not in COMPONENTS:
        return None
    if group == NEES:
        # its quantiles: scipy.stats, which has them too, takes a quarter of a second to be imported
        low, high = 2.0 * gammaincinv(0.5 * COMPONENTS[name], [0.025, 0.975])
        return float(low), float(high)
    return (MIN_COVERAGE, 1.0) if group in (COVERAGE, COVERAGE_CONSTANTS) else None


@dataclass(frozen=True)
class States:
    """States of the target at F instants."""

    timestamps_ns: Ints
    r_N: Array
    """(F, 3) [m]"""
    v_N: Array
    """(F, 3) [m/s]"""
    R_NP: Array
    """(F, 3, 3)"""
    w_P: Array
    """(F, 3) [rad/s]"""

    @property
    def w_N(self) -> Array:
        """(F, 3) angular velocity along N [rad/s]."""
        return np.asarray((self.R_NP @ self.w_P[..., None])[..., 0])


def truth_at(truth: Truth, timestamps_ns: Ints) -> States:
    """The truth at (F,) instants: its own row within 1 us, else propagated from the last row before.

    Between rows the target moves as a free rigid body of the true inertia, so coarse rows are sufficient.
    Raises InputError when an instant lies outside the truth.
    """
    own = truth.timestamps_ns
    if timestamps_ns[0] < own[0] - _SAME_INSTANT_NS or timestamps_ns[-1] > own[-1] + _SAME_INSTANT_NS:
        raise InputError("the truth (target0/data.csv) does not cover the run: is this its sequence?")
    right = np.clip(np.searchsorted(own, timestamps_ns), 0, len(own) - 1)
    left = np.maximum(right - 1, 0)
    closer = np.abs(own[left] - timestamps_ns) < np.abs(own[right] - timestamps_ns)
    nearest = np.where(closer, left, right)
    row = np.where(np.abs(own[nearest] - timestamps_ns) <= _SAME_INSTANT_NS, nearest, left)
    gap_s = (timestamps_ns - own[row]) * 1e-9
    r_N, v_N, R_NP, w_P = (a[row].copy() for a in (truth.r_N, truth.v_N, truth.R_NP, truth.w_P))
    J_P = np.diag(truth.moments / truth.moments[1])
    for k in np.flatnonzero(np.abs(gap_s) > _SAME_INSTANT_NS * 1e-9):
        r, v, R, w = propagate([0.0, gap_s[k]], r_N[k], v_N[k], R_NP[k], w_P[k], J_P, rtol=1e-10)
        r_N[k], v_N[k], R_NP[k], w_P[k] = r[-1], v[-1], R[-1], w[-1]
    return States(timestamps_ns, r_N, v_N, R_NP, w_P)


def with_half_turn(states: States, half_turn: int) -> States:
    """The same motion with the principal axes rotated by a half-turn."""
    s = HALF_TURNS[half_turn]
    return States(states.timestamps_ns, states.r_N, states.v_N, states.R_NP * s, states.w_P * s)


def constant_body_rotation(states: States, truth: States) -> Array:
    """R_PP* (3, 3) for which R_NP R_PP* fits the true attitude best: the error of the principal axes."""
    return mean_rotation(np.swapaxes(states.R_NP, -1, -2) @ truth.R_NP)


def angle_deg(R: Array) -> Array:
    """Angle of rotations (..., 3, 3) -> (...) [deg]."""
    return np.asarray(np.rad2deg(np.linalg.norm(log_so3(R), axis=-1)))


def rms(errors: Array) -> float:
    """Root mean square length of vectors (F, 3)."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


@dataclass(frozen=True)
class MotionErrors:
    """Errors of the states over all frames: estimate minus truth."""

    rmse_position_m: float
    rmse_velocity_m_s: float
    rmse_angular_velocity_deg_s: float
    attitude_median_deg: float
    """After the constant rotation of the axes is removed, as ``attitude_max_deg``"""
    attitude_max_deg: float
    attitude_with_axes_median_deg: float
    """Nothing is removed but the half-turn, as in ``attitude_with_axes_max_deg``"""
    attitude_with_axes_max_deg: float
    principal_axes_error_deg: float
    error_com_mm: float
    half_turn: int


def motion_errors(estimate: States, truth: States) -> MotionErrors:
    """Compare states at the same F instants."""
    half_turn = best_half_turn(estimate.R_NP, truth.R_NP)
    states = with_half_turn(estimate, half_turn)
    R_fit = constant_body_rotation(states, truth)
    attitude_deg = angle_deg(np.swapaxes(states.R_NP @ R_fit, -1, -2) @ truth.R_NP)
    with_axes_deg = angle_deg(np.swapaxes(states.R_NP, -1, -2) @ truth.R_NP)
    offset_P = (np.swapaxes(truth.R_NP, -1, -2) @ (states.r_N - truth.r_N)[..., None])[..., 0]
    return MotionErrors(
        rmse_position_m=rms(states.r_N - truth.r_N),
        rmse_velocity_m_s=rms(states.v_N - truth.v_N),
        rmse_angular_velocity_deg_s=float(np.rad2deg(rms(states.w_N - truth.w_N))),
        attitude_median_deg=float(np.median(attitude_deg)),
        attitude_max_deg=float(attitude_deg.max()),
        attitude_with_axes_median_deg=float(np.median(with_axes_deg)),
        attitude_with_axes_max_deg=float(with_axes_deg.max()),
        principal_axes_error_deg=float(angle_deg(R_fit)),
        error_com_mm=float(1e3 * np.linalg.norm(offset_P.mean(axis=0))),
        half_turn=half_turn,
    )


def nees(errors: Array, covariance: Array) -> float | None:
    """Mean normalised squared error of errors (F, n) with covariances (F, n, n); expected: n.

    None when a component is undetermined (not finite) or the covariance is singular.
    """
    if not (np.isfinite(covariance).all() and np.isfinite(errors).all()):
        return None
    # Metres and radians differ by orders of magnitude: scale before inverting.
    scale = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    if not (scale > 0.0).all():
        return None
    correlation = covariance / scale[..., :, None] / scale[..., None, :]
    whitened = errors / scale
    try:
        solved = np.linalg.solve(correlation, whitened[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return None
    return float(np.mean(np.sum(whitened * solved, axis=-1)))


def coverage(error: Array, covariance: Array) -> float | None:
    """Share of the determined components of errors (..., n) within three standard deviations; None: none is.

    covariance (..., n, n).
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    known = np.isfinite(variance)
    inside = np.abs(error[known]) <= 3.0 * np.sqrt(np.maximum(variance[known], 0.0))
    return float(np.mean(inside)) if known.any() else None


def state_scores(
    estimate: States, truth: States, covariance: Array, half_turn: int
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """NEES and coverage of position, velocity, attitude (the half-turn resolved, nothing fitted) and angular
    velocity, over all frames.

    covariance (F, 12, 12) in the order r (N), v (N), theta (P), w (P), of the estimate's own axes.
    """
    of_nees: dict[str, float | None] = {}
    of_coverage: dict[str, float | None] = {}
    for i, (name, error) in enumerate(state_errors(estimate, truth, half_turn).items()):
        block = covariance[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        of_nees[name], of_coverage[name] = nees(error, block), coverage(error, block)
    return of_nees, of_coverage


def state_errors(estimate: States, truth: States, half_turn: int) -> dict[str, Array]:
    """Position, velocity, attitude and angular velocity, estimate minus truth (F, 3) each, along the axes in
    which the covariance of the estimate is stated: those of N, and the estimate's own P.
    """
    same_axes = with_half_turn(truth, half_turn)
    theta = log_so3(np.swapaxes(estimate.R_NP, -1, -2) @ same_axes.R_NP)
    return {
        "position": estimate.r_N - truth.r_N,
        "velocity": estimate.v_N - truth.v_N,
        "attitude": -theta,
        "angular_velocity": estimate.w_P - same_axes.w_P,
    }
