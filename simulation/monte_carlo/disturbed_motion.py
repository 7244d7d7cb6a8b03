"""A rigid body under white disturbances, constant over small steps, by a fourth-order method."""

import numpy as np

from polhode.compiled import compiled
from polhode.lie import Array, exp_so3


def disturbed_motion(
    start: tuple[Array, Array, Array, Array], J: Array, h: float, accel_N: Array, torque_G: Array
) -> tuple[Array, Array, Array, Array]:
    """r_N, v_N (n + 1, 3), R_NG (n + 1, 3, 3), w_G (n + 1, 3): the start, and after each of n steps of h [s].

    start: r_N, v_N, R_NG, w_G of the centre of mass. J (3, 3) inertia; accel_N (n, 3) [m/s^2],
    torque_G (n, 3) in units of J over s^2. Euler's equation by classical Runge-Kutta, the attitude by the
    Magnus expansion of fourth order: mean rate and the commutator of its slope.
    """
    r, v, R, w = start
    v_N = v + np.concatenate([np.zeros((1, 3)), np.cumsum(h * accel_N, axis=0)])
    r_N = r + np.concatenate([np.zeros((1, 3)), np.cumsum(h * v_N[:-1] + 0.5 * h * h * accel_N, axis=0)])
    w_G, turn = _rates(
        np.asarray(w, dtype=np.float64), J, np.asarray(np.linalg.inv(J), dtype=np.float64), torque_G, h
    )
    return r_N, v_N, _turned(np.ascontiguousarray(R), exp_so3(turn)), w_G


@compiled
def _acceleration(J: Array, J_inv: Array, w: Array, torque: Array) -> Array:
    h, moment, out = np.zeros(3), np.empty(3), np.zeros(3)
    for a in range(3):
        for b in range(3):
            h[a] += J[a, b] * w[b]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        moment[a] = torque[a] - w[b] * h[c] + w[c] * h[b]
    for a in range(3):
        for b in range(3):
            out[a] += J_inv[a, b] * moment[b]
    return out


@compiled
def _rates(w: Array, J: Array, J_inv: Array, torque: Array, h: float) -> tuple[Array, Array]:
    """Rates (n + 1, 3), and the rotation vectors (n, 3) of the steps."""
    n = len(torque)
    rates, turn = np.empty((n + 1, 3)), np.empty((n, 3))
    rates[0] = w
    for k in range(n):
        w = rates[k]
        a1 = _acceleration(J, J_inv, w, torque[k])
        a2 = _acceleration(J, J_inv, w + 0.5 * h * a1, torque[k])
        a3 = _acceleration(J, J_inv, w + 0.5 * h * a2, torque[k])
        a4 = _acceleration(J, J_inv, w + h * a3, torque[k])
        after = w + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        turn[k] = h * (w + h * (a1 + a2 + a3) / 6.0) + h * h / 12.0 * np.cross(w, after)
        rates[k + 1] = after
    return rates, turn


@compiled
def _turned(R: Array, steps: Array) -> Array:
    """R (3, 3) and its products with the steps (n, 3, 3), one after the other: (n + 1, 3, 3)."""
    out = np.zeros((len(steps) + 1, 3, 3))
    out[0] = R
    for k in range(len(steps)):
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    out[k + 1, a, b] += out[k, a, c] * steps[k, c, b]
    return out
