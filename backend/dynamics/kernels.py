"""The terms of the problem as CasADi kernels: dynamics between frames and weak priors.

Each kernel is built from a residual that is a short pure function. Variables of a frame (12): p_NG [m], theta
[rad] in R_NG = R_ref Exp(theta), v_N [m/s] of the centre of mass, w_G [rad/s]. Constants: com_G (3) [m], xi
(5) of the inertia.

The residual of the dynamics is that of ``residuals.py``, which a test compares with it. A step is a fold of
Taylor series (``propagation.py``) that propagate their derivatives, between a function that prepares their
parameters and one that forms the residual: CasADi never differentiates through the series, and a step of any
length is built at once.
"""

from functools import cache, lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.dynamics.propagation import ORDER
from polhode.backend.problem.inertia import N_INERTIA, InertiaForm, quaternion_sx, rotation_sx
from polhode.backend.problem.iterate import (
    CAMERA_ROTATION,
    CAMERA_SHIFT,
    COM,
    N_CAMERA,
    N_CONSTANTS,
    N_POSE,
    N_STATE,
    POSITION,
    RATE,
    ROTATION,
    VELOCITY,
    XI,
)
from polhode.backend.problem.wrench import (
    ALIGNMENT_SIGMA,
    FORCE_BIAS,
    LN_MASS,
    LN_PRIOR,
    LN_SCALE,
    N_OF_ROTATION,
    N_WRENCH,
    TORQUE_BIAS,
    TURN,
)

Output = Literal["cost", "gradient", "quadratic", "jacobian"]
"""Cost alone; with its gradient; with gradient and upper Gauss-Newton Hessian; or residual and Jacobian."""
N_PRIOR, N_WRENCH_PRIOR = 13, 20
"""Parameters of the weak prior and of the prior on the unknowns of a known wrench."""
THIN_PRIOR = 3.0
"""Standard deviation of ln(tr Sigma / 3): 2 for a rod of ten times its thickness."""


class StepLayout:
    """Layout of the variables x and the parameters p of a step.

    x = state before, state after (n_state each), com_G, xi, and with a known wrench its unknowns (11).
    p = the parameters below; with a noisy camera its stated positions (3 each); with a known wrench R_ref of
    the torque's axes (9) and the effect of the force on position and velocity of 1 kg (3 each). Matrices by
    columns.
    """

    R_BEFORE, R_AFTER, R_INERTIA = slice(0, 9), slice(9, 18), slice(18, 27)
    """In p: the reference attitudes of both frames, the reference rotation of the inertia."""
    Q_BETWEEN, DT = slice(27, 31), 31
    """In p: the relative reference attitude q0^-1 q1, the length of the step [s]."""
    W_T, W_R = slice(32, 35), slice(35, 71)
    """In p: whitening of the translation (entries 00, 10, 11) and of the rotation (6, 6)."""

    def __init__(self, n_state: int = N_STATE, with_wrench: bool = False) -> None:
        self.n_state, self.with_wrench = n_state, with_wrench
        both = 2 * n_state
        self.after, self.com = slice(n_state, both), slice(both, both + 3)
        self.xi = slice(both + 3, both + N_CONSTANTS)
        self.n_constants = N_CONSTANTS + (N_WRENCH if with_wrench else 0)
        self.n_x = both + self.n_constants
        self.wrench_unknowns = slice(both + N_CONSTANTS, self.n_x)
        self.camera = 71
        """Where the camera's positions begin in p"""
        self.wrench = self.camera + (N_CAMERA if n_state > N_STATE else 0)
        """Where the wrench's part begins in p"""
        self.n_p = self.wrench + (15 if with_wrench else 0)
        self.n_parameters = N_INERTIA + (N_OF_ROTATION if with_wrench else 0)
        """Number of constants that the rotation depends on: xi, and with a known wrench seven more"""
        self.n_y = 7 + 6 * (3 + self.n_parameters)
        """Size of what a series passes on: attitude, rate, their derivatives in w_G and the parameters"""

    def symbols(self) -> tuple[Any, Any]:
        """x and p."""
        return ca.SX.sym("x", self.n_x), ca.SX.sym("p", self.n_p)


