"""From the initial poses into the right basin of attraction: brief solves from several initial guesses.

A single start was observed to end, with small sigmas, in a wrong minimum. The guesses differ in the inertia;
where the target rotates far between frames they also differ in the direction of rotation, which poses alone
do not determine.

Over long stretches without a known pose the axis of rotation of a tumbling body moves: a constant rate is a
poor prediction there, and a solver that starts from it ends with a revolution too many or with spurious
disturbances. The motion on both sides is fitted first, with loose steps between them; the state is then
propagated across by Euler's equation with the inertia of that fit.
"""

from dataclasses import dataclass, replace
from itertools import compress, pairwise

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.initialization.initialize import robust_landmarks
from polhode.backend.initialization.rates import FAST_HINT, intervals_differ, rate_branches, shoot
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.iterate import N_CAMERA, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit, linearization_point, recenter_inertia
from polhode.geometry.lie import (
    Array,
    Bools,
    exp_so3,
    hat,
    inverse_pose,
    log_so3,
    make_pose,
    matrix_from_wxyz,
)
from polhode.records.estimate import InitialMotion
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Advance

LONG_TURN_RAD = 0.5 * np.pi
"""A constant rate is good enough for shorter rotations."""
AMBIGUOUS_RAD = 0.5 * np.pi
"""Closing error at the pose after the gap; beyond it the opposite direction of rotation is tried too."""
CARRY_PSD = 1e-8
"""[(rad/s^2)^2/Hz] process noise that sets the accuracy of the integration."""


@dataclass(frozen=True)
class Gap:
    """Frames without a known pose, and the connected frames before and after (None at the ends)."""

    before: int | None
    after: int | None

    def inside(self, n_frames: int) -> range:
        """The frames without a known pose."""
        first = 0 if self.before is None else self.before + 1
        return range(first, n_frames if self.after is None else self.after)


def long_gaps(time_s: Array, connected: Bools, w_G: Array) -> list[Gap]:
    """Gaps over which the target rotates far; time_s (F,), connected (F,), w_G (F, 3) [rad/s]."""
    index = [int(k) for k in np.flatnonzero(connected)]
    last = len(time_s) - 1
    gaps = [Gap(a, b) for a, b in pairwise(index) if b > a + 1]
    gaps = ([Gap(None, index[0])] if index[0] > 0 else []) + gaps
    gaps += [Gap(index[-1], None)] if index[-1] < last else []
    rate = float(np.median(np.linalg.norm(w_G[index], axis=1)))
    ends = [(0 if gap.before is None else gap.before, -1 if gap.after is None else gap.after) for gap in gaps]
    long = [rate * float(time_s[last] - time_s[first]) > LONG_TURN_RAD for first, last in ends]
    return list(compress(gaps, long))


def loose_steps(n_frames: int, gaps: list[Gap]) -> Bools:
    """(F - 1,) the steps inside the gaps."""
    loose = np.zeros(n_frames - 1, dtype=np.bool_)
    for gap in gaps:
        inside = gap.inside(n_frames)
        loose[max(inside.start - 1, 0) : inside.stop] = True
    return loose


def propagate_through_gaps(
    iterate: Iterate, J_G: Array, time_s: Array, gaps: list[Gap], opposite: bool = False
) -> Iterate:
    """The iterate with the states inside the gaps propagated from one edge to the other.

    J_G (3, 3) any scale. opposite: where the propagated attitude is far from the known one after the gap,
    the closing error is made up by the rotation in the opposite direction.
    """
    R, w, v = iterate.R_NG.copy(), iterate.w_G.copy(), iterate.v_N.copy()
    r_N = iterate.p_NG + R @ iterate.com_G
    for gap in gaps:
        inside = gap.inside(len(time_s))
        start = gap.before if gap.before is not None else gap.after
        assert start is not None
        frames = np.array(
            [*inside, *([gap.after] if gap.before is not None and gap.after is not None else [])]
        )
        dt = time_s[frames] - time_s[start]
        turn, rate = _carry(w[start], J_G, dt)
        attitude, velocity = R[start] @ turn, v[start]
        if gap.before is not None and gap.after is not None:
            share = (dt / dt[-1])[:, None]
            left = log_so3(attitude[-1].T @ R[gap.after])
            angle = float(np.linalg.norm(left))
            if opposite and angle >= AMBIGUOUS_RAD:
                left = left * (1.0 - 2.0 * np.pi / angle)
            attitude = attitude @ exp_so3(share * left)
            rate = rate + share * (w[gap.after] - rate[-1])
            velocity = (r_N[gap.after] - r_N[start]) / dt[-1]
        n = len(inside)
        R[frames[:n]], w[frames[:n]], v[frames[:n]] = attitude[:n], rate[:n], velocity
        r_N[frames[:n]] = r_N[start] + dt[:n, None] * velocity
    return replace(iterate, R_NG=R, w_G=w, v_N=v, p_NG=r_N - R @ iterate.com_G)


