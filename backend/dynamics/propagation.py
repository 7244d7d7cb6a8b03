"""Motion of a rigid body about its centre of mass over one step, with its derivatives, by Taylor series.

Euler's equation in the momentum ``l = J w`` (body axes) and the attitude relative to the start::

    l' = -w x l + torque,    q' = 1/2 q o w,    w = J^-1 l

are quadratic, so the coefficients of their Taylor series follow from each other by convolution (Jorba and
Zou, "A software package for the numerical integration of ODEs by means of high-order Taylor methods", 2005).
The derivatives obey the linearised equations and have their own series: ``delta' = -w x delta + dw`` for the
attitude error on the right, ``dl' = -dw x l - w x dl + dtorque``, ``dw = J^-1 (dl - dJ w)``.

Order 8 is efficient over the whole range that is needed: one series covers 0.5 s at 10 RPM, and 32 cover 10 s
at 20 RPM. The last terms bound the truncation error; ``series_steps`` halves the steps until it is small
compared with the process noise.

This integrator serves the estimation: fast for many short steps, with derivatives with respect to the
inertia. The simulation integrates the true motion with an independent method of higher accuracy
(``polhode.geometry.rigid_body``).
"""

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled

ORDER = 8
MAX_SERIES = 1024
MAX_RATIO = 0.7
"""Largest ratio of neighbouring terms; if a series converges more slowly its remainder is not bounded by
it."""
SHARE_OF_NOISE = 1e-3
"""Largest error of the integration, in standard deviations of the step's process noise."""


@compiled
def _series(q: Array, w: Array, momentum: Array, J_inv: Array, torque: Array, h: float) -> None:
    """Fill q (9, 4), w (9, 3), momentum (9, 3) from their first rows; time in units of the step h [s]."""
    for k in range(ORDER):
        a = b = c = s = x = y = z = 0.0
        for i in range(k + 1):
            w0, w1, w2 = w[i, 0], w[i, 1], w[i, 2]
            m0, m1, m2 = momentum[k - i, 0], momentum[k - i, 1], momentum[k - i, 2]
            a -= w1 * m2 - w2 * m1
            b -= w2 * m0 - w0 * m2
            c -= w0 * m1 - w1 * m0
            q0, q1, q2, q3 = q[k - i, 0], q[k - i, 1], q[k - i, 2], q[k - i, 3]
            s -= q1 * w0 + q2 * w1 + q3 * w2
            x += q0 * w0 + q2 * w2 - q3 * w1
            y += q0 * w1 + q3 * w0 - q1 * w2
            z += q0 * w2 + q1 * w1 - q2 * w0
        if k < 2:
            a, b, c = a + torque[k, 0], b + torque[k, 1], c + torque[k, 2]
        scale, half = h / (k + 1), 0.5 * h / (k + 1)
        momentum[k + 1, 0], momentum[k + 1, 1], momentum[k + 1, 2] = scale * a, scale * b, scale * c
        q[k + 1, 0], q[k + 1, 1], q[k + 1, 2], q[k + 1, 3] = half * s, half * x, half * y, half * z
        for n in range(3):
            w[k + 1, n] = scale * (J_inv[n, 0] * a + J_inv[n, 1] * b + J_inv[n, 2] * c)


@compiled
def _sum_up(terms: Array, out: Array) -> None:
    """Sum of a series (9, n) into out (n,), the smallest terms first."""
    for n in range(len(out)):
        out[n] = 0.0
        for k in range(ORDER, -1, -1):
            out[n] += terms[k, n]


@compiled
def _remainder(terms: Array) -> float:
    """Truncation error of a series with terms (9, n), extrapolated from its last terms."""
    last = before = 0.0
    for n in range(terms.shape[1]):
        last += terms[ORDER, n] ** 2
        before += terms[ORDER - 2, n] ** 2
    ratio = (last / before) ** 0.25 if before > 0.0 else 0.0
    return float(np.sqrt(last) * ratio / (1.0 - ratio)) if ratio < MAX_RATIO else np.inf