step_layout = cache(StepLayout)
"""Kernels are kept by their layout."""
PLAIN = step_layout(N_STATE, False)


def quaternion_product_sx(a: Any, b: Any) -> Any:
    """Hamilton product, scalar first."""
    vector = a[0] * b[1:4] + b[0] * a[1:4] + ca.cross(a[1:4], b[1:4])
    return ca.vertcat(a[0] * b[0] - ca.dot(a[1:4], b[1:4]), vector)


def quaternion_log_sx(q: Any) -> Any:
    """Rotation vector of a unit quaternion (4); the sign is made canonical first."""
    q = q * ca.if_else(q[0] < 0, -1.0, 1.0)
    norm = ca.sqrt(ca.sumsqr(q[1:4]) + 1e-20)
    return 2.0 * ca.atan2(norm, q[0]) / norm * q[1:4]


def prior_residual(com_G: Any, com_prior: Any, com_sigma_m: Any, second: Any) -> Any:
    """Weak prior (10): centre of mass near the middle of the landmarks, inertia near a sphere.

    The last component grows without bound for ever thinner bodies with second moments of determinant 1.
    """
    shape = 3.0 * second / ca.trace(second) - ca.SX.eye(3)
    off = ca.sqrt(2.0) * ca.vertcat(shape[1, 0], shape[2, 0], shape[2, 1])
    thin = ca.log(ca.trace(second) / 3.0) / THIN_PRIOR
    return ca.vertcat((com_G - com_prior) / com_sigma_m, ca.diag(shape), off, thin)


@cache
def prior_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Weak prior as a function of x (8) = com_G, xi and p (13) = com_prior, com_sigma, R_ref."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", N_PRIOR)
    second = form.second_moments_sx(x[XI], ca.reshape(p[4:13], 3, 3))
    return quadratic_kernel("prior", prior_residual(x[COM], p[0:3], p[3], second), x, p, output)