def closing_error_rad(iterate: Iterate, J_G: Array, time_s: Array, gaps: list[Gap]) -> float:
    """Largest angle between the propagated attitude after a gap and the known one [rad]."""
    worst = 0.0
    for gap in gaps:
        if gap.before is None or gap.after is None:
            continue
        dt = time_s[[gap.after]] - time_s[gap.before]
        turn, _ = _carry(iterate.w_G[gap.before], J_G, dt)
        left = log_so3(turn[0].T @ iterate.R_NG[gap.before].T @ iterate.R_NG[gap.after])
        worst = max(worst, float(np.linalg.norm(left)))
    return worst


def _carry(w_G: Array, J_G: Array, dt_s: Array) -> tuple[Array, Array]:
    """Attitudes (n, 3, 3) relative to the start and rates (n, 3) after dt_s (n,), which may be negative."""
    # backward in time a body rotates as one with the opposite rate does forward
    sign = 1.0 if dt_s[0] > 0.0 else -1.0
    t, rates = np.abs(dt_s), np.tile(sign * w_G, (len(dt_s), 1))
    q, w, _, _ = propagate_rotations(rates, J_G, t, series_steps(rates, J_G, t, CARRY_PSD))
    return matrix_from_wxyz(q), sign * w


def gap_landmarks(tracks: StereoTracks, iterate: Iterate, initial: InitialMotion) -> Array:
    """Landmarks (L, 3) of the iterate; those seen only in frames without a known pose are placed again."""
    lost = ~initial.connected
    only_lost = np.bincount(tracks.landmark, initial.connected[tracks.frame], tracks.n_landmarks) == 0.0
    if not only_lost[tracks.landmark].any():
        return iterate.p_G
    X_RG = inverse_pose(tracks.X_NR) @ make_pose(iterate.R_NG, iterate.p_NG)
    p_G, _ = robust_landmarks(tracks, X_RG, lost)
    return np.where(only_lost[:, None], p_G, iterate.p_G)


PASSES = (3, 3, 3, 2)
"""Iterations of the solves of one hypothesis; references and whitening are renewed between them."""
SAME_INERTIA = 0.03
"""Two inertias (second moments of determinant 1) closer than this will end in the same minimum."""
N_HYPOTHESES = 5
"""Number of guesses of the inertia for each rotation between frames."""


@dataclass(frozen=True)
class InitialGuess:
    """A starting point: the unknowns, guesses of the inertia by name, and gaps between the poses."""

    iterate: Iterate
    guesses: dict[str, Array]
    gaps: list[Gap]
    tracks: StereoTracks
    initial: InitialMotion


@dataclass(frozen=True)
class HypothesisFit:
    """The fit of one hypothesis; its cost includes the normalization of the process noise."""

    iterate: Iterate
    cost: float
    misfit: float
    """cost without that normalization"""


@dataclass(frozen=True)
class KnownMotion:
    """A motion near the optimum: where frames are far apart, poses alone do not give it."""

    v_N: Array
    """(F, 3) velocity of the centre of mass [m/s]"""
    w_G: Array
    """(F, 3) [rad/s]"""
    com_G: Array
    """(3,) [m]"""
    second: Array
    """(3, 3) second moments in G, of determinant 1"""


def _start(tracks: StereoTracks, initial: InitialMotion, data: MotionData, known: KnownMotion) -> Iterate:
    """Poses and landmarks of ``initial``, the rest as known."""
    X_NG = tracks.X_NR @ initial.X_RG
    p_G, seen = robust_landmarks(tracks, initial.X_RG, initial.connected)
    if not seen.any():
        raise RunFailure(
            f"no consistent motion: no landmark is seen in a frame whose pose is known ({FAST_HINT})"
        )
    xi, R_inertia = data.form.coordinates(known.second)
    camera = np.zeros((len(X_NG), N_CAMERA)) if data.camera_is_noisy else None
    states = X_NG[:, :3, 3], X_NG[:, :3, :3], known.v_N, known.w_G
    return Iterate(*states, known.com_G, xi, R_inertia, p_G, camera)


