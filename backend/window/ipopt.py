"""IPOPT with MUMPS on the window's program, built once for a fixed number of states and warm-started.

States that do not exist yet are fixed at 0 by a unit quadratic, and their steps have no weight. The unknowns
are the changes from the start, scaled by the diagonal of the Hessian.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import N_PRIOR, PLAIN, Output, dynamics_kernel, prior_kernel
from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, N_STATE
from polhode.backend.solvers.casadi_nlp import OPTIMAL, gather, ipopt_options, ipopt_solver, scatter
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.problem import WindowProblem
from polhode.lie import Array, wxyz_from_matrix
from polhode.records import Ints

TOLERANCE = 1e-3
"""Largest gradient at the optimum: a thousandth of a standard deviation."""
STATIONARY_COST_CHANGE = 1e-4
"""Negligible change of the cost; the iterations end after three of them in a row."""
MAX_ITERATIONS = 40
N_FACTOR = PLAIN.n_p
"""Parameters of a step."""


class IpoptSolver:
    """Solver of ``WindowProblem``; a new program is built only when the steps need longer series."""

    name = "ipopt"

    def __init__(self, n_frames: int) -> None:
        """n_frames: the largest number of states of a problem."""
        self.n_frames = n_frames
        self._series = 0
        self._program: Any = None

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimize from x (12 W + 8,), with the program's own limit of iterations."""
        del max_iterations
        series = int(problem.factors.steps.series.max(initial=1))
        if self._program is None or series > self._series:
            self._series = series
            self._program = _build(_Layout(self.n_frames), problem.prior.form, series)
        at = _Layout(self.n_frames).entries(problem.n_frames)
        before, H, _ = problem.normal_equations(x)
        size = np.ones(N_STATE * self.n_frames + N_CONSTANTS)
        # the scale is limited for weakly determined unknowns: 1 m, 1 rad and ratios of 1 are large enough
        size[at] = 1.0 / np.sqrt(np.maximum(np.diagonal(H), 1.0))
        result = self._program(x0=0.0, p=_parameters(problem, x, at, size, self.n_frames))
        stats = self._program.stats()
        status = str(stats["return_status"])
        found = x + (size * np.asarray(result["x"]).ravel())[at]
        # evaluated by the reference implementation: a step that diverges is not taken
        cost = problem.cost(found) if np.isfinite(found).all() else np.inf
        if not cost <= before + STATIONARY_COST_CHANGE:
            return Solution(x, before, int(stats["iter_count"]), False, f"no decrease: {status}")
        return Solution(found, cost, int(stats["iter_count"]), status in OPTIMAL, status)


@dataclass(frozen=True)
class _Layout:
    """Layout of the unknowns: states of ``n_frames`` frames, then the constants."""

    n_frames: int

    @property
    def size(self) -> int:
        return N_STATE * self.n_frames + N_CONSTANTS

    @property
    def upper(self) -> tuple[Ints, Ints]:
        """Rows and columns of the upper triangle, by columns."""
        cols, rows = np.tril_indices(self.size)
        return rows, cols

    def entries(self, n_frames: int) -> Ints:
        """Entries of a problem with fewer states."""
        of_constants = np.arange(self.size - N_CONSTANTS, self.size)
        return np.concatenate([np.arange(N_STATE * n_frames), of_constants])

    def slots(self) -> Ints:
        """(W - 1, 32) entries that each step between states reads."""
        states = N_STATE * np.arange(self.n_frames - 1)[:, None] + np.arange(2 * N_STATE)
        of_constants = np.arange(self.size - N_CONSTANTS, self.size)
        constants = np.broadcast_to(of_constants, (len(states), N_CONSTANTS))
        return np.concatenate([states, constants], axis=1)