def wrench_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Prior on the unknowns of a known wrench as a function of x (16) = xi, these unknowns, and p (20).

    The residual is that of ``wrench.wrench_residual``. p = R_ref of the inertia and of the torque's axes,
    standard deviations of the biases of force and torque.
    """
    x, p = ca.SX.sym("x", N_INERTIA + N_WRENCH), ca.SX.sym("p", N_WRENCH_PRIOR)
    second, unknowns = form.second_moments_sx(x[:N_INERTIA], ca.reshape(p[0:9], 3, 3)), x[N_INERTIA:]
    R = ca.reshape(p[9:18], 3, 3) @ rotation_sx(unknowns[TURN])
    M = -R.T @ second @ R
    products = 3.0 / ALIGNMENT_SIGMA / (2.0 * ca.trace(second)) * ca.vertcat(M[2, 1], M[2, 0], M[1, 0])
    logs = ca.vertcat(unknowns[LN_SCALE], unknowns[LN_MASS]) / LN_PRIOR
    residual = ca.vertcat(products, unknowns[TORQUE_BIAS] / p[19], unknowns[FORCE_BIAS] / p[18], logs)
    return quadratic_kernel("wrench", residual, x, p, output)


def gaussian_prior_kernel(output: Output = "quadratic") -> Any:
    """Gaussian prior on a pose or its error as a function of x (6) and p (12) = mean, information."""
    x, p = ca.SX.sym("x", N_POSE), ca.SX.sym("p", 2 * N_POSE)
    return quadratic_kernel("gaussian_prior", ca.sqrt(p[N_POSE:]) * (x - p[:N_POSE]), x, p, output)


def quadratic_kernel(name: str, residual: Any, x: Any, p: Any, output: Output) -> Any:
    """Function (x, p) of 0.5 r.r, with gradient and upper Gauss-Newton Hessian, or of r and Jacobian."""
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
    """Upper triangle of a symmetric block by columns, the order of CasADi."""
    n = matrix.size1()
    return ca.vertcat(*[matrix[i, j] for j in range(n) for i in range(j + 1)])


def dynamics_kernel(
    form: InertiaForm, n_series: int, output: Output = "quadratic", layout: StepLayout = PLAIN
) -> Any:
    """The dynamics of a step as a function (x, p) laid out as in ``StepLayout``.

    With a known wrench a third argument is its torque (6, n_series): in each series, along P [N m], the value
    at the start and the change (``wrench.Impulses.torque``).
    """
    with_derivatives = output != "cost"
    prepare, finish = _prepare(form, n_series, layout), _finish(output, layout)
    x, p = ca.MX.sym("x", layout.n_x), ca.MX.sym("p", layout.n_p)
    torque = ca.MX.sym("torque", 6, n_series)
    start = ca.vertcat(1.0, 0.0, 0.0, 0.0, x[RATE])
    if with_derivatives:
        zeros = np.zeros(3 * layout.n_parameters)
        start = ca.vertcat(start, np.zeros(9), zeros, np.eye(3).ravel(), zeros)
    advance = step_function(with_derivatives, layout.with_wrench)
    if layout.with_wrench:
        of_series = prepare.map(n_series)(ca.repmat(x, 1, n_series), ca.repmat(p, 1, n_series), torque)
    else:
        of_series = ca.repmat(prepare(x, p), 1, n_series)
    y = (advance.fold(n_series) if n_series > 1 else advance)(start, of_series)
    arguments = [x, p, torque] if layout.with_wrench else [x, p]
    return ca.Function(f"dynamics{n_series}", arguments, finish.call([x, p, y]))


@lru_cache
def step_function(with_derivatives: bool, with_wrench: bool = False) -> Any:
    """Function (y, p) -> y over one Taylor series; its ``fold`` makes a step of any length.

    y (7) = attitude since the start of the step, rate; with derivatives those of the attitude error on the
    right, then of the rate, (3, n) each by columns, in w_G and the n - 3 parameters. p = J, J^-1, dJ / dxi (9
    each, by columns), h [s]; with a known wrench the torque in G (6: value at the start, change), and its
    derivatives (6 each) in the other parameters.
    """
    layout = StepLayout(with_wrench=with_wrench)
    n = 3 + layout.n_parameters
    y = ca.SX.sym("y", layout.n_y if with_derivatives else 7)
    p = ca.SX.sym("p", 64 + (6 * (1 + N_OF_ROTATION) if with_wrench else 0))
    J, J_inv, h_s = ca.reshape(p[0:9], 3, 3), ca.reshape(p[9:18], 3, 3), p[63]
    torque = [p[64:67], p[67:70]] if with_wrench else [ca.SX.zeros(3), ca.SX.zeros(3)]
    qs, ws, momenta = series_sx(y[0:4], y[4:7], J, J_inv, h_s, torque)
    q, w = ca.SX(sum(qs)), ca.SX(sum(ws))
    out = [q / ca.norm_2(q), w]
    if with_derivatives:
        constant = ca.SX.zeros(3, 3)
        dJ = [constant] * 3 + [ca.reshape(p[18 + 9 * i : 27 + 9 * i], 3, 3) for i in range(N_INERTIA)]
        dJ += [constant] * (layout.n_parameters - N_INERTIA)
        zero = ca.SX.zeros(3, 3 + N_INERTIA)
        dtorque = [zero, zero]
        if with_wrench:
            of_torque = ca.reshape(p[70:], 6, N_OF_ROTATION)
            dtorque = [ca.horzcat(zero, of_torque[0:3, :]), ca.horzcat(zero, of_torque[3:6, :])]

        def of_J(w: Any) -> Any:
            return ca.horzcat(*[matrix @ w for matrix in dJ])

        at_turn, at_rate = ca.reshape(y[7 : 7 + 3 * n], 3, n), ca.reshape(y[7 + 3 * n :], 3, n)
        turns, rates, changes = [at_turn], [at_rate], [J @ at_rate + of_J(ws[0])]
        for k in range(ORDER):
            change, turn = dtorque[k] if k < 2 else ca.SX.zeros(3, n), rates[k]
            for i in range(k + 1):
                change += skew_sx(momenta[k - i]) @ rates[i] - skew_sx(ws[i]) @ changes[k - i]
                turn -= skew_sx(ws[i]) @ turns[k - i]
            changes.append(h_s / (k + 1) * change)
            turns.append(h_s / (k + 1) * turn)
            rates.append(J_inv @ (changes[k + 1] - of_J(ws[k + 1])))
        out += [ca.vec(sum(turns)), ca.vec(sum(rates))]
    return ca.Function("series", [y, p], [ca.vertcat(*out)])


def series_sx(
    q: Any, w: Any, J: Any, J_inv: Any, h_s: Any, torque: list[Any]
) -> tuple[list[Any], list[Any], list[Any]]:
    """Terms of the Taylor series of attitude, rate and momentum over a step; the sums are their values."""
    qs, ws, momenta = [q], [w], [J @ w]
    for k in range(ORDER):
        total = sum((ca.cross(momenta[k - i], ws[i]) for i in range(k + 1)), ca.SX.zeros(3))
        momenta.append(h_s / (k + 1) * (total + torque[k] if k < 2 else total))
        turned = (quaternion_product_sx(qs[i], ca.vertcat(0.0, ws[k - i])) for i in range(k + 1))
        qs.append(0.5 * h_s / (k + 1) * sum(turned, ca.SX.zeros(4)))
        ws.append(J_inv @ momenta[k + 1])
    return qs, ws, momenta


def skew_sx(v: Any) -> Any:
    """``skew_sx(a) @ b == cross(a, b)``."""
    return ca.vertcat(ca.horzcat(0, -v[2], v[1]), ca.horzcat(v[2], 0, -v[0]), ca.horzcat(-v[1], v[0], 0))


def centre_sx(state: Any, com_G: Any, R_ref: Any, camera_N: Any) -> Any:
    """True centre of mass r_N (3) of a state (12 or 18), corrected for the camera's errors."""
    seen = state[POSITION] + R_ref @ (rotation_sx(state[ROTATION]) @ com_G)
    if state.numel() == N_STATE:
        return seen
    return camera_N + state[CAMERA_SHIFT] + rotation_sx(state[CAMERA_ROTATION]) @ (seen - camera_N)


