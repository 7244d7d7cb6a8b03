"""The whole optimization problem as a CasADi nonlinear program, solved by IPOPT.

Nearly all terms of the program are stereo measurements. On CasADi's virtual machine they took two thirds of
IPOPT's time, and building their expressions took longer than solving; here they are external functions, whose
cost, gradient and Hessian entries come from the compiled loops of ``schur``.
"""

from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import (
    N_PRIOR,
    N_WRENCH_PRIOR,
    Output,
    dynamics_kernel,
    gaussian_prior_kernel,
    prior_kernel,
    step_layout,
    wrench_kernel,
)
from polhode.backend.problem.iterate import N_CAMERA, N_CONSTANTS, N_STATE, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.casadi_nlp import (
    OPTIMAL,
    ExternalFunction,
    gather,
    ipopt_options,
    ipopt_solver,
    scatter,
    upper_keys,
    upper_sparsity,
)
from polhode.backend.solvers.gauss_newton import ITERATION_LIMIT, TIME_LIMIT, Solution
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.robust_kernel import kernel_curvature, robust_cost, robust_weight
from polhode.backend.solvers.schur import stereo_normal_equations, stereo_residuals
from polhode.geometry.lie import Array, Ints, exp_so3, right_jacobian_so3, wxyz_from_matrix
from polhode.records.estimate import ProgramEnd

MESSAGES = {
    "Solve_Succeeded": "converged",
    "Solved_To_Acceptable_Level": "converged to the acceptable tolerance",
    "Search_Direction_Becomes_Too_Small": "converged: no further decrease",
    "Maximum_Iterations_Exceeded": ITERATION_LIMIT,
    "Maximum_WallTime_Exceeded": TIME_LIMIT,
}
TOLERANCE = 1e-3
"""Largest gradient at the optimum; whitened residuals are of order one."""
STATIONARY_COST_CHANGE = 1e-7
"""The iterations end when the relative change of the cost stays below this three times in a row."""


