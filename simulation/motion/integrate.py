"""The rigid body under forces that jump, with friction inside: integrated from jump to jump.

State y (13,): r_N [m], v_N [m/s], quaternion of R_NP (w, x, y, z), angular momentum h_P [N m s].

Friction is that of a body with a ball inside, in a thin layer of a viscous fluid; the ball follows the body
at once, as it does where the fluid is thick (Chernous'ko, "Motion of a rigid body with cavities containing a
viscous fluid", NASA TT F-665, 1972). With the ball's moment I and the layer's coefficient c the whole has
h = J w - f dw/dt with f = I^2/c [kg m^2 s], so the body turns at w = J^-1 h + f J^-2 (h x J^-1 h). The
momentum in N stays exactly, and the energy h.J^-1 h / 2 falls by f |dw/dt|^2 per second.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from polhode.lie import Array

STAGES = DOP853.n_stages
A, B, C = np.array(DOP853.A), np.array(DOP853.B), np.array(DOP853.C)
"""Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., section II.5."""
LARGEST_TURN = 0.1
"""Rotation within one step [rad]; the error of a step is then below rounding."""
STEPS_PER_PERIOD = 60.0


class Forces(NamedTuple):
    """What acts on the target after the first frame, and its inertia. n knots, m sines."""

    moments: Array
    """(3,) [kg m^2]"""
    knots_s: Array
    """(n,) where something jumps, increasing; segment i ends at knot i [s]"""
    accel_N: Array
    """(n + 1, 3) constant within a segment [m/s^2]"""
    torque_P: Array
    """(n + 1, 3) [N m]"""
    sines: Array
    """(m, 9): start [s], end [s], angular frequency [rad/s], amplitudes of acceleration and torque"""
    drag_hz: float
    """Torque against the angular momentum, over it [1/s]"""
    friction: float
    """Square of the ball's moment over the layer's coefficient [kg m^2 s]"""


@njit(cache=True)
def body_rate(h_P: Array, moments: Array, friction: float) -> Array:
    """Angular velocity w_P (3,) [rad/s] of a body whose momentum is h_P (3,)."""
    w = h_P / moments
    return w + friction * _cross(h_P, w) / moments**2


@njit(cache=True)
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


@njit(cache=True)
def _within_segment(y: Array, start_s: float, end_s: float, segment: int, forces: Forces) -> Array:
    """Equal steps over a span in which nothing jumps."""
    duration = end_s - start_s
    middle = 0.5 * (start_s + end_s)
    sines = forces.sines[(forces.sines[:, 0] <= middle) & (middle < forces.sines[:, 1])]
    torque = np.linalg.norm(forces.torque_P[segment])
    fastest = 0.0
    for k in range(len(sines)):
        torque += np.linalg.norm(sines[k, 6:9])
        fastest = max(fastest, sines[k, 2])
    rate = np.linalg.norm(body_rate(y[10:13], forces.moments, forces.friction))
    rate += torque * abs(duration) / forces.moments[2]
    turn = max(rate / LARGEST_TURN, fastest * STEPS_PER_PERIOD / (2.0 * np.pi)) * abs(duration)
    steps = max(int(np.ceil(turn)), 1)
    for k in range(steps):
        time = start_s + duration * k / steps
        y = _step(y, time, duration / steps, segment, sines, forces)
    return y


@njit(cache=True)
def _step(y: Array, time_s: float, step_s: float, segment: int, sines: Array, forces: Forces) -> Array:
    """One step of order eight."""
    slopes = np.empty((STAGES, 13))
    for i in range(STAGES):
        inner = y.copy()
        for j in range(i):
            if A[i, j] != 0.0:
                inner += step_s * A[i, j] * slopes[j]
        slopes[i] = _slope(inner, time_s + C[i] * step_s, segment, sines, forces)
    out = y.copy()
    for i in range(STAGES):
        out += step_s * B[i] * slopes[i]
    out[6:10] /= np.linalg.norm(out[6:10])
    return out


@njit(cache=True)
def _slope(y: Array, time_s: float, segment: int, sines: Array, forces: Forces) -> Array:
    accel = forces.accel_N[segment].copy()
    torque = forces.torque_P[segment] - forces.drag_hz * y[10:13]
    for k in range(len(sines)):
        wave = np.sin(sines[k, 2] * (time_s - sines[k, 0]))
        accel += wave * sines[k, 3:6]
        torque += wave * sines[k, 6:9]
    rate = body_rate(y[10:13], forces.moments, forces.friction)
    p, q, r = rate
    w, x, yq, z = y[6:10]
    out = np.empty(13)
    out[0:3] = y[3:6]
    out[3:6] = accel
    out[6] = 0.5 * (-x * p - yq * q - z * r)
    out[7] = 0.5 * (w * p + yq * r - z * q)
    out[8] = 0.5 * (w * q + z * p - x * r)
    out[9] = 0.5 * (w * r + x * q - yq * p)
    out[10:13] = _cross(y[10:13], rate) + torque
    return out


@njit(cache=True)
def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def free_of_forces(moments: Array) -> Forces:
    """Nothing acts on a body of the principal moments (3,) [kg m^2]."""
    none = np.zeros((1, 3))
    return Forces(np.asarray(moments, dtype=np.float64), np.zeros(0), none, none, np.zeros((0, 9)), 0.0, 0.0)