def initial_guesses(
    tracks: StereoTracks, initial: InitialMotion, data: MotionData, max_rate_rad_s: float | None = None
) -> list[InitialGuess]:
    """Starting points from the initial poses, for each rotation between frames that may be (``rates``)."""
    use = np.flatnonzero(initial.connected)
    zero = np.zeros((tracks.n_frames, 3))
    base = _start(tracks, initial, data, KnownMotion(zero, zero, zero[0], np.eye(3)))
    com_G = np.median(base.p_G, axis=0)
    velocity = np.polyfit(tracks.time_s[use], (base.p_NG + base.R_NG @ com_G)[use], 1)[0]
    base = replace(base, com_G=com_G, v_N=np.tile(velocity, (tracks.n_frames, 1)))
    starts = []
    X_NG = tracks.X_NR @ initial.X_RG
    shots = shoot(tracks.time_s, base.R_NG, initial.connected, max_rate_rad_s)
    branches = rate_branches(tracks.time_s, X_NG, initial.connected, max_rate_rad_s)
    if shots and intervals_differ(data.dt_s):
        # the number of revolutions differs from interval to interval: only shots follow it
        branches = {suffix: shot.w_G for suffix, shot in shots.items()}
    for suffix, w_G in branches.items():
        hypotheses = inertia_hypotheses(base.R_NG[use], w_G[use])
        guesses = {name + suffix: guess for name, guess in hypotheses.items()}
        gaps = long_gaps(tracks.time_s, initial.connected, w_G)
        starts.append(InitialGuess(replace(base, w_G=w_G), guesses, gaps, tracks, initial))
    for suffix, shot in shots.items():
        iterate = replace(starts[0].iterate, w_G=shot.w_G)
        starts.append(replace(starts[0], iterate=iterate, guesses={"shooting" + suffix: shot.second}))
    return starts


def known_guess(
    tracks: StereoTracks, initial: InitialMotion, data: MotionData, known: KnownMotion
) -> InitialGuess:
    """The starting point of a motion that is known; the poses are those of ``initial``."""
    iterate = _start(tracks, initial, data, known)
    return InitialGuess(iterate, {"known": known.second}, [], tracks, initial)


def try_hypotheses(
    data: MotionData, starts: list[InitialGuess], advance: Advance
) -> dict[str, HypothesisFit]:
    """A brief solve from each guess, without those that diverge. Raises RunFailure if all diverge."""
    trials: dict[str, HypothesisFit] = {}
    for start in starts:
        of_start: dict[str, HypothesisFit] = {}
        at = start.iterate
        for name, second in start.guesses.items():
            trial = try_hypothesis(MotionFit(data, at), start, second, list(of_start.values()))
            advance()
            if trial is None:
                continue
            of_start[name] = trial
            # poses and landmarks of the best fit so far are the start of the next
            at = min(of_start.values(), key=lambda t: t.cost).iterate
        trials |= of_start
    if not trials:
        raise RunFailure(f"no consistent motion: every hypothesis of the inertia diverged ({FAST_HINT})")
    if len(bests := best_of_rotations(trials)) > 1:
        # the best of each rotation is solved further: their costs may differ by little
        for best in bests:
            refined = solve_briefly(MotionFit(data, trials[best].iterate), [], (10, 10, 10))
            trials[best] = trials[best] if refined is None else refined
    return trials


def best_of_rotations(trials: dict[str, HypothesisFit]) -> list[str]:
    """Of the hypotheses of each rotation between frames, the name of the one of least cost."""
    best: dict[str, str] = {}
    for name in sorted(trials, key=lambda name: trials[name].cost):
        best.setdefault(name.partition(",")[2], name)
    return list(best.values())


