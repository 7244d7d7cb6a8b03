"""IPOPT with MUMPS on the window's program, built once for a fixed number of states and warm-started.

States that do not exist yet are fixed at 0 by a unit quadratic, and their steps have no weight. The unknowns
are the changes from the start, scaled by the diagonal of the Hessian.
"""

from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import N_PRIOR, PLAIN, Output, dynamics_kernel, prior_kernel
from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, N_STATE
from polhode.backend.solvers.casadi_nlp import OPTIMAL, gather, ipopt_options, ipopt_solver, scatter
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.problem import WindowProblem
from polhode.geometry.lie import Array, Ints, wxyz_from_matrix

TOLERANCE = 1e-3
"""Largest gradient at the optimum: a thousandth of a standard deviation."""
STATIONARY_COST_CHANGE = 1e-4
"""Negligible change of the cost; the iterations end after three of them in a row."""
MAX_ITERATIONS = 40


class IpoptSolver:
    """Solver of ``WindowProblem``; a new program is built only when the steps need longer series."""

    name = "ipopt"

    def __init__(self, n_frames: int) -> None:
        """n_frames: the largest number of states of a problem."""
        self.n_frames, self.size = n_frames, N_STATE * n_frames + N_CONSTANTS
        self._series = 0
        self._program: Any = None

    def solve(self, problem: WindowProblem, x: Array) -> Solution:
        """Minimize from x (12 W + 8,)."""
        series = int(problem.steps.series.max(initial=1))
        if self._program is None or series > self._series:
            self._series = series
            self._program = self._build(problem.prior.form, series)
        states, constants = np.arange(N_STATE * problem.n_frames), np.arange(self.size)[-N_CONSTANTS:]
        at = np.concatenate([states, constants])
        before, H, _ = problem.normal_equations(x)
        size = np.ones(self.size)
        # the scale is limited for weakly determined unknowns: 1 m, 1 rad and ratios of 1 are large enough
        size[at] = 1.0 / np.sqrt(np.maximum(np.diagonal(H), 1.0))
        result = self._program(x0=0.0, p=self._parameters(problem, x, at, size))
        stats = self._program.stats()
        status = str(stats["return_status"])
        found = x + (size * np.asarray(result["x"]).ravel())[at]
        # evaluated by the reference implementation: a step that diverges is not taken
        cost = problem.cost(found) if np.isfinite(found).all() else np.inf
        if not cost <= before + STATIONARY_COST_CHANGE:
            return Solution(x, before, int(stats["iter_count"]), False, f"no decrease: {status}")
        return Solution(found, cost, int(stats["iter_count"]), status in OPTIMAL, status)

    def _slots(self) -> tuple[Ints, Ints]:
        """(W - 1, 32) entries that each step between states reads, and (1, 8) the constants."""
        states = N_STATE * np.arange(self.n_frames - 1)[:, None] + np.arange(2 * N_STATE)
        constants = np.arange(self.size - N_CONSTANTS, self.size)[None]
        return np.hstack([states, np.repeat(constants, len(states), axis=0)]), constants

    def _build(self, form: InertiaForm, series: int) -> Any:
        """Unknowns z (n), x = start + size z. Parameters: start, size, q (n each), Q (n, n), steps, prior.

        Every kernel returns its cost, gradient and Hessian blocks; constant sparse matrices add them up.
        """
        n, (slots, constants) = self.size, self._slots()
        shapes = {"start": (n, 1), "size": (n, 1), "q": (n, 1), "Q": (n, n), "steps": (PLAIN.n_p, len(slots)),
                  "weak": (N_PRIOR, 1)}  # fmt: skip
        ends = np.cumsum([0, *(rows * columns for rows, columns in shapes.values())])
        z, p = ca.MX.sym("z", n), ca.MX.sym("p", int(ends[-1]))
        parts = zip(ca.vertsplit(p, ends.tolist()), shapes.values(), strict=True)
        start, size, q, Q, steps, weak = (ca.reshape(part, *shape) for part, shape in parts)
        x = start + size * z
        at_steps = gather(x, slots)

        def terms(output: Output) -> list[Any]:
            dynamics = dynamics_kernel(form, series, output).map(len(slots)).call([at_steps, steps])
            prior = prior_kernel(form, output).call([x[n - N_CONSTANTS :], weak])
            return list(zip(dynamics, prior, strict=True))

        along = ca.mtimes(Q, z)
        (of_steps, of_prior), *_ = terms("cost")
        cost = ca.dot(z, q + 0.5 * along) + ca.sum2(of_steps) + of_prior
        _, (g_steps, g_prior) = terms("gradient")
        where = np.concatenate([slots.ravel(), constants.ravel()])
        gradient = q + along + size * (scatter(where, n) @ ca.vertcat(ca.vec(g_steps), g_prior))
        _, _, (h_steps, h_prior) = terms("quadratic")
        cols, rows = np.tril_indices(n)
        where = np.concatenate([_upper_cells(each) for each in (slots, constants)])
        curvature = scatter(where, len(rows)) @ ca.vertcat(ca.vec(h_steps), h_prior)
        scale = size[rows.tolist()] * size[cols.tolist()]
        values = ca.vec(Q)[(rows + n * cols).tolist()] + scale * curvature
        options = ipopt_options(TOLERANCE, STATIONARY_COST_CHANGE, MAX_ITERATIONS)
        return ipopt_solver("window", options, z, p, cost, gradient, (ca.Sparsity.upper(n), values))

    def _parameters(self, problem: WindowProblem, x: Array, at: Ints, size: Array) -> Array:
        n = self.size
        start, q, Q = np.zeros(n), np.zeros(n), np.eye(n)
        start[at] = x
        q[at] = problem.vision.gradient(x)
        Q[np.ix_(at, at)] = problem.vision.H
        columns = np.zeros((self.n_frames - 1, PLAIN.n_p))
        # steps between states that do not exist yet: no rotation in 1 s, no weight
        columns[:, PLAIN.R_BEFORE] = columns[:, PLAIN.R_AFTER] = np.eye(3).ravel()
        columns[:, PLAIN.Q_BETWEEN] = 1.0, 0.0, 0.0, 0.0
        columns[:, PLAIN.DT] = 1.0
        columns[:, PLAIN.R_INERTIA] = problem.weak_prior[4:13]
        steps, R, m = problem.steps, problem.R_ref, len(problem.steps.dt_s)
        by_columns = np.swapaxes(R, 1, 2).reshape(-1, 9)
        columns[:m, PLAIN.R_BEFORE], columns[:m, PLAIN.R_AFTER] = by_columns[:-1], by_columns[1:]
        columns[:m, PLAIN.Q_BETWEEN] = wxyz_from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:])
        columns[:m, PLAIN.DT] = steps.dt_s
        columns[:m, PLAIN.W_T] = steps.W_t[:, [0, 1, 1], [0, 0, 1]]
        columns[:m, PLAIN.W_R] = np.swapaxes(steps.W_r, 1, 2).reshape(-1, 36)
        scaled = (size[:, None] * Q * size).ravel()
        return np.concatenate([start, size, size * q, scaled, columns.ravel(), problem.weak_prior])


def _upper_cells(slots: Ints) -> Ints:
    """Cells of the upper triangle, counted by columns, that the blocks on each row of slots touch."""
    cols, rows = np.tril_indices(slots.shape[1])
    first, second = slots[:, rows], slots[:, cols]
    return np.asarray(second * (second + 1) // 2 + first).ravel()
