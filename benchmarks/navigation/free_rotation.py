"""How a free body turns between two images: attitude, rate, their errors' growth, what disturbances add.

The equations of `polhode.rigid_body.propagate` and `planning.prediction.process_noise`, which integrate with
error control, here in one loop of fixed steps (Runge and Kutta, fourth order): a filter asks for many short
ways.
"""

import numpy as np

from polhode.compiled import compiled_ieee
from polhode.lie import Array
from polhode.quaternion import matrix_from_wxyz

TURN_A_STEP_RAD = 0.03
"""Of the body in one step of the integration."""


def turn_freely(
    moments: Array, w_P: Array, dt_s: float, torque_psd: float
) -> tuple[Array, Array, Array, Array]:
    """From the rate w_P (3,) [rad/s], for dt_s [s], in the principal axes with moments (3,), middle one 1.

    Returns the turn (3, 3), R_NP = R_NP before @ turn; the rate (3,); Phi (6, 6), by which errors of theta
    and w grow; Q (6, 6), the covariance of what white torque adds: torque_psd [(rad/s^2)^2/Hz], over the
    middle moment. theta' = -w x theta + dw;  dw' = J^-1 ((J w) x - w x J) dw.
    """
    steps = max(1, int(np.ceil(dt_s * float(np.linalg.norm(w_P)) / TURN_A_STEP_RAD)))
    y = np.zeros(79)
    y[0], y[4:7], y[7:43] = 1.0, w_P, np.eye(6).ravel()
    _integrate(np.ascontiguousarray(moments), y, dt_s / steps, steps, torque_psd)
    turn = matrix_from_wxyz(y[:4] / np.linalg.norm(y[:4]))
    return turn, y[4:7], y[7:43].reshape(6, 6), y[43:].reshape(6, 6)


@compiled_ieee
def _integrate(moments: Array, y: Array, h: float, steps: int, psd: float) -> None:
    """Carry y (79,) on in place: quaternion, rate, Phi and Q by rows."""
    slope, total = np.empty(79), np.empty(79)
    for _ in range(steps):
        _derivative(moments, y, psd, slope)
        total[:] = slope
        _derivative(moments, y + 0.5 * h * slope, psd, slope)
        total += 2.0 * slope
        _derivative(moments, y + 0.5 * h * slope, psd, slope)
        total += 2.0 * slope
        _derivative(moments, y + h * slope, psd, slope)
        total += slope
        y += h / 6.0 * total


@compiled_ieee
def _derivative(moments: Array, y: Array, psd: float, out: Array) -> None:
    """Derivative (79,) of y in time."""
    a, b, c = y[4], y[5], y[6]
    out[0] = 0.5 * (-y[1] * a - y[2] * b - y[3] * c)
    out[1] = 0.5 * (y[0] * a + y[2] * c - y[3] * b)
    out[2] = 0.5 * (y[0] * b + y[3] * a - y[1] * c)
    out[3] = 0.5 * (y[0] * c + y[1] * b - y[2] * a)
    A = np.zeros((6, 6))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        share = (moments[j] - moments[k]) / moments[i]
        out[4 + i] = share * y[4 + j] * y[4 + k]
        A[i, j], A[i, k], A[i, 3 + i] = y[4 + k], -y[4 + j], 1.0
        A[3 + i, 3 + j], A[3 + i, 3 + k] = share * y[4 + k], share * y[4 + j]
    for i in range(6):
        for j in range(6):
            grown, added = 0.0, 0.0
            for k in range(6):
                grown += A[i, k] * y[7 + 6 * k + j]
                added += A[i, k] * y[43 + 6 * k + j] + A[j, k] * y[43 + 6 * k + i]
            out[7 + 6 * i + j] = grown
            out[43 + 6 * i + j] = added
    for i in range(3):
        out[43 + 6 * (3 + i) + 3 + i] += psd / moments[i] ** 2
