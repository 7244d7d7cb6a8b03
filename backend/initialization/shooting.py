"""Rates and inertia of a body that rotates far between frames, from its attitudes alone, by multiple starts.

Over a rotation of 100 degrees and more, the mean rate between two frames is a poor estimate of the rate at
either: a solver that starts there does not find the motion. The attitudes, however, are known well before the
dynamics are; a few consecutive ones determine rate and inertia by Euler's equation. Shots from many inertias
are compared over more and more frames (single shooting; Stoer and Bulirsch, "Introduction to Numerical
Analysis", 7.3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from polhode.backend.dynamics.propagation import propagate_rotations
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions, rotation_vectors
from polhode.backend.initialization.rates import AMBIGUOUS_TURN_RAD, OPPOSITE_DIRECTION
from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.geometry.lie import Array, Bools, log_so3

FAR_RAD = np.deg2rad(60.0)
"""Median rotation between neighbouring frames above which shooting is worth its time."""
STAGES = ((4, 24), (6, 8), (10, 4), (16, 2))
"""Consecutive frames, and number of shots, in each stage."""
SPREAD = 0.7
"""Standard deviation of the logarithms of the second moments that are tried."""
SIGMA_RAD = 0.01
"""Standard deviation of an attitude, disturbances included."""
MAX_EVALUATIONS = 200
"""Largest number of evaluations for one shot in one stage."""
SERIES_RAD = 1.0
"""Rotation that one Taylor series covers."""
FORM = FORMS["second_moments"]


@dataclass(frozen=True)
class Shot:
    """Second moments (3, 3), rates (F, 3) [rad/s] at every frame, and the misfit of the last stage."""

    second: Array
    w_G: Array
    misfit: float


def shoot(time_s: Array, R_NG: Array, connected: Bools) -> dict[str, Shot]:
    """The best shot in each direction of rotation, by suffix of the hypothesis; none for short rotations.

    time_s (F,), R_NG (F, 3, 3), connected (F,).
    """
    index = np.flatnonzero(connected)
    run = max(np.split(index, np.flatnonzero(np.diff(index) > 1) + 1), key=len)
    if len(run) < STAGES[0][0]:
        return {}
    t, R = time_s[run] - time_s[run[0]], R_NG[run]
    turn = log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    if np.median(np.linalg.norm(turn, axis=1)) < FAR_RAD:
        return {}
    angle = float(np.linalg.norm(turn[0]))
    directions = {"": turn[0]}
    if np.median(np.linalg.norm(turn, axis=1)) > AMBIGUOUS_TURN_RAD:
        directions[OPPOSITE_DIRECTION] = turn[0] * (1.0 - 2.0 * np.pi / max(angle, 1e-6))
    shots = {}
    for suffix, first in directions.items():
        x, misfit = _best(t, R, first / t[1])
        second = FORM.second_moments(x[3:], np.eye(3))
        w_G = _rates(time_s, R_NG, connected, int(run[0]), x[:3], inertia_from_second_moments(second))
        shots[suffix] = Shot(second, w_G, misfit)
    return shots


def _best(t: Array, R: Array, w_G: Array) -> tuple[Array, float]:
    """Rate at the first frame and inertia (8,), and the misfit, of the shot that fits the attitudes best."""
    rng = np.random.default_rng(0)
    shots = [np.concatenate([w_G, _random_inertia(rng) if n else np.zeros(5)]) for n in range(STAGES[0][1])]
    for frames, most in STAGES:
        n = min(frames, len(t))
        fits = [
            least_squares(_attitude_residuals, x, args=(t[1:n], R[:n]), method="lm", max_nfev=MAX_EVALUATIONS)
            for x in shots[:most]
        ]
        fits.sort(key=lambda fit: float(fit.cost))
        shots = [fit.x for fit in fits]
        if n == len(t):
            break
    return shots[0], float(fits[0].cost) / n


def _random_inertia(rng: np.random.Generator) -> Array:
    axes = Rotation.random(rng=rng).as_matrix()
    second = axes @ np.diag(np.exp(rng.normal(0.0, SPREAD, 3))) @ axes.T
    xi, R_inertia = FORM.coordinates(second / np.cbrt(np.linalg.det(second)))
    assert np.array_equal(R_inertia, np.eye(3))
    return xi


def _attitude_residuals(x: Array, t: Array, R: Array) -> Array:
    """Rotations from predicted to known attitudes over their sigma, with a weak prior on the inertia."""
    J = inertia_from_second_moments(FORM.second_moments(np.clip(x[3:], -4.0, 4.0), np.eye(3)))
    turn, _ = _carry(x[:3], J, t)
    misses = rotation_vectors(np.swapaxes(R[0] @ turn, 1, 2) @ R[1:])
    return np.concatenate([misses.ravel() / SIGMA_RAD, x[3:]])


def _carry(w_G: Array, J_G: Array, t: Array) -> tuple[Array, Array]:
    turns = np.linalg.norm(w_G) * np.abs(t) / SERIES_RAD
    steps = np.clip(np.ceil(2.0 * turns), 1, 512).astype(np.int64)
    q, w, _, _ = propagate_rotations(np.tile(w_G, (len(t), 1)), J_G, np.asarray(t), steps)
    # a search may try rates at which the series overflows: such a shot is useless
    lost = ~(np.linalg.norm(q, axis=1) > 1e-6) | ~np.isfinite(q).all(axis=1) | ~np.isfinite(w).all(axis=1)
    q[lost], w[lost] = (1.0, 0.0, 0.0, 0.0), 0.0
    return matrices_from_quaternions(q), w


def _rates(time_s: Array, R_NG: Array, connected: Bools, first: int, w_G: Array, J_G: Array) -> Array:
    """Rates (F, 3) that lead from each frame to the next, forward and backward from frame ``first``."""
    out = np.tile(w_G, (len(time_s), 1))
    out[first:] = _rates_along(time_s[first:], R_NG[first:], connected[first:], w_G, J_G)
    # backward in time a body rotates as one with the opposite rate does forward
    back = slice(first, None, -1)
    out[back] = -_rates_along(-time_s[back], R_NG[back], connected[back], -out[first], J_G)
    return out


def _rates_along(time_s: Array, R_NG: Array, connected: Bools, w_G: Array, J_G: Array) -> Array:
    out = np.tile(w_G, (len(time_s), 1))
    for k in range(len(time_s) - 1):
        dt = time_s[k + 1 : k + 2] - time_s[k]
        if connected[k] and connected[k + 1]:
            fit = least_squares(_step_residuals, out[k], args=(dt, R_NG[k].T @ R_NG[k + 1], J_G), method="lm")
            if fit.cost < 0.5 * SIGMA_RAD**2:
                out[k] = fit.x
        out[k + 1] = _carry(out[k], J_G, dt)[1][0]
    return out


def _step_residuals(w_G: Array, dt: Array, turn: Array, J_G: Array) -> Array:
    return np.asarray(rotation_vectors((_carry(w_G, J_G, dt)[0][0].T @ turn)[None])[0])
