"""The rigid body: Euler's equations, energy, momentum (thesis eqs. 4.77, 4.86-4.88), symmetry of its axes.

Shared by the simulator's truth, the predictions and the checks of both.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from polhode.geometry.lie import Array, matrix_from_wxyz, wxyz_from_matrix

Wrench = Callable[[float], tuple[Array, Array]]
"""Time [s] -> (acceleration in N [m/s^2], torque in the body frame [N m])."""


def angular_acceleration(J: ArrayLike, w: ArrayLike, torque: ArrayLike = 0.0) -> Array:
    """Euler's equation, any body frame: J (3, 3) [kg m^2 or relative], w (..., 3) [rad/s] -> [rad/s^2]."""
    J, w = np.asarray(J, dtype=np.float64), np.asarray(w, dtype=np.float64)
    moment = np.asarray(torque, dtype=np.float64) - np.cross(w, w @ J.T)
    return np.asarray(moment @ np.linalg.inv(J).T)


def rotational_energy(J: ArrayLike, w: ArrayLike) -> Array:
    """Kinetic energy 0.5 w.J.w, w (..., 3) [rad/s] -> (...) [J, or relative to the scale of J]."""
    J, w = np.asarray(J, dtype=np.float64), np.asarray(w, dtype=np.float64)
    return np.asarray(0.5 * np.sum(w * (w @ J.T), axis=-1))


def angular_momentum_N(J: ArrayLike, R_NA: ArrayLike, w_A: ArrayLike) -> Array:
    """Angular momentum about the centre of mass, in N. R_NA (..., 3, 3), w_A (..., 3) -> (..., 3)."""
    h_A = np.asarray(w_A, dtype=np.float64) @ np.asarray(J, dtype=np.float64).T
    return np.asarray((np.asarray(R_NA, dtype=np.float64) @ h_A[..., None])[..., 0])


def propagate(
    t_s: ArrayLike,
    r_N: ArrayLike,
    v_N: ArrayLike,
    R_NA: ArrayLike,
    w_A: ArrayLike,
    J_A: ArrayLike,
    wrench: Wrench | None = None,
    rtol: float = 1e-12,
) -> tuple[Array, Array, Array, Array]:
    """Integrate the rigid body from t_s[0] to every t_s (n,) [s], increasing.

    State of the centre of mass r_N [m], v_N [m/s] (3,), attitude R_NA (3, 3), w_A (3,) [rad/s],
    inertia J_A (3, 3) in any body frame A. Returns r_N, v_N (n, 3), R_NA (n, 3, 3), w_A (n, 3).
    Dormand-Prince 8(5,3) on a quaternion; the quaternion is normalised at the output.
    """
    t = np.asarray(t_s, dtype=np.float64)
    J = np.asarray(J_A, dtype=np.float64)
    J_inv = np.linalg.inv(J)
    y0 = np.concatenate([np.asarray(r_N), np.asarray(v_N), wxyz_from_matrix(R_NA), np.asarray(w_A)])

    def derivative(time: float, y: Array) -> Array:
        accel, torque = wrench(time) if wrench is not None else (np.zeros(3), np.zeros(3))
        w, x, yq, z = y[6:10]
        p, q, r = y[10:13]
        q_dot = 0.5 * np.array(
            [-x * p - yq * q - z * r, w * p + yq * r - z * q, w * q + z * p - x * r, w * r + x * q - yq * p]
        )
        a, b, c = J @ y[10:13]
        # written out, as np.cross takes most of the time
        w_dot = J_inv @ (torque - np.array([q * c - r * b, r * a - p * c, p * b - q * a]))
        return np.concatenate([y[3:6], accel, q_dot, w_dot])

    if len(t) == 1:
        states = y0[None]
    else:
        solution = solve_ivp(derivative, (t[0], t[-1]), y0, "DOP853", t_eval=t, rtol=rtol, atol=rtol * 1e-2)
        if not solution.success:
            raise FloatingPointError(f"the rigid-body integration stopped: {solution.message}")
        states = solution.y.T
    q = states[:, 6:10] / np.linalg.norm(states[:, 6:10], axis=1, keepdims=True)
    return states[:, :3], states[:, 3:6], matrix_from_wxyz(q), states[:, 10:13]


HALF_TURNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Diagonals of the four rotations that keep the principal axes: none, and half-turns about x, y, z."""
HALF_TURN_NAMES = ("none", "x", "y", "z")


def nearest_half_turn(R_AP: Array, R_AQ: Array) -> Array:
    """The half-turn S (3, 3), or none, after which the axes R_AP S (3, 3) lie nearest to the axes R_AQ."""
    along = np.einsum("ij,ij->j", R_AP, R_AQ)
    return np.diag(HALF_TURNS[int(np.argmax(HALF_TURNS @ along))])


def best_half_turn(R_NP: Array, R_NP_true: Array) -> int:
    """Index into HALF_TURNS of the S that brings R_NP diag(S) nearest to the truth, over frames (F, 3, 3)."""
    between = np.swapaxes(R_NP, -1, -2) @ R_NP_true
    agreement = np.einsum("sk,fkk->s", HALF_TURNS, between)
    return int(np.argmax(agreement))