def dynamics_residual(
    before: Any, after: Any, com_G: Any, R0: Any, R1: Any, q01: Any, dt_s: Any, q_step: Any, w_after: Any,
    camera0_N: Any, camera1_N: Any,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """State after minus predicted state (eq. 4.77): position, velocity, attitude, rate.

    before, after (12 or 18); R0, R1 (3, 3) reference attitudes, q01 (4) = q0^-1 q1; q_step (4), w_after (3)
    predicted relative attitude and rate (eqs. 4.62, 4.65); camera0_N, camera1_N (3) stated positions of the
    camera.
    """
    turn0, turn1 = quaternion_sx(before[ROTATION]), quaternion_sx(after[ROTATION])
    r0, r1 = centre_sx(before, com_G, R0, camera0_N), centre_sx(after, com_G, R1, camera1_N)
    inverse = ca.vertcat(1.0, -1.0, -1.0, -1.0)
    if before.numel() > N_STATE:
        # rotations of the camera along N, expressed in the reference attitude before the step
        error0, error1 = (quaternion_sx(R0.T @ state[CAMERA_ROTATION]) for state in (before, after))
        q01 = quaternion_product_sx(quaternion_product_sx(error0 * inverse, error1), q01)
    relative = quaternion_product_sx(quaternion_product_sx(turn0 * inverse, q01), turn1)
    dtheta = quaternion_log_sx(quaternion_product_sx(q_step * inverse, relative))
    dr, dv = r1 - r0 - dt_s * before[VELOCITY], after[VELOCITY] - before[VELOCITY]
    return dr, dv, dtheta, after[RATE] - w_after


def _prepare(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """Function (x, p) or (x, p, torque along P (6) of a series) -> the parameters of ``step_function``."""
    x, p = layout.symbols()
    xi = x[layout.xi]
    second = form.second_moments_sx(xi, ca.reshape(p[layout.R_INERTIA], 3, 3))
    J = ca.trace(second) * ca.SX.eye(3) - second
    dJ = ca.densify(ca.jacobian(ca.vec(J), xi))
    packed = ca.vertcat(ca.vec(J), ca.vec(ca.inv(J)), ca.vec(dJ), p[layout.DT] / n_series)
    if not layout.with_wrench:
        return ca.Function("prepare", [x, p], [packed])
    known, unknowns = ca.SX.sym("torque", 6), x[layout.wrench_unknowns]
    R = ca.reshape(p[layout.wrench : layout.wrench + 9], 3, 3) @ rotation_sx(unknowns[TURN])
    biased = ca.vertcat(R @ (known[0:3] + unknowns[TORQUE_BIAS]), R @ known[3:6])
    torque = ca.exp(-unknowns[LN_SCALE]) * biased
    slopes = ca.densify(ca.jacobian(torque, unknowns[0:N_OF_ROTATION]))
    return ca.Function("prepare", [x, p, known], [ca.vertcat(packed, torque, ca.vec(slopes))])


@lru_cache
def _finish(output: Output, layout: StepLayout) -> Any:
    """Function (x, p, y of ``step_function``) -> the outputs of ``dynamics_kernel``."""
    x, p = layout.symbols()
    s, n = layout.n_state, 3 + layout.n_parameters
    y = ca.SX.sym("y", 7 if output == "cost" else layout.n_y)
    R0, R1 = ca.reshape(p[layout.R_BEFORE], 3, 3), ca.reshape(p[layout.R_AFTER], 3, 3)
    dt_s, W_t = p[layout.DT], p[layout.W_T]
    turn, w_after, at = ca.SX.sym("turn", 3), ca.SX.sym("w_after", 3), layout.camera
    q_step = quaternion_product_sx(y[0:4], quaternion_sx(turn))
    cameras = (p[at : at + 3], p[at + 3 : at + 6]) if s > N_STATE else (ca.SX.zeros(3), ca.SX.zeros(3))
    dr, dv, dtheta, dw = dynamics_residual(
        x[:s], x[layout.after], x[layout.com], R0, R1, p[layout.Q_BETWEEN], dt_s, q_step, w_after, *cameras
    )
    if layout.with_wrench:
        unknowns, force = x[layout.wrench_unknowns], p[layout.wrench + 9 :]
        per_kg, bias = ca.exp(-unknowns[LN_MASS]), unknowns[FORCE_BIAS]
        dr -= per_kg * (force[0:3] + 0.5 * dt_s**2 * bias)
        dv -= per_kg * (force[3:6] + dt_s * bias)
    # whitened by the process noise of the step (eq. 4.58)
    rotation = ca.reshape(p[layout.W_R], 6, 6) @ ca.vertcat(dtheta, dw)
    r = ca.vertcat(W_t[0] * dr, W_t[1] * dr + W_t[2] * dv, rotation)
    of_end = ca.vertcat(turn, w_after)
    here = ca.vertcat(ca.SX.zeros(3), y[4:7])
    residual = ca.substitute(r, of_end, here)
    if output == "cost":
        return ca.Function("finish", [x, p, y], [0.5 * ca.sumsqr(residual)])
    jacobian, along = (ca.substitute(ca.densify(ca.jacobian(r, to)), of_end, here) for to in (x, of_end))
    of_step = along @ ca.vertcat(ca.reshape(y[7 : 7 + 3 * n], 3, n), ca.reshape(y[7 + 3 * n :], 3, n))
    jacobian[:, RATE] += of_step[:, 0:3]
    jacobian[:, 2 * s + 3 : 2 * s + n] += of_step[:, 3:]
    return ca.Function("finish", [x, p, y], quadratic_outputs(residual, jacobian, output))
