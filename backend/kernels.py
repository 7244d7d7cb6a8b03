"""Residuals as short pure functions on CasADi SX, and the kernels that the program maps over the data.

Variables of a frame (12): p_NG [m], theta [rad] in R_NG = R_ref Exp(theta), v_N [m/s] of the centre of mass,
w_G [rad/s]. Constants: com_G (3) [m], xi (5) of the inertia. A landmark: p_G (3) [m].
"""

from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from backend.flow import ORDER
from backend.inertia import N_INERTIA, InertiaForm, quaternion_sx, rotation_sx

Output = Literal["cost", "gradient", "quadratic", "jacobian"]
"""Cost alone; with its gradient; with gradient and upper Gauss-Newton Hessian; or residual and Jacobian."""

N_STATE = 12
N_CAMERA = 6
"""Errors of the camera's stated pose: shift and turn along N. Unknowns of a frame when that pose is noisy."""
MOST_BEND = 0.6
"""Measured on a cold start and near the end: less converges slower there, more slower here."""
N_CONSTANTS = 3 + N_INERTIA


def step_parameters(n_state: int) -> int:
    """Parameters of a step between frames: with a noisy camera its stated positions too."""
    return 71 if n_state == N_STATE else 77


def quaternion_product_sx(a: Any, b: Any) -> Any:
    """Hamilton product, scalar first."""
    vector = a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4])
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:4], b[1:4]), vector)


def quaternion_log_sx(q: Any) -> Any:
    """Rotation vector of a unit quaternion (4); the sign is made canonical first."""
    q = q * ca.if_else(q[0] < 0, -1.0, 1.0)
    norm = ca.sqrt(ca.sumsqr(q[1:4]) + 1e-20)
    return 2.0 * ca.atan2(norm, q[0]) / norm * q[1:4]


def stereo_residual(
    pose: Any, p_G: Any, A: Any, R_RN: Any, t_R: Any, uvd: Any, inv_sigma: Any, rig: Any
) -> Any:
    """Measured minus predicted (u left, v, disparity), whitened (thesis eq. 4.85).

    pose (6) = p_NG, theta; A = R_RN R_ref; p_R = A Exp(theta) p_G + R_RN p_NG + t_R;
    rig (5) = f, cx, cy, b, offset.
    """
    p_R = A @ (rotation_sx(pose[3:6]) @ p_G) + R_RN @ pose[0:3] + t_R
    f, cx, cy, b, offset = rig[0], rig[1], rig[2], rig[3], rig[4]
    predicted = ca.vertcat(f * p_R[0] / p_R[2] + cx, f * p_R[1] / p_R[2] + cy, f * b / p_R[2] + offset)
    return (uvd - predicted) * inv_sigma


