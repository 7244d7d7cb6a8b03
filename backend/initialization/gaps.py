"""Long stretches without a known pose: bridged by Euler's equation, not by a constant rate.

The axis of rotation of a tumbling body moves: over more than a quarter of a revolution a constant rate is a
poor prediction, and a solver that starts there ends with a revolution too many or with spurious disturbances.
The motion on both sides is fitted first, with loose steps between them; the state is then propagated across
with the inertia of that fit.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.initialization.initialize import robust_landmarks
from polhode.backend.problem.iterate import Iterate
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, log_so3, make_pose, matrix_from_wxyz
from polhode.records.estimate import InitialMotion
from polhode.records.tracks import StereoTracks

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
    return [gap for gap in gaps if rate * _duration(time_s, gap) > LONG_TURN_RAD]


def _duration(time_s: Array, gap: Gap) -> float:
    first = 0 if gap.before is None else gap.before
    return float(time_s[-1 if gap.after is None else gap.after] - time_s[first])


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
            left = _remaining_rotation(log_so3(attitude[-1].T @ R[gap.after]), opposite)
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


def _remaining_rotation(turn: Array, opposite: bool) -> Array:
    angle = float(np.linalg.norm(turn))
    if not opposite or angle < AMBIGUOUS_RAD:
        return turn
    return np.asarray(turn * (1.0 - 2.0 * np.pi / angle))


def gap_landmarks(tracks: StereoTracks, iterate: Iterate, initial: InitialMotion) -> Array:
    """Landmarks (L, 3) of the iterate; those seen only in frames without a known pose are placed again."""
    lost = ~initial.connected
    only_lost = np.bincount(tracks.landmark, initial.connected[tracks.frame], tracks.n_landmarks) == 0.0
    if not only_lost[tracks.landmark].any():
        return iterate.p_G
    X_RG = inverse_pose(tracks.X_NR) @ make_pose(iterate.R_NG, iterate.p_NG)
    p_G, _ = robust_landmarks(tracks, X_RG, lost)
    return np.where(only_lost[:, None], p_G, iterate.p_G)
