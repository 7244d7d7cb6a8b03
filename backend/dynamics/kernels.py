"""The terms of the problem as CasADi kernels: dynamics between frames and weak priors.

Each kernel is built from a residual that is a short pure function. Variables of a frame (12): p_NG [m], theta
[rad] in R_NG = R_ref Exp(theta), v_N [m/s] of the centre of mass, w_G [rad/s]. Constants: com_G (3) [m], xi
(5) of the inertia.

The residual of the dynamics is that of ``residuals.py``, which a test compares with it. A step is a fold of
Taylor series (``propagation.py``) that propagate their derivatives, between a function that prepares their
parameters and one that forms the residual: CasADi never differentiates through the series, and a step of any
length is built at once.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.dynamics.propagation import ORDER
from polhode.backend.problem.inertia import N_INERTIA, InertiaForm, quaternion_sx, rotation_sx
from polhode.backend.problem.iterate import N_CAMERA, N_CONSTANTS, N_STATE
from polhode.backend.problem.wrench import ALIGNMENT_SIGMA, LN_PRIOR, N_OF_ROTATION, N_WRENCH

Output = Literal["cost", "gradient", "quadratic", "jacobian"]
"""Cost alone; with its gradient; with gradient and upper Gauss-Newton Hessian; or residual and Jacobian."""
THIN_PRIOR = 3.0
"""Standard deviation of ln(tr Sigma / 3): 2 for a rod of ten times its thickness."""


@dataclass(frozen=True)
class StepLayout:
    """Where the variables x and the parameters p of a step stand.

    x = state before, state after (n_state each), com_G, xi, and with a known wrench its unknowns (11).
    p = R0, R1, R_ref of the inertia (9 each, by columns), q01 (4), dt, W_t (3: 00, 10, 11), W_r (36, by
    columns); with a noisy camera its stated positions (3 each); with a known wrench R_ref of the torque's
    axes (9), what the force does to position and velocity of 1 kg (3 each).
    """

    n_state: int = N_STATE
    pushed: bool = False

    @property
    def n_constants(self) -> int:
        return N_CONSTANTS + (N_WRENCH if self.pushed else 0)

    @property
    def n_x(self) -> int:
        return 2 * self.n_state + self.n_constants

    @property
    def camera(self) -> int:
        """Where the camera's positions begin in p."""
        return 71

    @property
    def push(self) -> int:
        """Where the wrench's part begins in p."""
        return self.camera + (N_CAMERA if self.n_state > N_STATE else 0)

    @property
    def n_p(self) -> int:
        return self.push + (15 if self.pushed else 0)

    @property
    def parameters(self) -> int:
        """Constants that the rotation depends on: xi, and with a known wrench seven more."""
        return N_INERTIA + (N_OF_ROTATION if self.pushed else 0)

    @property
    def n_y(self) -> int:
        """Numbers that a series hands on: attitude, rate, and their derivatives in w_G and the parameters."""
        return 7 + 6 * (3 + self.parameters)

    def symbols(self) -> tuple[Any, Any]:
        """x and p."""
        return ca.SX.sym("x", self.n_x), ca.SX.sym("p", self.n_p)


PLAIN = StepLayout()


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

    The last one grows without end for ever thinner bodies, second moments of determinant 1.
    """
    shape = 3.0 * second / ca.trace(second) - ca.SX.eye(3)
    off = ca.sqrt(2.0) * ca.vertcat(shape[1, 0], shape[2, 0], shape[2, 1])
    thin = ca.log(ca.trace(second) / 3.0) / THIN_PRIOR
    return ca.vertcat((com_G - com_prior) / com_sigma_m, ca.diag(shape), off, thin)


def prior_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Function (x (8) = com_G, xi; p (13) = com_prior, com_sigma, R_ref) of the same outputs."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", 13)
    second = form.second_moments_sx(x[3:8], ca.reshape(p[4:13], 3, 3))
    return quadratic_kernel("prior", prior_residual(x[0:3], p[0:3], p[3], second), x, p, output)


def wrench_kernel(form: InertiaForm, output: Output = "quadratic") -> Any:
    """Function (x (16) = xi, unknowns of a known wrench; p (20)) of the same outputs.

    What is known beforehand, as ``wrench.wrench_residual``. p = R_ref of the inertia and of the torque's
    axes, standard deviations of the biases of force and torque.
    """
    x, p = ca.SX.sym("x", N_INERTIA + N_WRENCH), ca.SX.sym("p", 20)
    second, unknowns = form.second_moments_sx(x[0:5], ca.reshape(p[0:9], 3, 3)), x[5:16]
    R = ca.reshape(p[9:18], 3, 3) @ rotation_sx(unknowns[1:4])
    M = -R.T @ second @ R
    products = 3.0 / ALIGNMENT_SIGMA / (2.0 * ca.trace(second)) * ca.vertcat(M[2, 1], M[2, 0], M[1, 0])
    logs = ca.vertcat(unknowns[0], unknowns[7]) / LN_PRIOR
    residual = ca.vertcat(products, unknowns[4:7] / p[19], unknowns[8:11] / p[18], logs)
    return quadratic_kernel("wrench", residual, x, p, output)


def gaussian_prior_kernel(output: Output = "quadratic") -> Any:
    """Function (x (6), p (12) = centre, information) of the same outputs: a pose or its error held softly."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 12)
    return quadratic_kernel("gaussian_prior", ca.sqrt(p[6:12]) * (x - p[0:6]), x, p, output)


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