def series_sx(q: Any, w: Any, J: Any, J_inv: Any, h_s: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """Terms of the Taylor series of attitude, rate and momentum over a step (``flow.py``); they add up."""
    qs, ws, momenta = [q], [w], [J @ w]
    for k in range(ORDER):
        total = -sum((ca.cross(ws[i], momenta[k - i]) for i in range(k + 1)), ca.SX.zeros(3))
        momenta.append(h_s / (k + 1) * total)
        turned = (quaternion_product_sx(qs[i], ca.vertcat(0.0, ws[k - i])) for i in range(k + 1))
        qs.append(0.5 * h_s / (k + 1) * sum(turned, ca.SX.zeros(4)))
        ws.append(J_inv @ momenta[k + 1])
    return qs, ws, momenta


@lru_cache
def step_function(with_derivatives: bool) -> Any:
    """Function (y, p) -> y over one Taylor series; its ``fold`` makes a step of any length.

    y (7) = attitude since the start of the step, rate; with derivatives (55) also those of the attitude error
    on the right and of the rate, (3, 8) each by columns, in (w_G, xi). p (64) = J, J^-1, dJ / dxi (9 each, by
    columns), h [s].
    """
    y, p = ca.SX.sym("y", 55 if with_derivatives else 7), ca.SX.sym("p", 64)
    J, J_inv = ca.reshape(p[0:9], 3, 3), ca.reshape(p[9:18], 3, 3)
    qs, ws, momenta = series_sx(y[0:4], y[4:7], J, J_inv, p[63])
    q, w = ca.SX(sum(qs)), ca.SX(sum(ws))
    out = [q / ca.norm_2(q), w]
    if with_derivatives:
        dJ = [ca.SX.zeros(3, 3)] * 3 + [ca.reshape(p[18 + 9 * n : 27 + 9 * n], 3, 3) for n in range(5)]
        at_turn, at_rate = ca.reshape(y[7:31], 3, 8), ca.reshape(y[31:55], 3, 8)

        def of_J(w: Any) -> Any:
            return ca.horzcat(*[matrix @ w for matrix in dJ])

        turns, rates, changes = [at_turn], [at_rate], [J @ at_rate + of_J(ws[0])]
        for k in range(ORDER):
            change, turn = ca.SX.zeros(3, 8), rates[k]
            for i in range(k + 1):
                change += skew_sx(momenta[k - i]) @ rates[i] - skew_sx(ws[i]) @ changes[k - i]
                turn -= skew_sx(ws[i]) @ turns[k - i]
            changes.append(p[63] / (k + 1) * change)
            turns.append(p[63] / (k + 1) * turn)
            rates.append(J_inv @ (changes[k + 1] - of_J(ws[k + 1])))
        out += [ca.vec(sum(turns)), ca.vec(sum(rates))]
    return ca.Function("series", [y, p], [ca.vertcat(*out)])


def skew_sx(v: Any) -> Any:
    """``skew_sx(a) @ b == cross(a, b)``."""
    return ca.vertcat(ca.horzcat(0, -v[2], v[1]), ca.horzcat(v[2], 0, -v[0]), ca.horzcat(-v[1], v[0], 0))


def centre_sx(state: Any, com_G: Any, R_ref: Any, camera_N: Any) -> Any:
    """True centre of mass r_N (3) of a state (12 or 18), the camera's errors taken out."""
    seen = state[0:3] + R_ref @ (rotation_sx(state[3:6]) @ com_G)
    if state.numel() == N_STATE:
        return seen
    return camera_N + state[12:15] + rotation_sx(state[15:18]) @ (seen - camera_N)


def dynamics_residual(
    before: Any, after: Any, com_G: Any, R0: Any, R1: Any, q01: Any, dt_s: Any, W_t: Any, W_r: Any,
    q_step: Any, w_after: Any, camera0_N: Any, camera1_N: Any,
) -> Any:  # fmt: skip
    """State after minus predicted state, whitened by the process noise of the step (eqs. 4.77, 4.58).

    before, after (12 or 18); R0, R1 (3, 3) reference attitudes, q01 (4) = q0^-1 q1; W_t (2, 2), W_r (6, 6);
    q_step (4), w_after (3) relative attitude and rate that the torque-free motion leads to (eqs. 4.62, 4.65);
    camera0_N, camera1_N (3) stated positions of the camera.
    """
    turn0, turn1 = quaternion_sx(before[3:6]), quaternion_sx(after[3:6])
    r0, r1 = centre_sx(before, com_G, R0, camera0_N), centre_sx(after, com_G, R1, camera1_N)
    dr = r1 - r0 - dt_s * before[6:9]
    dv = after[6:9] - before[6:9]
    inverse = ca.vertcat(1.0, -1.0, -1.0, -1.0)
    if before.numel() > N_STATE:
        # the camera's turns along N become turns along the reference before the step
        error0, error1 = quaternion_sx(R0.T @ before[15:18]), quaternion_sx(R0.T @ after[15:18])
        q01 = quaternion_product_sx(quaternion_product_sx(error0 * inverse, error1), q01)
    relative = quaternion_product_sx(quaternion_product_sx(turn0 * inverse, q01), turn1)
    dtheta = quaternion_log_sx(quaternion_product_sx(q_step * inverse, relative))
    rotation = W_r @ ca.vertcat(dtheta, after[9:12] - w_after)
    return ca.vertcat(W_t[0, 0] * dr, W_t[1, 0] * dr + W_t[1, 1] * dv, rotation)


def prior_residual(com_G: Any, com_prior: Any, com_sigma_m: Any, second: Any) -> Any:
    """Weak prior (9): centre of mass near the middle of the landmarks, inertia near a sphere."""
    shape = 3.0 * second / ca.trace(second) - ca.SX.eye(3)
    off = ca.sqrt(2.0) * ca.vertcat(shape[1, 0], shape[2, 0], shape[2, 1])
    return ca.vertcat((com_G - com_prior) / com_sigma_m, ca.diag(shape), off)


def bend_sx(s: Any, robust_scale: float) -> Any:
    """How much of the Jacobian along the residual r the curvature of the Cauchy kernel takes, s = r.r.

    The kernel's exact second derivative makes the Hessian w J^T (I - 2 w r r^T / c^2) J, with w the weight.
    As w B^T B with B = J - bend r r^T J (Triggs et al., "Bundle adjustment", 2000, eq. 11) it stays positive;
    beyond MOST_BEND it is limited. Works on CasADi's expressions and on arrays alike.
    """
    c2 = robust_scale**2
    curvature = 2.0 / (c2 + s)
    limited = (
        ca.fmin(curvature, MOST_BEND / (s + 1e-12))
        if isinstance(s, ca.SX)
        else np.minimum(curvature, MOST_BEND / (s + 1e-12))
    )
    root = 1.0 - limited * s
    return limited / (1.0 + root**0.5)


def stereo_kernel(robust_scale: float, output: Output = "quadratic") -> Any:
    """Function (x (9) = pose, p_G; A, R_RN, t_R, uvd, inv_sigma, rig) of cost, gradient (9), Hessian (45).

    Cauchy kernel on the squared norm s of the whitened residual: 0.5 c^2 ln(1 + s / c^2).
    """
    x = ca.SX.sym("x", 9)
    A, R_RN = ca.SX.sym("A", 3, 3), ca.SX.sym("R_RN", 3, 3)
    t_R, uvd, inv_sigma, rig = (
        ca.SX.sym(name, size) for name, size in zip("tusr", (3, 3, 3, 5), strict=True)
    )
    r = stereo_residual(x[0:6], x[6:9], A, R_RN, t_R, uvd, inv_sigma, rig)
    s, c2 = ca.sumsqr(r), robust_scale**2
    outputs = [0.5 * c2 * ca.log1p(s / c2)]
    if output == "gradient":
        outputs.append(ca.gradient(outputs[0], x))
    if output == "quadratic":
        jacobian, weight = ca.jacobian(r, x), 1.0 / (1.0 + s / c2)
        along = jacobian.T @ r
        bent = jacobian - bend_sx(s, robust_scale) * (r @ along.T)
        outputs += [weight * along, upper(weight * bent.T @ bent)]
    return ca.Function("stereo", [x, ca.vec(A), ca.vec(R_RN), t_R, uvd, inv_sigma, rig], outputs)


def dynamics_kernel(
    form: InertiaForm, n_series: int, output: Output = "quadratic", n_state: int = N_STATE
) -> Any:
    """Function (x (w), p (71 or 77)) of cost, gradient (w), upper Hessian; or residual (12), Jacobian.

    x = state before, state after (s = n_state each), com_G, xi: w = 2 s + 8. Parameters: R0, R1, R_ref of the
    inertia (9 each, by columns), q01 (4), dt, W_t (3: 00, 10, 11), W_r (36, by columns), and where s = 18 the
    camera's stated positions (3 each), packed by ``program.dynamics_parameters``. The step is a fold of
    ``n_series`` Taylor series, between two functions that prepare and finish.
    """
    with_derivatives = output != "cost"
    prepare, finish = _series_parameters(form, n_series, n_state), _dynamics_outputs(output, n_state)
    x, p = ca.MX.sym("x", 2 * n_state + N_CONSTANTS), ca.MX.sym("p", step_parameters(n_state))
    start = ca.vertcat(1.0, 0.0, 0.0, 0.0, x[9:12])
    if with_derivatives:
        start = ca.vertcat(start, np.zeros(24), np.eye(3).ravel(), np.zeros(15))
    of_series = prepare(x, p)
    advance = step_function(with_derivatives)
    if n_series > 1:
        y = advance.fold(n_series)(start, ca.repmat(of_series, 1, n_series))
    else:
        y = advance(start, of_series)
    return ca.Function(f"dynamics{n_series}", [x, p], finish.call([x, p, y]))


def _series_parameters(form: InertiaForm, n_series: int, n_state: int) -> Any:
    """Function (x, p) of the parameters (64) of ``step_function``."""
    x, p = ca.SX.sym("x", 2 * n_state + N_CONSTANTS), ca.SX.sym("p", step_parameters(n_state))
    xi = x[2 * n_state + 3 :]
    second = form.second_moments_sx(xi, ca.reshape(p[18:27], 3, 3))
    J = ca.trace(second) * ca.SX.eye(3) - second
    dJ = ca.densify(ca.jacobian(ca.vec(J), xi))
    packed = ca.vertcat(ca.vec(J), ca.vec(ca.inv(J)), ca.vec(dJ), p[31] / n_series)
    return ca.Function("prepare", [x, p], [packed])


@lru_cache
def _dynamics_outputs(output: Output, n_state: int) -> Any:
    """Function (x, p, y of ``step_function``) of what ``dynamics_kernel`` returns."""
    x, p = ca.SX.sym("x", 2 * n_state + N_CONSTANTS), ca.SX.sym("p", step_parameters(n_state))
    y = ca.SX.sym("y", 7 if output == "cost" else 55)
    before, after, com_G = x[:n_state], x[n_state : 2 * n_state], x[2 * n_state : 2 * n_state + 3]
    R0, R1 = (ca.reshape(p[9 * i : 9 * i + 9], 3, 3) for i in range(2))
    W_t = ca.vertcat(ca.horzcat(p[32], 0), ca.horzcat(p[33], p[34]))
    W_r = ca.reshape(p[35:71], 6, 6)
    turn, w_after = ca.SX.sym("turn", 3), ca.SX.sym("w_after", 3)
    q_step = quaternion_product_sx(y[0:4], quaternion_sx(turn))
    cameras = (p[71:74], p[74:77]) if n_state > N_STATE else (ca.SX.zeros(3), ca.SX.zeros(3))
    r = dynamics_residual(before, after, com_G, R0, R1, p[27:31], p[31], W_t, W_r, q_step, w_after, *cameras)
    of_end = ca.vertcat(turn, w_after)
    here = ca.vertcat(ca.SX.zeros(3), y[4:7])
    residual = ca.substitute(r, of_end, here)
    if output == "cost":
        return ca.Function("finish", [x, p, y], [0.5 * ca.sumsqr(residual)])
    jacobian, along = (ca.substitute(ca.densify(ca.jacobian(r, to)), of_end, here) for to in (x, of_end))
    of_step = along @ ca.vertcat(ca.reshape(y[7:31], 3, 8), ca.reshape(y[31:55], 3, 8))
    jacobian[:, 9:12] += of_step[:, 0:3]
    jacobian[:, 2 * n_state + 3 :] += of_step[:, 3:8]
    return ca.Function("finish", [x, p, y], quadratic_outputs(residual, jacobian, output))


def prior_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Function (x (8) = com_G, xi; p (13) = com_prior, com_sigma, R_ref) of the same outputs."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", 13)
    second = form.second_moments_sx(x[3:8], ca.reshape(p[4:13], 3, 3))
    return quadratic_kernel("prior", prior_residual(x[0:3], p[0:3], p[3], second), x, p, output)