def _build(layout: _Layout, form: InertiaForm, series: int) -> Any:
    """Unknowns z (n), x = start + size z. Parameters: start, size, q (n each), Q (n, n), factors, weak prior.

    Every kernel returns its cost, gradient and Hessian blocks; constant sparse matrices add them up.
    """
    n, slots = layout.size, layout.slots()
    z, start, size, q = ca.MX.sym("z", n), ca.MX.sym("start", n), ca.MX.sym("size", n), ca.MX.sym("q", n)
    Q, factors = ca.MX.sym("Q", n, n), ca.MX.sym("factors", N_FACTOR, len(slots))
    weak = ca.MX.sym("weak", N_PRIOR)
    x = start + size * z
    at_factors = gather(x, slots)

    def terms(output: Output) -> list[Any]:
        dynamics = dynamics_kernel(form, series, output).map(len(slots)).call([at_factors, factors])
        prior = prior_kernel(form, output).call([x[n - N_CONSTANTS :], weak])
        return list(zip(dynamics, prior, strict=True))

    along = ca.mtimes(Q, z)
    quadratic = ca.dot(z, q + 0.5 * along)
    (of_factors, of_prior), *_ = terms("cost")
    cost = quadratic + ca.sum2(of_factors) + of_prior
    (of_factors, of_prior), (g_factors, g_prior) = terms("gradient")
    where = np.concatenate([slots.ravel(), np.arange(n - N_CONSTANTS, n)])
    slope = scatter(where, n) @ ca.vertcat(ca.vec(g_factors), g_prior)
    gradient = q + along + size * slope
    _, _, (h_factors, h_prior) = terms("quadratic")
    rows, cols = layout.upper
    all_slots = [slots, np.arange(n - N_CONSTANTS, n)[None]]
    where = np.concatenate([_upper_cells(each) for each in all_slots])
    curvature = scatter(where, len(rows)) @ ca.vertcat(ca.vec(h_factors), h_prior)
    scale = size[rows.tolist()] * size[cols.tolist()]
    values = ca.vec(Q)[(rows + n * cols).tolist()] + scale * curvature
    p = ca.vertcat(start, size, q, ca.vec(Q), ca.vec(factors), weak)
    symbols = ca.MX.sym("p", p.numel())
    parts = ca.vertsplit(symbols, np.cumsum([0, n, n, n, n * n, N_FACTOR * len(slots), N_PRIOR]).tolist())
    parts[3], parts[4] = ca.reshape(parts[3], n, n), ca.reshape(parts[4], N_FACTOR, len(slots))
    old = [start, size, q, Q, factors, weak]
    cost, gradient, values = ca.graph_substitute([cost, gradient, values], old, parts)
    options = ipopt_options(TOLERANCE, STATIONARY_COST_CHANGE, MAX_ITERATIONS)
    return ipopt_solver("window", z, symbols, cost, gradient, (ca.Sparsity.upper(n), values), options)


def _parameters(problem: WindowProblem, x: Array, at: Ints, size: Array, n_frames: int) -> Array:
    n, n_factors = len(size), n_frames - 1
    start, q, Q = np.zeros(n), np.zeros(n), np.eye(n)
    start[at] = x
    q[at] = problem.vision.gradient(x)
    Q[np.ix_(at, at)] = problem.vision.H
    factors = np.zeros((n_factors, N_FACTOR))
    # steps between states that do not exist yet: no rotation in 1 s, no weight
    identity = np.eye(3).ravel()
    factors[:, PLAIN.R_BEFORE] = factors[:, PLAIN.R_AFTER] = identity
    factors[:, PLAIN.Q_BETWEEN] = 1.0, 0.0, 0.0, 0.0
    factors[:, PLAIN.DT] = 1.0
    factors[:, PLAIN.R_INERTIA] = problem.weak_prior[4:13]
    steps, R, m = problem.factors.steps, problem.R_ref, len(problem.factors)
    by_columns = np.swapaxes(R, 1, 2).reshape(-1, 9)
    factors[:m, PLAIN.R_BEFORE], factors[:m, PLAIN.R_AFTER] = by_columns[:-1], by_columns[1:]
    factors[:m, PLAIN.Q_BETWEEN] = wxyz_from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    factors[:m, PLAIN.DT] = steps.dt_s
    factors[:m, PLAIN.W_T] = steps.W_t[:, [0, 1, 1], [0, 0, 1]]
    factors[:m, PLAIN.W_R] = np.swapaxes(steps.W_r, 1, 2).reshape(-1, 36)
    scaled = (size[:, None] * Q * size).ravel()
    return np.concatenate([start, size, size * q, scaled, factors.ravel(), problem.weak_prior])


def _upper_cells(slots: Ints) -> Ints:
    """Cells of the upper triangle, counted by columns, that the blocks on each row of slots touch."""
    cols, rows = np.tril_indices(slots.shape[1])
    first, second = slots[:, rows], slots[:, cols]
    return np.asarray(second * (second + 1) // 2 + first).ravel()
