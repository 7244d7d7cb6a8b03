"""Integration of a rigid body under piecewise continuous forces, with internal friction.

Unlike polhode.geometry.rigid_body, whose motion is free, this integrates from one discontinuity of the forces
to the next.

State y (13,): r_N [m], v_N [m/s], quaternion of R_NP (w, x, y, z), angular momentum h_P [N m s].

Friction is that of a body with a ball inside that lags slightly behind in a thin layer of viscous fluid:
with the ball's moment I and the layer's coefficient c its momentum relative to the body is -f dw/dt,
f = I^2/c [kg m^2 s] (quasi-static, as Chernous'ko, "Motion of a rigid body with cavities containing a viscous
fluid", NASA TT F-665, 1972). The whole has h = J w - f dw/dt and the rate w = J^-1 h + f J^-2 (h x J^-1 h).
Its momentum in N is constant exactly; its energy h.J^-1 h / 2 decreases at f |J^-1 (h x J^-1 h)|^2.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853

from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled

STAGES = DOP853.n_stages
A, B = np.array(DOP853.A), np.array(DOP853.B)
"""Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., section II.5."""
MAX_ROTATION_RAD = 0.1
"""Rotation within one step [rad]; the error of a step is then below rounding."""


class Forces(NamedTuple):
    """Forces and torques on the target after the first frame, and its inertia. n knots."""

    moments: Array
    """(3,) [kg m^2]"""
    knots_s: Array
    """(n,) times of discontinuities, increasing; segment i ends at knot i [s]"""
    accel_N: Array
    """(n + 1, 3) constant within a segment [m/s^2]"""
    torque_P: Array
    """(n + 1, 3) [N m]"""
    drag_hz: float
    """Torque against the angular momentum, over it [1/s]"""
    friction: float
    """Square of the ball's moment over the layer's coefficient [kg m^2 s]"""


@compiled
def body_rate(h_P: Array, moments: Array, friction: float) -> Array:
    """Angular velocity w_P (3,) [rad/s] of a body whose momentum is h_P (3,)."""
    w = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cross = h_P[j] * h_P[k] * (1.0 / moments[k] - 1.0 / moments[j])
        w[i] = (h_P[i] + friction * cross / moments[i]) / moments[i]
    return w


@compiled
def advance(y: Array, start_s: float, stop_s: float, forces: Forces) -> Array:
    """State (13,) at stop_s from the state at start_s, forwards or backwards in time [s]."""
    knots = forces.knots_s
    time = start_s
    while time != stop_s:
        if stop_s > time:
            segment = int(np.searchsorted(knots, time, side="right"))
            ends_here = segment == len(knots) or knots[segment] > stop_s
            end = stop_s if ends_here else knots[segment]
        else:
            segment = int(np.searchsorted(knots, time, side="left"))
            ends_here = segment == 0 or knots[segment - 1] < stop_s
            end = stop_s if ends_here else knots[segment - 1]
        y = _within_segment(y, time, end, segment, forces)
        time = end
    return y


@compiled
def _within_segment(y: Array, start_s: float, end_s: float, segment: int, forces: Forces) -> Array:
    """Equal steps over a span without discontinuities."""
    duration = end_s - start_s
    rate = np.abs(body_rate(y[10:13], forces.moments, forces.friction)).sum()
    rate += np.abs(forces.torque_P[segment]).sum() * abs(duration) / forces.moments[2]
    per_second = max(rate / MAX_ROTATION_RAD, forces.drag_hz)
    steps = max(int(np.ceil(per_second * abs(duration))), 1)
    for _ in range(steps):
        y = _step(y, duration / steps, segment, forces)
    return y


@compiled
def _step(y: Array, step_s: float, segment: int, forces: Forces) -> Array:
    """One step of order eight."""
    slopes = np.empty((STAGES, 13))
    for i in range(STAGES):
        inner = y.copy()
        for j in range(i):
            for n in range(13):
                inner[n] += step_s * A[i, j] * slopes[j, n]
        _slope(inner, segment, forces, slopes[i])
    out = y.copy()
    for i in range(STAGES):
        for n in range(13):
            out[n] += step_s * B[i] * slopes[i, n]
    length = np.sqrt(out[6] ** 2 + out[7] ** 2 + out[8] ** 2 + out[9] ** 2)
    for n in range(6, 10):
        out[n] /= length
    return out


@compiled
def _slope(y: Array, segment: int, forces: Forces, out: Array) -> None:
    """Derivative of the state, written to out (13,)."""
    rate = body_rate(y[10:13], forces.moments, forces.friction)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = y[3 + i]
        out[3 + i] = forces.accel_N[segment, i]
        out[10 + i] = y[10 + j] * rate[k] - y[10 + k] * rate[j]
        out[10 + i] += forces.torque_P[segment, i] - forces.drag_hz * y[10 + i]
    w, x, yq, z = y[6], y[7], y[8], y[9]
    out[6] = 0.5 * (-x * rate[0] - yq * rate[1] - z * rate[2])
    out[7] = 0.5 * (w * rate[0] + yq * rate[2] - z * rate[1])
    out[8] = 0.5 * (w * rate[1] + z * rate[0] - x * rate[2])
    out[9] = 0.5 * (w * rate[2] + x * rate[1] - yq * rate[0])


def states_at(y: Array, t_s: Array, forces: Forces) -> Array:
    """States (T, 13) at the times (T,), from the state y (13,) at the first of them."""
    states = [y]
    for before, after in pairwise(t_s):
        states.append(advance(states[-1], before, after, forces))
    return np.stack(states)


def no_forces(moments: Array) -> Forces:
    """No forces on a body of the principal moments (3,) [kg m^2]."""
    none = np.zeros((1, 3))
    return Forces(np.asarray(moments, dtype=np.float64), np.zeros(0), none, none, 0.0, 0.0)