def hold_kernel(output: Output = "quadratic") -> Any:
    """Function (x (6), p (12) = centre, information) of the same outputs: a pose or its error held softly."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 12)
    return quadratic_kernel("hold", ca.sqrt(p[6:12]) * (x - p[0:6]), x, p, output)


def quadratic_kernel(name: str, residual: Any, x: Any, p: Any, output: Output) -> Any:
    """0.5 r.r alone, or with its gradient and upper Gauss-Newton Hessian, or r and its Jacobian."""
    return ca.Function(name, [x, p], quadratic_outputs(residual, ca.jacobian(residual, x), output))


def quadratic_outputs(residual: Any, jacobian: Any, output: Output) -> list[Any]:
    """Outputs of ``quadratic_kernel`` from the residual and its Jacobian."""
    if output == "jacobian":
        return [residual, ca.densify(jacobian)]
    outputs = [0.5 * ca.sumsqr(residual)]
    if output != "cost":
        outputs.append(ca.densify(jacobian.T @ residual))
    if output == "quadratic":
        outputs.append(upper(ca.densify(jacobian.T @ jacobian)))
    return outputs


def upper(matrix: Any) -> Any:
    """Upper triangle by columns, as CasADi stores a symmetric block."""
    n = matrix.size1()
    return ca.vertcat(*[matrix[i, j] for j in range(n) for i in range(j + 1)])