def dynamics_kernel(
    form: InertiaForm, n_series: int, output: Output = "quadratic", layout: StepLayout = PLAIN
) -> Any:
    """Function (x, p) of cost, gradient, upper Hessian; or residual (12), Jacobian. See ``StepLayout``.

    With a known wrench a third argument: its torque (6, n_series), in each series along P [N m] the value at
    the start and the change (``wrench.Impulses.torque``).
    """
    with_derivatives = output != "cost"
    prepare, finish = _prepare(form, n_series, layout), _finish(output, layout)
    x, p = ca.MX.sym("x", layout.n_x), ca.MX.sym("p", layout.n_p)
    torque = ca.MX.sym("torque", 6, n_series)
    start = ca.vertcat(1.0, 0.0, 0.0, 0.0, x[9:12])
    if with_derivatives:
        nothing = np.zeros(3 * layout.parameters)
        start = ca.vertcat(start, np.zeros(9), nothing, np.eye(3).ravel(), nothing)
    advance = step_function(with_derivatives, layout.pushed)
    if layout.pushed:
        of_series = prepare.map(n_series)(ca.repmat(x, 1, n_series), ca.repmat(p, 1, n_series), torque)
    else:
        of_series = ca.repmat(prepare(x, p), 1, n_series)
    y = (advance.fold(n_series) if n_series > 1 else advance)(start, of_series)
    arguments = [x, p, torque] if layout.pushed else [x, p]
    return ca.Function(f"dynamics{n_series}", arguments, finish.call([x, p, y]))


@lru_cache
def step_function(with_derivatives: bool, pushed: bool = False) -> Any:
    """Function (y, p) -> y over one Taylor series; its ``fold`` makes a step of any length.

    y (7) = attitude since the start of the step, rate; with derivatives those of the attitude error on the
    right, then of the rate, (3, n) each by columns, in w_G and the n - 3 parameters. p = J, J^-1, dJ / dxi (9
    each, by columns), h [s]; with a known wrench the torque in G (6: value at the start, change), and its
    derivatives (6 each) in the other parameters.
    """
    layout = StepLayout(pushed=pushed)
    n = 3 + layout.parameters
    y = ca.SX.sym("y", layout.n_y if with_derivatives else 7)
    p = ca.SX.sym("p", 64 + (6 * (1 + N_OF_ROTATION) if pushed else 0))
    J, J_inv, h_s = ca.reshape(p[0:9], 3, 3), ca.reshape(p[9:18], 3, 3), p[63]
    torque = [p[64:67], p[67:70]] if pushed else [ca.SX.zeros(3), ca.SX.zeros(3)]
    qs, ws, momenta = series_sx(y[0:4], y[4:7], J, J_inv, h_s, torque)
    q, w = ca.SX(sum(qs)), ca.SX(sum(ws))
    out = [q / ca.norm_2(q), w]
    if with_derivatives:
        still = ca.SX.zeros(3, 3)
        dJ = [still] * 3 + [ca.reshape(p[18 + 9 * i : 27 + 9 * i], 3, 3) for i in range(N_INERTIA)]
        dJ += [still] * (layout.parameters - N_INERTIA)
        zero = ca.SX.zeros(3, 3 + N_INERTIA)
        dtorque = [zero, zero]
        if pushed:
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
    """Terms of the Taylor series of attitude, rate and momentum over a step; they add up."""
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
    """True centre of mass r_N (3) of a state (12 or 18), the camera's errors taken out."""
    seen = state[0:3] + R_ref @ (rotation_sx(state[3:6]) @ com_G)
    if state.numel() == N_STATE:
        return seen
    return camera_N + state[12:15] + rotation_sx(state[15:18]) @ (seen - camera_N)