class StereoTerms:
    """Robust cost of all stereo measurements as a function of the program's unknowns.

    x (n,): per frame ``n_state`` numbers, the pose p_NG, theta first; landmarks from ``n_dense`` on.
    A (9 F,): R_RN R_ref of each frame, by columns.
    """

    def __init__(self, data: MotionData, n_state: int, n_dense: int) -> None:
        self.data, self.n_state, self.n_dense = data, n_state, n_dense
        self.n_x = n_dense + 3 * data.n_landmarks

    def cost(self, x: Array, A: Array) -> float:
        """Sum of the Cauchy kernel over the measurements."""
        residuals, *_ = self._residuals(x, A)
        return robust_cost(np.sum(residuals**2, axis=1), self.data.robust_scale)

    def gradient(self, x: Array, A: Array) -> Array:
        """(n,)"""
        _, g, _, h, _ = self._blocks(x, A)
        out = np.zeros(self.n_x)
        np.add.at(out, self._of_poses(), g)
        out[self.n_dense :] += h.ravel()
        return out

    def keys(self) -> Ints:
        """Cells ``column * n + row`` of the entries of ``hessian``, all on or above the diagonal."""
        d, n = self.data, self.n_x
        cols, rows = np.tril_indices(6)
        poses = self._of_poses()
        marks = self.n_dense + np.arange(3 * d.n_landmarks).reshape(-1, 3)
        own_cols, own_rows = np.tril_indices(3)
        of_poses, of_marks = poses[:, cols] * n + poses[:, rows], marks[:, own_cols] * n + marks[:, own_rows]
        across = marks[d.landmark][:, None, :] * n + poses[d.frame][:, :, None]
        return np.concatenate([of_poses.ravel(), across.ravel(), of_marks.ravel()])

    def hessian(self, x: Array, A: Array) -> Array:
        """Entries of the Gauss-Newton Hessian with the kernel's curvature, in the order of ``keys``."""
        H, _, C, _, E = self._blocks(x, A)
        cols, rows = np.tril_indices(6)
        own_cols, own_rows = np.tril_indices(3)
        return np.concatenate([H[:, cols, rows].ravel(), E.ravel(), C[:, own_cols, own_rows].ravel()])

    def _of_poses(self) -> Ints:
        return self.n_state * np.arange(self.data.n_frames)[:, None] + np.arange(6)

    def _residuals(self, x: Array, A: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Whitened residuals (M, 3); attitudes in the camera (F, 3, 3), theta (F, 3), p_NG, p_G."""
        d = self.data
        poses = x[self._of_poses()]
        p_NG, theta = np.ascontiguousarray(poses[:, :3]), poses[:, 3:]
        now = np.swapaxes(A.reshape(-1, 3, 3), 1, 2) @ exp_so3(theta)
        p_G = x[self.n_dense :].reshape(-1, 3)
        fixed = (d.frame, d.landmark, d.uvd_px, d.inv_sigma, d.rig)
        return stereo_residuals(*fixed, now, d.R_RN, d.t_R, p_NG, p_G), now, theta, p_NG, p_G

    def _blocks(self, x: Array, A: Array) -> tuple[Array, Array, Array, Array, Array]:
        d = self.data
        residuals, now, theta, p_NG, p_G = self._residuals(x, A)
        s = np.sum(residuals**2, axis=1)
        fixed = (d.frame, d.landmark, d.inv_sigma, d.rig)
        point = (now, d.R_RN, d.t_R, p_NG, p_G, right_jacobian_so3(theta), residuals)
        return stereo_normal_equations(
            *fixed, *point, robust_weight(s, d.robust_scale), kernel_curvature(s, d.robust_scale)
        )


class MotionProgram:
    r"""Full smoothing of a tumbling rigid body (thesis eqs. 4.77-4.108), stated once.

    Unknowns ``x``, s F + c + 3 L numbers: for each frame k the pose of the geometric frame ``p_k``,
    ``theta_k`` (attitude R_k = R_ref,k Exp(theta_k)), the velocity ``v_k`` of the centre of mass and the
    angular velocity ``w_k`` in G (s = 12), and where the camera's stated poses are noisy their errors
    ``b_k``, ``alpha_k`` (s = 18); the constants ``com`` and ``xi`` (inertia up to scale, ``inertia.py``;
    c = 8), and where forces or torques are known mass, scale, biases and the torque's axes (``wrench.py``;
    c = 19); landmarks ``l_j`` in G.

    minimise over x, without constraints::

        sum_(k,j) rho(|| Sigma_kj^-1/2 (uvd_kj - project(R_RN,k (R_k l_j + p_k) + t_R,k)) ||^2)     stereo
      + 1/2 sum_k || Lambda_k^-1/2 [ r_k+1 - r_k - dt v_k;  v_k+1 - v_k;                            dynamics
                                     Log(dR_k^T R_k^T R_k+1);  w_k+1 - w'_k ] ||^2
      + 1/2 || (com - middle) / s ||^2 + 1/2 || 3 Sigma(xi) / tr Sigma(xi) - I ||^2              weak prior
      + 1/2 || (p_0 - p_ref,0, theta_0) / gauge ||^2                                           frame G fixed
      + 1/2 sum_k || (b_k / sigma_p, alpha_k / sigma_theta) ||^2                              camera's poses
      + 1/2 || products of inertia in the torque's axes, biases, logarithms ||^2                known wrench

    where r_k = p_k + R_k com; with a noisy camera at c_k the dynamics have Exp(alpha_k) R_k for R_k and
    c_k + b_k + Exp(alpha_k) (r_k - c_k) for r_k: vision sees from the stated pose, mechanics acts on the true
    one; dR_k, w'_k solve Euler's equation J(xi) w' = -w x J(xi) w over dt from w_k (Taylor series),
    with a known torque over the scale added, and force over mass in the translation;
    rho(s) = c^2/2 ln(1 + s/c^2); Lambda_k solves the Lyapunov equation (4.58) at that rate.
    R_ref, Lambda, middle and the gauge are parameters, renewed between solves (``linearization_point``).

    Each term of the dynamics and the priors is a small kernel that returns cost, gradient and Gauss-Newton
    Hessian; constant sparse matrices scatter the stacked blocks into the program's gradient and Hessian. The
    stereo terms come from compiled loops (``StereoTerms``). CasADi never differentiates the whole.
    """

    name = "ipopt"

    def __init__(self, data: MotionData) -> None:
        self.data = data
        self._series: Ints = np.zeros(0, dtype=np.int64)
        self.program: Any = None
        # CasADi keeps only weak references to them
        self._outside: list[ExternalFunction] = []

    def solve(
        self, fixed: LinearizationPoint, x: Array, max_iterations: int, max_seconds: float = np.inf
    ) -> Solution:
        """Minimize from x. The program is built at the first call, and when a step needs more series."""
        begin, series = perf_counter(), fixed.steps.series
        if self.program is None or np.any(series > self._series):
            self._series = np.maximum(series, self._series) if self.program else series
            layout = ProgramLayout(fixed.reference, int(self._series.max()))
            self.program = self.build(layout, program_options(max_iterations, max_seconds))
        result = self.program(x0=x, p=program_parameters(self.data, fixed, self._series))
        stats = self.program.stats()
        status = str(stats["return_status"])
        good, message, count = status in OPTIMAL, MESSAGES.get(status, status), int(stats["iter_count"])
        # gradient of the Lagrangian at the last iterate; there are no constraints to violate
        history = stats.get("iterations", {})
        gradient, violation = (float((history.get(name) or [np.nan])[-1]) for name in ("inf_du", "inf_pr"))
        end = ProgramEnd(status, gradient, violation, count, perf_counter() - begin)
        return Solution(np.asarray(result["x"]).ravel(), float(result["f"]), count, good, message, end)

    def build(self, layout: "ProgramLayout", options: dict[str, Any]) -> Any:
        """The solver as a CasADi function of the start and the parameters."""
        stereo = StereoTerms(self.data, layout.n_state, layout.n_dense)
        n_x, n_attitudes = stereo.n_x, 9 * self.data.n_frames
        x, p = ca.MX.sym("x", n_x), ca.MX.sym("p", layout.n_p)
        keys = stereo.keys()
        functions = ((stereo.cost, 1), (stereo.gradient, n_x), (stereo.hessian, len(keys)))
        self._outside = [ExternalFunction(f.__name__, f, (n_x, n_attitudes), n) for f, n in functions]
        of_stereo = [outside(x, p[:n_attitudes]) for outside in self._outside]
        cost = of_stereo[0] + sum(ca.sum2(outputs[0]) for _, outputs in self.terms(x, p, layout, "cost"))

        terms = self.terms(x, p, layout, "gradient")
        slots = np.concatenate([slots.ravel() for slots, _ in terms])
        of_terms = ca.vertcat(*[ca.vec(outputs[1]) for _, outputs in terms])
        gradient = of_stereo[1] + scatter(slots, n_x) @ of_terms

        terms = self.terms(x, p, layout, "quadratic")
        keys = np.concatenate([keys, *[upper_keys(slots, n_x) for slots, _ in terms]])
        cells, position = np.unique(keys, return_inverse=True)
        blocks = ca.vertcat(of_stereo[2], *[ca.vec(outputs[2]) for _, outputs in terms])
        hessian = upper_sparsity(cells, n_x), scatter(position, len(cells)) @ blocks
        return ipopt_solver("motion", options, x, p, cost, gradient, hessian)

    def terms(self, x: Any, p: Any, at: "ProgramLayout", output: Output) -> list[tuple[Ints, Any]]:
        """Of each kernel the unknowns (n, width) that its uses read, and the outputs of these."""
        d, s, step = self.data, at.n_state, at.step
        of_constants = s * d.n_frames + np.arange(step.n_constants)
        terms = []
        for series, slots, arguments in self.steps(x, p, at):
            kernel = dynamics_kernel(d.form, series, output, step).map(len(slots))
            terms.append((slots, kernel.call(arguments)))

        def add(kernel: Any, slots: Ints, parameters: Any) -> None:
            terms.append((slots, kernel.call([gather(x, slots), parameters])))

        gaussian = gaussian_prior_kernel(output)
        add(prior_kernel(d.form, output), of_constants[None, :N_CONSTANTS], p[at.prior : at.prior + N_PRIOR])
        add(gaussian, np.arange(6)[None], p[at.gauge : at.gauge + 12])
        if s > N_STATE:
            errors = s * np.arange(d.n_frames)[:, None] + N_STATE + np.arange(N_CAMERA)
            add(gaussian.map(d.n_frames), errors, ca.repmat(p[at.camera : at.camera + 12], 1, d.n_frames))
        if step.with_wrench:
            add(wrench_kernel(d.form, output), of_constants[None, 3:], p[at.wrench : at.n_p])
        return terms

    def steps(self, x: Any, p: Any, at: "ProgramLayout") -> list[tuple[int, Ints, list[Any]]]:
        """For each number of series: the unknowns of its steps, and the arguments of the kernel."""
        s, step, steps = at.n_state, at.step, []
        of_constants = s * self.data.n_frames + np.arange(step.n_constants)
        for series in np.unique(self._series).tolist():
            index = np.flatnonzero(self._series == series)
            states = s * index[:, None] + np.arange(2 * s)
            constants = np.broadcast_to(of_constants, (len(index), step.n_constants))
            slots = np.concatenate([states, constants], axis=1)
            of_p = at.steps + step.n_p * index[:, None] + np.arange(step.n_p)
            arguments = [gather(x, slots), gather(p, of_p)]
            if step.with_wrench:
                torque = gather(p, at.torque + at.n_torque * index[:, None] + np.arange(6 * series))
                arguments.append(ca.reshape(torque, 6, series * len(index)))
            steps.append((series, slots, arguments))
        return steps


def program_options(max_iterations: int, max_seconds: float) -> dict[str, Any]:
    """Options of CasADi and IPOPT, without the derivatives."""
    limit = float(np.clip(max_seconds, 1e-6, 1e6))
    return ipopt_options(TOLERANCE, STATIONARY_COST_CHANGE, max_iterations, max_wall_time=limit)


class ProgramLayout:
    """Where each kind of unknown and of parameter begins in the program's vectors; attitudes A come first."""

    def __init__(self, reference: Iterate, most_series: int) -> None:
        self.reference = reference
        self.n_state, self.n_dense, n = reference.n_state, reference.n_dense, reference.n_frames
        self.step = step_layout(reference.n_state, reference.wrench is not None)
        self.n_torque = 6 * most_series if self.step.with_wrench else 0
        self.steps = 9 * n
        self.torque = self.steps + self.step.n_p * (n - 1)
        self.prior = self.torque + self.n_torque * (n - 1)
        self.gauge = self.prior + N_PRIOR
        self.camera = self.gauge + 12
        self.wrench = self.camera + 12
        self.n_p = self.wrench + N_WRENCH_PRIOR


def program_parameters(data: MotionData, fixed: LinearizationPoint, series: Ints) -> Array:
    """Values of the parameters in the order of ``ProgramLayout``."""
    reference = fixed.reference
    torque, wrench = np.zeros(0), np.zeros(N_WRENCH_PRIOR)
    if reference.wrench is not None and reference.R_torque is not None and data.impulses is not None:
        # by columns: the six numbers of a series are contiguous
        torque = data.impulses.torque(series).ravel()
        axes = [reference.R_inertia.T.ravel(), reference.R_torque.T.ravel()]
        wrench = np.concatenate([*axes, fixed.bias_sigma])
    gauge = [reference.p_NG[0], np.zeros(3), fixed.gauge_information]
    camera = [np.zeros(N_CAMERA), fixed.camera_information]
    steps = [dynamics_parameters(data, fixed).ravel(), torque]
    attitudes = np.swapaxes(fixed.A, 1, 2).ravel()
    return np.concatenate([attitudes, *steps, fixed.prior, *gauge, *camera, wrench])


def dynamics_parameters(data: MotionData, fixed: LinearizationPoint) -> Array:
    """Parameters (F - 1, n_p) of the steps in the order of ``kernels.StepLayout``."""
    at, W_t, n = fixed.reference, fixed.steps.W_t, data.n_frames - 1
    by_columns = np.swapaxes(at.R_NG, 1, 2).reshape(-1, 9)
    inertia = np.broadcast_to(at.R_inertia.T.ravel(), (n, 9))
    q01 = wxyz_from_matrix(np.swapaxes(at.R_NG[:-1], 1, 2) @ at.R_NG[1:])
    lower = np.stack([W_t[:, 0, 0], W_t[:, 1, 0], W_t[:, 1, 1]], axis=1)
    whiten = np.swapaxes(fixed.steps.W_r, 1, 2).reshape(-1, 36)
    columns = [by_columns[:-1], by_columns[1:], inertia, q01, data.dt_s[:, None], lower, whiten]
    if at.n_state > N_STATE:
        columns += [data.camera_N[:-1], data.camera_N[1:]]
    if at.R_torque is not None and fixed.steps.force_increments is not None:
        axes = np.broadcast_to(at.R_torque.T.ravel(), (n, 9))
        columns += [axes, fixed.steps.force_increments.reshape(n, 6)]
    return np.concatenate(columns, axis=1)
