"""Body rates from attitudes, in both directions where rotations are large, and by shooting; jumps.

Near half a revolution between frames, poses alone do not determine the direction of rotation: a rotation by
200 degrees leads to the same attitude as one by 160 degrees in the opposite direction. Euler's equation
distinguishes the two if the axis of rotation moves in the body; otherwise both fit. The mean rate between two
frames is then a poor estimate of the rate at either, but a few consecutive attitudes determine rate and
inertia by Euler's equation: shots from many inertias are compared over more and more frames (single shooting;
Stoer and Bulirsch, "Introduction to Numerical Analysis", 7.3).

A body whose sides look alike (by a half-turn about the axis of a panel, for example) may give frames with few
features a pose that is wrong by that symmetry. No rigid body jumps and jumps back; such frames are better
interpolated, and located again later.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from polhode.backend.dynamics.propagation import propagate_rotations
from polhode.backend.dynamics.so3_exp import matrices_from_quaternions, rotation_vectors
from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, log_so3

SHOOTING_RAD = np.deg2rad(60.0)
"""Median rotation between neighbouring frames above which shooting is worth its time."""
STAGES = ((4, 24), (6, 8), (10, 4), (16, 2))
"""Consecutive frames, and number of shots, in each stage."""
SPREAD = 0.7
"""Standard deviation of the logarithms of the second moments that are tried."""
SIGMA_RAD = 0.01
"""Standard deviation of an attitude, disturbances included."""
MAX_EVALUATIONS = 200
"""Largest number of evaluations for one shot in one stage."""
CLEAR_RATIO = 10.0
"""Of the misfits of shots: where intervals differ, a wrong number of revolutions has some thousand."""
MIN_DIFFERENCE = 0.03
"""Of intervals from multiples of the median one, by which the number of revolutions shows."""
SERIES_RAD = 1.0
"""Rotation that one Taylor series covers."""
FORM = FORMS["second_moments"]


@dataclass(frozen=True)
class Shot:
    """Second moments (3, 3), rates (F, 3) [rad/s] at every frame, and the misfit of the last stage."""

    second: Array
    w_G: Array
    misfit: float


def shoot(
    time_s: Array, R_NG: Array, connected: Bools, max_rate_rad_s: float | None = None
) -> dict[str, Shot]:
    """The best shot of each rotation between frames, by suffix of the hypothesis; none for short rotations.

    Where intervals differ, rotations up to a revolution in the median interval are tried, and shots that do
    not follow all the attitudes are left out. time_s (F,), R_NG (F, 3, 3), connected (F,); max_rate_rad_s as
    in ``rate_branches``.
    """
    index = np.flatnonzero(connected)
    run = max(np.split(index, np.flatnonzero(np.diff(index) > 1) + 1), key=len)
    if len(run) < STAGES[0][0]:
        return {}
    t, R = time_s[run] - time_s[run[0]], R_NG[run]
    turn = log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    middle, dt_s = float(np.median(np.linalg.norm(turn, axis=1))), float(np.median(np.diff(t)))
    differ = intervals_differ(np.diff(t))
    count = n_rotations(middle, dt_s, max_rate_rad_s)
    if middle < SHOOTING_RAD and count < 2 and not (differ and _rates_scatter(turn, np.diff(t))):
        return {}
    angle = max(float(np.linalg.norm(turn[0])), 1e-6)
    if differ:
        count = n_rotations(angle, float(t[1]), max_rate_rad_s or 2.0 * np.pi / dt_s)
    shots = {}
    for suffix, more in list(zip(ROTATIONS, REVOLUTIONS, strict=True))[:count]:
        first = turn[0] * (1.0 + 2.0 * np.pi * more / angle)
        x, misfit = _best(t, R, first / t[1])
        second = FORM.second_moments(x[3:], np.eye(3))
        w_G = _rates(time_s, R_NG, connected, int(run[0]), x[:3], inertia_from_second_moments(second))
        shots[suffix] = Shot(second, w_G, misfit)
    if differ:
        least = min(shot.misfit for shot in shots.values())
        shots = {
            suffix: shot for suffix, shot in shots.items() if shot.misfit <= CLEAR_RATIO * max(least, 1.0)
        }
    return shots


def intervals_differ(dt_s: Array) -> bool:
    """Whether intervals (n,) tell rotations apart: a quarter of them are no multiples of the median one."""
    share = dt_s / np.median(dt_s)
    return bool(np.quantile(np.abs(share - np.round(share)), 0.75) > MIN_DIFFERENCE)


def _rates_scatter(turn: Array, dt_s: Array) -> bool:
    """Whether the shortest rotations (n, 3) over intervals (n,) are not those of one steady motion."""
    rate = np.linalg.norm(turn, axis=1) / dt_s
    return bool(np.median(np.abs(np.diff(rate))) > 0.2 * np.median(rate))


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


AMBIGUOUS_TURN_RAD = np.deg2rad(90.0)
"""Median rotation between neighbouring frames above which both directions are tried, without a limit."""
OPPOSITE_DIRECTION = ", opposite direction"
ROTATIONS = (
    "", OPPOSITE_DIRECTION, ", a revolution more", ", opposite direction and a revolution more",
)  # fmt: skip
"""Suffixes of the names of hypotheses: rotations between frames that lead to the same attitudes, by length"""
REVOLUTIONS = (0, -1, 1, -2)
"""That each of them adds to the shortest rotation"""
MIN_INTERVALS = 3
FAST_HINT = "a possible cause: the target rotates by more than half a revolution between pairs"
"""Beyond the rotations that are tried in both directions, poses show the shorter one, which no body
follows."""
JUMP_RAD = np.deg2rad(60.0)
"""A larger deviation from the local rate is a jump; nutation causes smaller ones."""
FAR_RAD = np.deg2rad(75.0)
"""With larger rotations between frames any tumbling motion seems to jump."""
NEIGHBOURS = 9
"""Number of intervals whose median is the local rate."""
MAX_SHARE = 0.25
"""Share of the connected frames; a longer stretch is not the outlier."""


def interval_rates(time_s: Array, R_NG: Array) -> tuple[Array, Array]:
    """Mean body rate (n - 1, 3) [rad/s] over each interval, below half a revolution, and its middle time."""
    dt = np.diff(time_s)
    turn = log_so3(np.swapaxes(R_NG[:-1], 1, 2) @ R_NG[1:])
    return turn / dt[:, None], 0.5 * (time_s[:-1] + time_s[1:])


def frame_rates(time_s: Array, X_NG: Array, connected: Bools) -> Array:
    """Body rate at each frame (F, 3) [rad/s] by differences between connected neighbours."""
    index: Ints = np.flatnonzero(connected)
    rates, centres = interval_rates(time_s[index], X_NG[index, :3, :3])
    short = np.diff(index) <= 3
    if short.any():
        rates, centres = rates[short], centres[short]
    return interpolated_rates(time_s, centres, rates)


def interpolated_rates(time_s: Array, centres_s: Array, rates: Array) -> Array:
    """Rates (F, 3) at times (F,), interpolated linearly between those (n, 3) at centres_s (n,)."""
    return np.stack([np.interp(time_s, centres_s, rates[:, axis]) for axis in range(3)], axis=1)


def n_rotations(turn_rad: float, dt_s: float, max_rate_rad_s: float | None) -> int:
    """How many of ROTATIONS are compared where the shortest one between two frames is turn_rad."""
    if max_rate_rad_s is None:
        return 1 if turn_rad < AMBIGUOUS_TURN_RAD else 2
    lengths = np.abs(turn_rad + 2.0 * np.pi * np.array(REVOLUTIONS))
    return max(int(np.sum(lengths <= max_rate_rad_s * dt_s)), 1)


def rate_branches(
    time_s: Array, X_NG: Array, connected: Bools, max_rate_rad_s: float | None = None
) -> dict[str, Array]:
    """Body rates (F, 3) [rad/s] by suffix of the hypothesis, the shortest rotations first.

    time_s (F,), X_NG (F, 4, 4), connected (F,); max_rate_rad_s: all rotations up to it; None: one, or both
    directions of large rotations.
    """
    short = frame_rates(time_s, X_NG, connected)
    index: Ints = np.flatnonzero(connected[:-1] & connected[1:])
    if len(index) < MIN_INTERVALS:
        return {"": short}
    R, dt = X_NG[:, :3, :3], np.diff(time_s)[index]
    turn = log_so3(np.swapaxes(R[index], 1, 2) @ R[index + 1])
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    count = n_rotations(float(np.median(angle)), float(np.median(dt)), max_rate_rad_s)
    if count < 2:
        return {"": short}
    centre = 0.5 * (time_s[index] + time_s[index + 1])
    # the direction that most of the rotations share up to sign, and those against it by a revolution more
    unit = turn / np.maximum(angle, 1e-9)
    axis, found = np.linalg.eigh(unit.T @ unit)[1][:, -1], {}
    for sign in (1.0, -1.0):
        against = (turn @ (sign * axis) < 0.0)[:, None]
        for more in range((len(REVOLUTIONS) + 1) // 2):
            rate = (turn + np.where(against, -1.0 - more, more) * 2.0 * np.pi * unit) / dt[:, None]
            found[float(np.median(np.linalg.norm(rate, axis=1)))] = interpolated_rates(time_s, centre, rate)
    return {suffix: found[length] for suffix, length in zip(ROTATIONS[:count], sorted(found), strict=False)}


def jumping_frames(time_s: Array, R_NG: Array, connected: Bools) -> Bools:
    """(F,) frames without which the rotation is smooth; time_s (F,), R_NG (F, 3, 3), connected (F,)."""
    index: Ints = np.flatnonzero(connected)
    odd = np.zeros(len(time_s), dtype=np.bool_)
    if len(index) < NEIGHBOURS:
        return odd
    local = _local_rates(time_s[index], R_NG[index])
    if np.median(np.linalg.norm(local[0], axis=1)) * np.median(np.diff(time_s[index])) > FAR_RAD:
        return odd
    errors = [_prediction_error_rad(time_s, R_NG, a, b, local) for a, b in pairwise(index)]
    stretches: list[Ints] = list(np.split(index, np.flatnonzero(np.array(errors) > JUMP_RAD) + 1))
    limit = MAX_SHARE * len(index)
    while len(stretches) > 1:
        n = _odd_one(time_s, R_NG, stretches, local)
        if n is None or len(stretches[n]) > limit:
            break
        odd[stretches[n]] = True
        inner = [np.concatenate([stretches[n - 1], stretches[n + 1]])] if 0 < n < len(stretches) - 1 else []
        stretches = (
            [*stretches[: max(n - 1, 0)], *inner, *stretches[n + 2 :]]
            if inner
            else (stretches[1:] if n == 0 else stretches[:-1])
        )
    return odd


def _odd_one(time_s: Array, R_NG: Array, stretches: list[Ints], local: tuple[Array, Array]) -> int | None:
    """The shortest stretch without which its neighbours fit together; else the shorter one at the ends."""
    joining = [
        n
        for n in range(1, len(stretches) - 1)
        if _prediction_error_rad(time_s, R_NG, stretches[n - 1][-1], stretches[n + 1][0], local) < JUMP_RAD
    ]
    if joining:
        return min(joining, key=lambda n: len(stretches[n]))
    return min((0, len(stretches) - 1), key=lambda n: len(stretches[n]))


def _local_rates(time_s: Array, R_NG: Array) -> tuple[Array, Array]:
    """Median body rate (n - 1, 3) [rad/s] around each interval, and the intervals' middles (n - 1,) [s]."""
    rate, middle = interval_rates(time_s, R_NG)
    half = NEIGHBOURS // 2
    windows = [rate[max(0, k - half) : k + half + 1] for k in range(len(rate))]
    return np.stack([np.median(window, axis=0) for window in windows]), middle


def _prediction_error_rad(time_s: Array, R_NG: Array, a: int, b: int, local: tuple[Array, Array]) -> float:
    """Angle [rad] between the attitude of frame b and its prediction from frame a by the local rate."""
    rate, centre = local
    middle = 0.5 * (time_s[a] + time_s[b])
    here = interpolated_rates(np.array([middle]), centre, rate)[0]
    expected = R_NG[a] @ exp_so3(here * (time_s[b] - time_s[a]))
    return float(np.linalg.norm(log_so3(expected.T @ R_NG[b])))