def dynamics_residual(
    before: Any, after: Any, com_G: Any, R0: Any, R1: Any, q01: Any, dt_s: Any, q_step: Any, w_after: Any,
    camera0_N: Any, camera1_N: Any,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """State after minus predicted state (eq. 4.77): position, velocity, attitude, rate.

    before, after (12 or 18); R0, R1 (3, 3) reference attitudes, q01 (4) = q0^-1 q1; q_step (4), w_after (3)
    relative attitude and rate that the motion leads to (eqs. 4.62, 4.65); camera0_N, camera1_N (3) stated
    positions of the camera.
    """
    turn0, turn1 = quaternion_sx(before[3:6]), quaternion_sx(after[3:6])
    r0, r1 = centre_sx(before, com_G, R0, camera0_N), centre_sx(after, com_G, R1, camera1_N)
    inverse = ca.vertcat(1.0, -1.0, -1.0, -1.0)
    if before.numel() > N_STATE:
        # the camera's turns along N become turns along the reference before the step
        error0, error1 = quaternion_sx(R0.T @ before[15:18]), quaternion_sx(R0.T @ after[15:18])
        q01 = quaternion_product_sx(quaternion_product_sx(error0 * inverse, error1), q01)
    relative = quaternion_product_sx(quaternion_product_sx(turn0 * inverse, q01), turn1)
    dtheta = quaternion_log_sx(quaternion_product_sx(q_step * inverse, relative))
    return r1 - r0 - dt_s * before[6:9], after[6:9] - before[6:9], dtheta, after[9:12] - w_after


def _prepare(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """Function (x, p) or (x, p, torque along P (6) of a series) of the parameters of ``step_function``."""
    x, p = layout.symbols()
    xi = x[2 * layout.n_state + 3 : 2 * layout.n_state + 8]
    second = form.second_moments_sx(xi, ca.reshape(p[18:27], 3, 3))
    J = ca.trace(second) * ca.SX.eye(3) - second
    dJ = ca.densify(ca.jacobian(ca.vec(J), xi))
    packed = ca.vertcat(ca.vec(J), ca.vec(ca.inv(J)), ca.vec(dJ), p[31] / n_series)
    if not layout.pushed:
        return ca.Function("prepare", [x, p], [packed])
    known, unknowns = ca.SX.sym("torque", 6), x[2 * layout.n_state + 8 :]
    R = ca.reshape(p[layout.push : layout.push + 9], 3, 3) @ rotation_sx(unknowns[1:4])
    torque = ca.exp(-unknowns[0]) * ca.vertcat(R @ (known[0:3] + unknowns[4:7]), R @ known[3:6])
    slopes = ca.densify(ca.jacobian(torque, unknowns[0:N_OF_ROTATION]))
    return ca.Function("prepare", [x, p, known], [ca.vertcat(packed, torque, ca.vec(slopes))])


@lru_cache
def _finish(output: Output, layout: StepLayout) -> Any:
    """Function (x, p, y of ``step_function``) of what ``dynamics_kernel`` returns."""
    x, p = layout.symbols()
    s, n = layout.n_state, 3 + layout.parameters
    y = ca.SX.sym("y", 7 if output == "cost" else layout.n_y)
    R0, R1 = (ca.reshape(p[9 * i : 9 * i + 9], 3, 3) for i in range(2))
    turn, w_after, at = ca.SX.sym("turn", 3), ca.SX.sym("w_after", 3), layout.camera
    q_step = quaternion_product_sx(y[0:4], quaternion_sx(turn))
    cameras = (p[at : at + 3], p[at + 3 : at + 6]) if s > N_STATE else (ca.SX.zeros(3), ca.SX.zeros(3))
    dr, dv, dtheta, dw = dynamics_residual(
        x[:s], x[s : 2 * s], x[2 * s : 2 * s + 3], R0, R1, p[27:31], p[31], q_step, w_after, *cameras
    )
    if layout.pushed:
        per_kg, bias = ca.exp(-x[2 * s + 15]), x[2 * s + 16 :]
        dr -= per_kg * (p[layout.push + 9 : layout.push + 12] + 0.5 * p[31] ** 2 * bias)
        dv -= per_kg * (p[layout.push + 12 : layout.push + 15] + p[31] * bias)
    # whitened by the process noise of the step (eq. 4.58)
    rotation = ca.reshape(p[35:71], 6, 6) @ ca.vertcat(dtheta, dw)
    r = ca.vertcat(p[32] * dr, p[33] * dr + p[34] * dv, rotation)
    of_end = ca.vertcat(turn, w_after)
    here = ca.vertcat(ca.SX.zeros(3), y[4:7])
    residual = ca.substitute(r, of_end, here)
    if output == "cost":
        return ca.Function("finish", [x, p, y], [0.5 * ca.sumsqr(residual)])
    jacobian, along = (ca.substitute(ca.densify(ca.jacobian(r, to)), of_end, here) for to in (x, of_end))
    of_step = along @ ca.vertcat(ca.reshape(y[7 : 7 + 3 * n], 3, n), ca.reshape(y[7 + 3 * n :], 3, n))
    jacobian[:, 9:12] += of_step[:, 0:3]
    jacobian[:, 2 * s + 3 : 2 * s + n] += of_step[:, 3:]
    return ca.Function("finish", [x, p, y], quadratic_outputs(residual, jacobian, output))
