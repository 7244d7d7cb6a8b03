"""The whole optimisation problem as a CasADi nonlinear program, solved by IPOPT."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix

from backend.gauss_newton import Solution
from backend.kernels import (
    N_CAMERA,
    N_CONSTANTS,
    N_STATE,
    Output,
    dynamics_kernel,
    hold_kernel,
    prior_kernel,
    step_parameters,
    stereo_kernel,
)
from backend.problem import Held, MotionData, series_groups
from polhode.lie import Array
from polhode.quaternion import wxyz_from_matrix
from polhode.records import Ints

TOLERANCE = 1e-3
"""Largest gradient at the end, where whitened residuals are of order one."""
COST_AT_REST = 1e-7
"""Relative change of the cost that ends the iterations when it is not exceeded three times in a row."""


@dataclass(frozen=True)
class _Term:
    """Expressions of one kernel over its data, and the unknowns (n, width) that each application reads."""

    slots: Ints
    cost: Any
    gradient: Any = None
    hessian: Any = None


class MotionProgram:
    r"""Full smoothing of a tumbling rigid body (thesis eqs. 4.77-4.108), stated once.

    Unknowns ``x``, s F + 8 + 3 L numbers: for each frame k the pose of the geometric frame ``p_k``,
    ``theta_k`` (attitude R_k = R_ref,k Exp(theta_k)), the velocity ``v_k`` of the centre of mass and the
    angular velocity ``w_k`` in G (s = 12), and where the camera's stated poses are noisy their errors
    ``b_k``, ``alpha_k`` (s = 18); the constants ``com`` and ``xi`` (inertia up to scale, ``inertia.py``);
    landmarks ``l_j`` in G.

    minimise over x, without constraints::

        sum_(k,j) rho(|| Sigma_kj^-1/2 (uvd_kj - project(R_RN,k (R_k l_j + p_k) + t_R,k)) ||^2)     stereo
      + 1/2 sum_k || Lambda_k^-1/2 [ r_k+1 - r_k - dt v_k;  v_k+1 - v_k;                            dynamics
                                     Log(dR_k^T R_k^T R_k+1);  w_k+1 - w'_k ] ||^2
      + 1/2 || (com - middle) / s ||^2 + 1/2 || 3 Sigma(xi) / tr Sigma(xi) - I ||^2              weak prior
      + 1/2 || (p_0 - p_ref,0, theta_0) / gauge ||^2                                           frame G held
      + 1/2 sum_k || (b_k / sigma_p, alpha_k / sigma_theta) ||^2                              camera's poses

    where r_k = p_k + R_k com; with a noisy camera at c_k the dynamics have Exp(alpha_k) R_k for R_k and
    c_k + b_k + Exp(alpha_k) (r_k - c_k) for r_k: vision sees from the stated pose, mechanics acts on the true
    one; dR_k, w'_k solve Euler's equation J(xi) w' = -w x J(xi) w over dt from w_k (Taylor series);
    rho(s) = c^2/2 ln(1 + s/c^2); Lambda_k solves the Lyapunov equation (4.58) at that rate.
    R_ref, Lambda, middle and the gauge are parameters, renewed between solves (``problem.hold``).

    Each term is a small kernel that returns cost, gradient and Gauss-Newton Hessian; constant sparse matrices
    scatter the stacked blocks into the program's gradient and Hessian. CasADi never differentiates the whole.
    """

    name = "ipopt"

    def __init__(self, data: MotionData) -> None:
        self.data = data
        self._series: Ints = np.zeros(0, dtype=np.int64)
        self._solver: Any = None

    def solve(self, held: Held, x: Array, max_iterations: int) -> Solution:
        """Minimise from x. The program is built at the first call, and when a step needs more series."""
        if self._solver is None or np.any(held.steps.series > self._series):
            self._series = np.maximum(held.steps.series, self._series) if self._solver else held.steps.series
            self._solver = self._build(held.reference.n_state, max_iterations)
        result = self._solver(x0=x, p=_parameters(self.data, held))
        stats = self._solver.stats()
        status = str(stats["return_status"])
        good = status in (
            "Solve_Succeeded",
            "Solved_To_Acceptable_Level",
            "Search_Direction_Becomes_Too_Small",
        )
        return Solution(
            np.asarray(result["x"]).ravel(), float(result["f"]), int(stats["iter_count"]), good, status
        )

    def _build(self, n_state: int, max_iterations: int) -> Any:
        d = self.data
        n_x = n_state * d.n_frames + N_CONSTANTS + 3 * d.n_landmarks
        x, p = ca.MX.sym("x", n_x), ca.MX.sym("p", _Packed(d.n_frames, n_state).size)
        cost = sum(ca.sum2(term.cost) for term in self._terms(x, p, n_state, "cost"))

        terms = self._terms(x, p, n_state, "gradient")
        slots = np.concatenate([term.slots.ravel() for term in terms])
        gradient = _scatter(slots, n_x) @ ca.vertcat(*[ca.vec(term.gradient) for term in terms])

        terms = self._terms(x, p, n_state, "quadratic")
        keys = np.concatenate([_upper_keys(term.slots, n_x) for term in terms])
        cells, position = np.unique(keys, return_inverse=True)
        values = _scatter(position, len(cells)) @ ca.vertcat(*[ca.vec(term.hessian) for term in terms])
        sparsity = _upper_sparsity(cells, n_x)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
        grad_f = ca.Function("nlp_grad_f", [x, p], [cost, gradient], ["x", "p"], ["f", "grad_f_x"])
        hess = ca.Function(
            "nlp_hess_l",
            [x, p, lam_f, lam_g],
            [ca.MX(sparsity, lam_f * values)],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        )
        options: Any = {
            "grad_f": grad_f,
            "hess_lag": hess,
            "no_nlp_grad": True,
            "calc_lam_p": False,
            "print_time": False,
            "error_on_fail": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "linear_solver": "mumps",
                "max_iter": max_iterations,
                "tol": TOLERANCE,
                "dual_inf_tol": TOLERANCE,
                # In the flat valley of an undetermined motion gradients stay large while the cost rests.
                "acceptable_tol": 1e8,
                "acceptable_iter": 3,
                "acceptable_obj_change_tol": COST_AT_REST,
                "nlp_scaling_method": "none",
            },
        }
        problem: Any = {"x": x, "p": p, "f": cost}
        return ca.nlpsol("motion", "ipopt", problem, options)

    def _terms(self, x: Any, p: Any, n_state: int, output: Output) -> list[_Term]:
        """Kernels mapped over their data: stereo, dynamics by number of series, prior, what is held."""
        d, at = self.data, _Packed(self.data.n_frames, n_state)
        of_constants = n_state * d.n_frames + np.arange(N_CONSTANTS)
        terms = [self._stereo(x, p, n_state, output)]
        for series, index in series_groups(self._series):
            states = n_state * index[:, None] + np.arange(2 * n_state)
            constants = np.broadcast_to(of_constants, (len(index), N_CONSTANTS))
            slots = np.concatenate([states, constants], axis=1)
            parameters = _gather(p, at.steps + at.of_step * index[:, None] + np.arange(at.of_step))
            kernel = dynamics_kernel(d.form, series, output, n_state).map(len(index))
            terms.append(_Term(slots, *kernel.call([_gather(x, slots), parameters])))
        prior = prior_kernel(d.form, output)
        terms.append(
            _Term(of_constants[None], *prior.call([x[of_constants.tolist()], p[at.prior : at.gauge]]))
        )
        hold = hold_kernel(output)
        gauge = np.arange(6)[None]
        terms.append(_Term(gauge, *hold.call([x[0:6], p[at.gauge : at.camera]])))
        if n_state > N_STATE:
            errors = n_state * np.arange(d.n_frames)[:, None] + N_STATE + np.arange(N_CAMERA)
            held = ca.repmat(p[at.camera : at.size], 1, d.n_frames)
            terms.append(_Term(errors, *hold.map(d.n_frames).call([_gather(x, errors), held])))
        return terms

    def _stereo(self, x: Any, p: Any, n_state: int, output: Output) -> _Term:
        d = self.data
        n_dense, m = n_state * d.n_frames + N_CONSTANTS, len(d.frame)
        pose = n_state * d.frame[:, None] + np.arange(6)
        mark = n_dense + 3 * d.landmark[:, None] + np.arange(3)
        slots = np.concatenate([pose, mark], axis=1)
        A = _gather(p, 9 * d.frame[:, None] + np.arange(9))
        R_RN = np.swapaxes(d.R_RN, 1, 2).reshape(-1, 9)[d.frame]
        constants = (R_RN, d.t_R[d.frame], d.uvd_px, d.inv_sigma)
        fixed = [ca.DM(np.ascontiguousarray(c.T)) for c in constants]
        kernel = stereo_kernel(d.robust_scale, output).map(m)
        return _Term(slots, *kernel.call([_gather(x, slots), A, *fixed, ca.DM(d.rig)]))


class _Packed:
    """Where each kind of parameter begins in the program's vector: attitudes A come first."""

    def __init__(self, n_frames: int, n_state: int) -> None:
        self.steps, self.of_step = 9 * n_frames, step_parameters(n_state)
        self.prior = self.steps + self.of_step * (n_frames - 1)
        self.gauge = self.prior + 13
        self.camera = self.gauge + 12
        self.size = self.camera + 12


def _parameters(data: MotionData, held: Held) -> Array:
    by_columns, first = np.swapaxes(held.A, 1, 2).ravel(), held.reference.p_NG[0]
    gauge = [first, np.zeros(3), held.gauge_information]
    camera = [np.zeros(N_CAMERA), held.camera_information]
    steps = dynamics_parameters(data, held).ravel()
    return np.concatenate([by_columns, steps, held.prior, *gauge, *camera])


def dynamics_parameters(data: MotionData, held: Held) -> Array:
    """Pack the parameters (F - 1, 71 or 77) in the order that ``kernels.dynamics_kernel`` reads."""
    R, W_t, n = held.reference.R_NG, held.steps.W_t, data.n_frames - 1
    by_columns = np.swapaxes(R, 1, 2).reshape(-1, 9)
    inertia = np.broadcast_to(held.reference.R_inertia.T.ravel(), (n, 9))
    q01 = wxyz_from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    lower = np.stack([W_t[:, 0, 0], W_t[:, 1, 0], W_t[:, 1, 1]], axis=1)
    whiten = np.swapaxes(held.steps.W_r, 1, 2).reshape(-1, 36)
    columns = [by_columns[:-1], by_columns[1:], inertia, q01, data.dt_s[:, None], lower, whiten]
    if held.reference.n_state > N_STATE:
        columns += [data.camera_N[:-1], data.camera_N[1:]]
    return np.concatenate(columns, axis=1)


def _gather(vector: Any, slots: Ints) -> Any:
    """Columns of a matrix (width, n) from the entries ``slots`` (n, width) of a vector."""
    return ca.reshape(vector[slots.ravel().tolist()], slots.shape[1], slots.shape[0])


def _scatter(target: Ints, size: int) -> Any:
    """Constant matrix (size, n) that adds entry e of a vector to ``target[e]``."""
    n = len(target)
    return ca.DM(csc_matrix((np.ones(n), (target, np.arange(n))), shape=(size, n)))


def _upper_keys(slots: Ints, n_x: int) -> Ints:
    """Cells ``column * n_x + row`` of the upper blocks of each row of slots (n, width), by columns."""
    width = slots.shape[1]
    cols, rows = np.tril_indices(width)
    return np.asarray(slots[:, cols] * n_x + slots[:, rows]).ravel()


def _upper_sparsity(cells: Ints, n_x: int) -> Any:
    columns, rows = np.divmod(cells, n_x)
    offsets = np.searchsorted(columns, np.arange(n_x + 1))
    return ca.Sparsity(n_x, n_x, offsets.tolist(), rows.tolist())