@compiled
def flows(
    w_G: Array, J: Array, J_inv: Array, dt_s: Array, torque: Array, steps: Ints
) -> tuple[Array, Array, Array, Array]:
    """``propagate_rotations`` for compiled functions; a torque of shape (n, 0, 2, 3) is none."""
    n = len(dt_s)
    out_q, out_w, error_q, error_w = np.zeros((n, 4)), w_G.copy(), np.zeros(n), np.zeros(n)
    q, w, momentum = np.empty((ORDER + 1, 4)), np.empty((ORDER + 1, 3)), np.empty((ORDER + 1, 3))
    none = np.zeros((2, 3))
    for j in range(n):
        out_q[j, 0] = 1.0
        h = dt_s[j] / steps[j]
        for step in range(steps[j]):
            for a in range(3):
                w[0, a] = out_w[j, a]
                momentum[0, a] = J[a, 0] * out_w[j, 0] + J[a, 1] * out_w[j, 1] + J[a, 2] * out_w[j, 2]
            for a in range(4):
                q[0, a] = out_q[j, a]
            _series(q, w, momentum, J_inv, torque[j, step] if torque.shape[1] > 0 else none, h)
            _sum_up(q, out_q[j])
            _sum_up(w, out_w[j])
            _normalise(out_q[j])
            error_w[j] += _remainder(w)
            error_q[j] += 2.0 * _remainder(q) + h * error_w[j]
    return out_q, out_w, error_q, error_w


@compiled
def _normalise(q: Array) -> None:
    scale = 1.0 / np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for a in range(4):
        q[a] *= scale


@compiled
def _series_derivatives(
    turn: Array, rate: Array, change: Array, w: Array, momentum: Array, J_inv: Array, dJ: Array, h: float,
    dtorque: Array,
) -> None:  # fmt: skip
    """Fill the series (9, 3) of one derivative of attitude error, rate and momentum from their first rows."""
    for k in range(ORDER):
        a = b = c = 0.0
        x, y, z = rate[k, 0], rate[k, 1], rate[k, 2]
        for i in range(k + 1):
            r0, r1, r2 = rate[i, 0], rate[i, 1], rate[i, 2]
            m0, m1, m2 = momentum[k - i, 0], momentum[k - i, 1], momentum[k - i, 2]
            w0, w1, w2 = w[i, 0], w[i, 1], w[i, 2]
            d0, d1, d2 = change[k - i, 0], change[k - i, 1], change[k - i, 2]
            t0, t1, t2 = turn[k - i, 0], turn[k - i, 1], turn[k - i, 2]
            a -= r1 * m2 - r2 * m1 + w1 * d2 - w2 * d1
            b -= r2 * m0 - r0 * m2 + w2 * d0 - w0 * d2
            c -= r0 * m1 - r1 * m0 + w0 * d1 - w1 * d0
            x -= w1 * t2 - w2 * t1
            y -= w2 * t0 - w0 * t2
            z -= w0 * t1 - w1 * t0
        if k < 2:
            a, b, c = a + dtorque[k, 0], b + dtorque[k, 1], c + dtorque[k, 2]
        scale = h / (k + 1)
        change[k + 1, 0], change[k + 1, 1], change[k + 1, 2] = scale * a, scale * b, scale * c
        turn[k + 1, 0], turn[k + 1, 1], turn[k + 1, 2] = scale * x, scale * y, scale * z
        a, b, c = scale * a, scale * b, scale * c
        for n in range(3):
            a -= dJ[0, n] * w[k + 1, n]
            b -= dJ[1, n] * w[k + 1, n]
            c -= dJ[2, n] * w[k + 1, n]
        for n in range(3):
            rate[k + 1, n] = J_inv[n, 0] * a + J_inv[n, 1] * b + J_inv[n, 2] * c


@compiled
def flow_derivatives(
    w_G: Array, J: Array, J_inv: Array, dJ: Array, dt_s: Array, torque: Array, dtorque: Array, steps: Ints
) -> tuple[Array, Array, Array, Array]:
    """``propagate_derivatives`` for compiled functions: dJ and dtorque have those in w_G, too."""
    n, m, p = len(dt_s), len(dJ), ORDER + 1
    out_q, out_w = np.zeros((n, 4)), w_G.copy()
    out_turn, out_rate = np.zeros((n, m, 3)), np.zeros((n, m, 3))
    q, w, momentum = np.empty((p, 4)), np.empty((p, 3)), np.empty((p, 3))
    turn, rate, change, none = np.empty((p, 3)), np.empty((p, 3)), np.empty((p, 3)), np.zeros((2, 3))
    for j in range(n):
        out_q[j, 0] = 1.0
        for a in range(3):
            out_rate[j, a, a] = 1.0
        h = dt_s[j] / steps[j]
        for step in range(steps[j]):
            for a in range(3):
                w[0, a] = out_w[j, a]
                momentum[0, a] = J[a, 0] * out_w[j, 0] + J[a, 1] * out_w[j, 1] + J[a, 2] * out_w[j, 2]
            for a in range(4):
                q[0, a] = out_q[j, a]
            _series(q, w, momentum, J_inv, torque[j, step] if torque.shape[1] > 0 else none, h)
            for c in range(m):
                for a in range(3):
                    turn[0, a], rate[0, a] = out_turn[j, c, a], out_rate[j, c, a]
                    change[0, a] = 0.0
                    for b in range(3):
                        change[0, a] += J[a, b] * out_rate[j, c, b] + dJ[c, a, b] * out_w[j, b]
                of_torque = dtorque[j, step, c] if dtorque.shape[1] > 0 else none
                _series_derivatives(turn, rate, change, w, momentum, J_inv, dJ[c], h, of_torque)
                _sum_up(turn, out_turn[j, c])
                _sum_up(rate, out_rate[j, c])
            _sum_up(q, out_q[j])
            _sum_up(w, out_w[j])
            _normalise(out_q[j])
    return out_q, out_w, out_turn, out_rate