def try_hypothesis(
    at: MotionFit, start: InitialGuess, second: Array, found: list[HypothesisFit]
) -> HypothesisFit | None:
    """Brief solves from one guess of the inertia; None if they diverge."""
    data, (xi, R_inertia) = at.data, at.data.form.coordinates(second)
    at = MotionFit(data, replace(at.iterate, xi=xi, R_inertia=R_inertia))
    if not start.gaps:
        return solve_briefly(at, found)
    # each stretch by itself, then the states are propagated through the gaps
    separate = solve_briefly(at.with_data(loose=loose_steps(data.n_frames, start.gaps)), [])
    if separate is None:
        return None
    J_G, time_s = separate.iterate.J_G(data.form), start.tracks.time_s
    ambiguous = closing_error_rad(separate.iterate, J_G, time_s, start.gaps) > AMBIGUOUS_RAD
    trials = []
    for opposite in (False, True) if ambiguous else (False,):
        iterate = propagate_through_gaps(separate.iterate, J_G, time_s, start.gaps, opposite)
        iterate = replace(iterate, p_G=gap_landmarks(start.tracks, iterate, start.initial))
        trial = solve_briefly(MotionFit(data, iterate), [] if ambiguous else found)
        trials += [trial] if trial is not None else []
    return min(trials, key=lambda trial: trial.cost, default=None)


def solve_briefly(
    fit: MotionFit, found: list[HypothesisFit], passes: tuple[int, ...] = PASSES, recenter: bool = True
) -> HypothesisFit | None:
    """A few iterations; if they approach the inertia of a fit found before, that fit, whose cost is known.

    ``recenter``: the reference of the inertia, too, is renewed between the passes. None: they diverge.
    """
    data, iterate, solver, cost = fit.data, fit.iterate, GaussNewton(fit.data), np.inf
    for iterations in passes:
        try:
            iterate = recenter_inertia(data, iterate) if recenter else iterate
            fixed = linearization_point(data, iterate)
            solution = solver.solve(fixed, iterate.vector(), iterations)
        except LinAlgError:
            return None
        iterate, cost = iterate.moved_to(solution.x), solution.cost + fixed.steps.half_log_det
        for other in found:
            if np.abs(iterate.J_G(data.form) - other.iterate.J_G(data.form)).max() < SAME_INERTIA:
                return other
    return HypothesisFit(iterate, float(cost), float(solution.cost)) if np.isfinite(cost) else None


def inertia_hypotheses(R_NG: Array, w_G: Array) -> dict[str, Array]:
    """Second moments (3, 3) in G by name, from attitudes (F, 3, 3) and body rates (F, 3) [rad/s]."""
    guesses = {"sphere": np.eye(3)}
    J = inertia_from_momentum(R_NG, w_G)
    if J is not None:
        guesses["momentum"] = second_moments_from_inertia(J)
    # the principal direction of the rates, and the direction across it in which they vary most
    axis = np.linalg.eigh(w_G.T @ w_G + 1e-12 * np.eye(3))[1][:, -1]
    along = np.outer(axis, axis)
    across = w_G @ (hat(axis) @ hat(axis))
    spread = across.T @ across + 1e-12 * np.diag([1.0, 0.9, 0.8]) - 1e3 * along
    side = np.linalg.eigh(spread)[1][:, -1]
    # an elongated body has a large second moment along its axis and a small moment of inertia about it
    guesses["prolate"] = np.eye(3) + 1.5 * along
    guesses["oblate"] = np.eye(3) - 0.6 * along
    guesses["flat across"] = np.eye(3) + 1.0 * along - 0.5 * np.outer(side, side)
    return guesses


def inertia_from_momentum(R_NG: Array, w_G: Array) -> Array | None:
    """J (3, 3) for which R J w is most nearly constant, I + D with a unit prior on D; None if not physical.

    The momentum itself is eliminated as a mean. The noise of the rates, from their second differences, sets
    the weight of the data against that of the sphere.
    """
    if len(w_G) < 4:
        return None
    x, y, z = w_G[:, 0], w_G[:, 1], w_G[:, 2]
    o = np.zeros_like(x)
    columns = [[x, o, o, y, z, o], [o, y, o, x, o, z], [o, o, z, o, x, y]]
    h = R_NG @ np.stack([np.stack(row, axis=-1) for row in columns], axis=1)
    rows = (h - h.mean(axis=0)).reshape(-1, 6)
    curvature = np.diff(w_G, 2, axis=0)
    noise = np.median(np.abs(curvature)) / 0.6745 / np.sqrt(6.0) + 1e-6
    sphere = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    normal = rows.T @ rows + noise**2 * np.eye(6)
    a, b, c, d, e, f = sphere + np.linalg.solve(normal, -rows.T @ (rows @ sphere))
    J = np.array([[a, d, e], [d, b, f], [e, f, c]])
    values = np.linalg.eigvalsh(J)
    return J if values[0] > 0.0 and values[0] + values[1] > values[2] else None