def propagate_rotations(
    w_G: Array, J_G: Array, dt_s: Array, steps: Ints, torque: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """Attitudes (n, 4) relative to the start, rates (n, 3) after dt_s (n,), and bounds (n,) of their errors.

    w_G (n, 3) [rad/s]; J_G (3, 3) any scale; steps (n,) series; torque (n, steps or more, 2, 3) in the scale
    of J_G: its value at the start of each series and its change over it. The errors are in rad and rad/s.
    """
    J = np.ascontiguousarray(J_G, dtype=np.float64)
    J_inv = np.asarray(np.linalg.inv(J), dtype=np.float64)
    torque = np.zeros((len(dt_s), 0, 2, 3)) if torque is None else torque
    return flows(np.ascontiguousarray(w_G), J, J_inv, dt_s, torque, steps)


def propagate_derivatives(
    w_G: Array,
    J_G: Array,
    dJ: Array,
    dt_s: Array,
    steps: Ints,
    torque: Array | None = None,
    dtorque: Array | None = None,
) -> tuple[Array, Array, Array, Array]:
    """Attitudes and rates as above, and derivatives (n, 3 + m, 3) of attitude error (right) and rate.

    The 3 + m rows: in w_G, and in m parameters on which J depends by dJ (m, 3, 3) and the torque by dtorque
    (n, steps or more, m, 2, 3).
    """
    J, n = np.ascontiguousarray(J_G, dtype=np.float64), len(dt_s)
    J_inv = np.asarray(np.linalg.inv(J), dtype=np.float64)
    torque = np.zeros((n, 0, 2, 3)) if torque is None else torque
    if dtorque is None:
        of_torque = np.zeros((n, 0, 3, 2, 3))
    else:
        of_torque = np.concatenate([np.zeros((*dtorque.shape[:2], 3, 2, 3)), dtorque], axis=2)
    dJ = np.concatenate([np.zeros((3, 3, 3)), dJ])
    w = np.ascontiguousarray(w_G)
    return flow_derivatives(w, J, J_inv, dJ, dt_s, torque, of_torque, steps)


def series_steps(w_G: Array, J_G: Array, dt_s: Array, torque_psd: float | Array) -> Ints:
    """Number of series for each interval (n,), a power of two so that few kernels are needed.

    w_G (n, 3) rate at the start [rad/s], J_G (3, 3) any scale, dt_s (n,), torque_psd [(rad/s^2)^2/Hz], one or
    (n,). The errors stay below ``SHARE_OF_NOISE`` of sqrt(psd dt^3 / 3) in attitude and sqrt(psd dt) in rate,
    which the largest moment makes smaller. Both are correlated: a quarter of the share is left to each.
    """
    J = J_G / np.linalg.eigvalsh(J_G)[1]
    t, steps = np.asarray(dt_s, dtype=np.float64), np.ones(len(dt_s), dtype=np.int64)
    most_rate = 0.25 * SHARE_OF_NOISE / np.linalg.eigvalsh(J)[2] * np.sqrt(torque_psd * t)
    left = np.arange(len(t))
    while len(left) and steps[left[0]] < MAX_SERIES:
        _, _, error_q, error_w = propagate_rotations(w_G[left], J, t[left], steps[left])
        # a series that diverges gives NaN, which is not accepted
        good = (error_q <= most_rate[left] * t[left] / np.sqrt(3.0)) & (error_w <= most_rate[left])
        left = left[~good]
        steps[left] *= 2
    return steps
