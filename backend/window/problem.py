"""The nonlinear program of one update of the window, its parts, Gauss-Newton and IPOPT on it.

The observations, with landmarks and key poses eliminated, and the arrival cost are a quadratic; the dynamics
between consecutive states are whitened residuals (``dynamics.residuals``).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, solve_triangular

from polhode.backend.dynamics.kernels import N_PRIOR, PLAIN, Output, dynamics_kernel, prior_kernel
from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.dynamics.residuals import (
    FrameStates,
    Steps,
    add_steps,
    dynamics_jacobians,
    dynamics_residuals,
)
from polhode.backend.dynamics.so3_exp import rotation_matrices
from polhode.backend.problem.inertia import InertiaForm, inertia_derivative, inertia_from_second_moments
from polhode.backend.problem.iterate import COM, N_CONSTANTS, N_STATE, ROTATION
from polhode.backend.solvers.casadi_nlp import OPTIMAL, gather, ipopt_options, ipopt_solver, scatter
from polhode.backend.solvers.gauss_newton import CONSTANT_SCALE, Solution, WeakPrior
from polhode.geometry.lie import Array, Ints, wxyz_from_matrix
from polhode.runtime.compiled import compiled

NEGLIGIBLE_COST = 1e-3
"""Negligible difference of the cost, which is half a squared number of standard deviations."""
DAMPINGS = (0.0, 1e-1, 1e1, 1e3, 1e5)
"""Damping of the constants, in units of ``CONSTANT_SCALE``."""


@dataclass(frozen=True)
class Quadratic:
    """The cost 1/2 (x - x0)^T H (x - x0) + g^T (x - x0)."""

    H: Array
    """(n, n) symmetric"""
    g: Array
    """(n,) gradient at x0"""
    x0: Array
    """(n,)"""

    def gradient(self, x: Array) -> Array:
        """Gradient (n,) at x."""
        return np.asarray(self.g + self.H @ (x - self.x0))

    def value(self, x: Array) -> float:
        """Cost at x, without the constant."""
        d = x - self.x0
        return float(d @ (self.g + 0.5 * (self.H @ d)))


@dataclass(frozen=True)
class Elimination:
    """Information on the ``kept`` entries, the ``gone`` ones minimized over: the marginal of a Gaussian."""

    H: Array
    """(k, k)"""
    g: Array
    """(k,)"""
    factor: Array
    """(n - k, n - k) lower L with L L^T = H[gone, gone]"""
    across: Array
    """(n - k, k + 1) of L^-1 [H[gone, kept], g[gone]]"""

    def follow(self, step: Array) -> Array:
        """Step of the eliminated entries (n - k,) that follows from that of the kept ones (k,)."""
        if len(self.factor) == 0:
            return np.zeros(0)
        right = self.across[:, :-1] @ step + self.across[:, -1]
        return np.asarray(-solve_triangular(self.factor, right, lower=True, trans=1, check_finite=False))

    def whole_step(self, step: Array) -> Array:
        """The step (n,) of the eliminated entries, then of the kept ones (k,)."""
        return np.concatenate([self.follow(step), step])


def eliminate(H: Array, g: Array, gone: Ints, kept: Ints) -> Elimination:
    """Eliminate entries of a quadratic about 0. H[gone, gone] must be positive definite."""
    left, force = block_of(H, kept, kept), g[kept]
    if len(gone) == 0:
        return Elimination(left, force, np.zeros((0, 0)), np.zeros((0, len(kept) + 1)))
    factor = cholesky(block_of(H, gone, gone), lower=True, check_finite=False)
    both = np.empty((len(gone), len(kept) + 1))
    both[:, :-1], both[:, -1] = block_of(H, gone, kept), g[gone]
    across = solve_triangular(factor, both, lower=True, check_finite=False)
    from_kept, from_force = np.ascontiguousarray(across[:, :-1]), across[:, -1]
    left -= from_kept.T @ from_kept
    return Elimination(left, force - from_kept.T @ from_force, factor, across)


@compiled
def add_block(H: Array, entries: Ints, block: Array) -> None:
    """H[entries, entries] += block (n, n), in place."""
    n = len(entries)
    for a in range(n):
        row = entries[a]
        for b in range(n):
            H[row, entries[b]] += block[a, b]


@compiled
def block_of(H: Array, rows: Ints, columns: Ints) -> Array:
    """H[rows, columns] (n, m)."""
    out = np.empty((len(rows), len(columns)))
    for a in range(len(rows)):
        row = rows[a]
        for b in range(len(columns)):
            out[a, b] = H[row, columns[b]]
    return out


def others(entries: Ints, size: int) -> Ints:
    """The indices below ``size`` that are not among the entries."""
    rest = np.ones(size, bool)
    rest[entries] = False
    return np.flatnonzero(rest)


class DisturbanceLevels(NamedTuple):
    """Power spectral densities of the disturbing acceleration and torque."""

    accel_psd: float
    torque_psd: float


def whitened_steps(
    w_G: Array,
    J_G: Array,
    J_noise: Array,
    dt_s: Array,
    noise: DisturbanceLevels,
    doubts: Array | None = None,
) -> Steps:
    """n steps with the rates (n, 3) at their starts; the disturbing torque acts on J_noise (3, 3).

    doubts (n, 4): ``Frame.doubts`` and the speed [m/s]; None: none.
    """
    if len(dt_s) == 0:
        return Steps.none()
    series = series_steps(w_G, J_G, dt_s, noise.torque_psd)
    if doubts is None or not doubts[:, :3].any():
        W_t, W_r, half_log = whitening(w_G, J_noise, dt_s, noise.accel_psd, noise.torque_psd)
        return Steps(dt_s, series, W_t, W_r, half_log)
    # white noise of the same variance over the step stands for a push at an unknown time within it
    accel_psd, torque_psd = np.array(noise)[:, None] + doubts[:, 1:3].T ** 2 / dt_s
    _, w_end, _, _ = propagate_rotations(w_G, J_G, dt_s, series)
    slowing = -np.linalg.solve(J_G, np.cross(w_end, w_end @ J_G).T).T
    later = (doubts[:, 0] * doubts[:, 3]) ** 2, doubts[:, :1] * np.hstack([w_end, slowing])
    return Steps(dt_s, series, *whitening(w_G, J_noise, dt_s, accel_psd, torque_psd, later))


def states_of_vector(x: Array, R_ref: Array) -> FrameStates:
    """The states of F frames in x (12 F + 8,), whose theta rotates R_ref (F, 3, 3)."""
    of_frames = x[:-N_CONSTANTS].reshape(-1, N_STATE)
    R_NG = R_ref @ rotation_matrices(of_frames[:, ROTATION])
    return FrameStates(of_frames, R_NG, np.zeros((len(R_ref), 3)), x[-N_CONSTANTS:][COM])


def step_jacobians(
    x: Array, R_ref: Array, steps: Steps, form: InertiaForm, R_inertia: Array
) -> tuple[Array, Array]:
    """Whitened residuals (n, 12) of the steps between n + 1 states, x (12 (n + 1) + 8,) around R_ref.

    And their Jacobians (n, 12, 32) in state before, state after, com_G, xi.
    """
    J_G = inertia_from_second_moments(form.second_moments(x[-5:], R_inertia))
    dJ = inertia_derivative(form, x[-5:], R_inertia)
    return dynamics_jacobians(states_of_vector(x, R_ref), steps, J_G, dJ)


@dataclass(frozen=True)
class WindowProblem:
    r"""States of W consecutive frames and the constants (``Iterate`` has their meaning), 12 W + 8 numbers x.

    minimise over x, without constraints::

        1/2 (x - x0)^T Q (x - x0) + q^T (x - x0)                 vision, landmarks and key poses eliminated,
                                                                 and the arrival cost
      + 1/2 sum_k || W_k [ r_k+1 - r_k - dt v_k; v_k+1 - v_k;    dynamics, as ``ipopt.MotionProgram``
                           Log(dR_k^T R_k^T R_k+1); w_k+1 - w'_k ] ||^2
      + 1/2 || (com - middle) / s ||^2 + 1/2 || 3 Sigma(xi) / tr Sigma(xi) - I ||^2      weak prior
    """

    vision: Quadratic
    R_ref: Array
    """(W, 3, 3) reference attitudes, which the theta of the states rotate"""
    steps: Steps
    weak_prior: Array
    """(13,) parameters of ``kernels.prior_kernel``"""
    prior: WeakPrior

    @property
    def n_frames(self) -> int:
        return len(self.R_ref)

    @property
    def R_inertia(self) -> Array:
        """(3, 3) reference rotation of the inertia's form."""
        return self.weak_prior[4:13].reshape(3, 3).T

    def jacobians(self, x: Array) -> tuple[Array, Array]:
        """Of the steps, see ``step_jacobians``."""
        return step_jacobians(x, self.R_ref, self.steps, self.prior.form, self.R_inertia)

    def cost(self, x: Array) -> float:
        """The objective."""
        # a very long step may overflow: it is rejected like any other
        with np.errstate(over="ignore", invalid="ignore"):
            try:
                second = self.prior.form.second_moments(x[-5:], self.R_inertia)
                states = states_of_vector(x, self.R_ref)
                r = dynamics_residuals(states, self.steps, inertia_from_second_moments(second))
            except ValueError:
                return np.inf
            weak, _, _ = self.prior(x[-N_CONSTANTS:], self.weak_prior)
            return self.vision.value(x) + 0.5 * float(np.sum(r**2)) + weak

    def normal_equations(self, x: Array) -> tuple[float, Array, Array]:
        """The objective, its Gauss-Newton Hessian (n, n) and its gradient (n,)."""
        cost, H, g = self.vision.value(x), self.vision.H.copy(), self.vision.gradient(x)
        if len(self.steps.dt_s):
            r, D = self.jacobians(x)
            add_steps(H, g, r, D, N_STATE)
            cost += 0.5 * float(np.sum(r**2))
        weak, gradient, hessian = self.prior(x[-N_CONSTANTS:], self.weak_prior)
        H[-N_CONSTANTS:, -N_CONSTANTS:] += hessian
        g[-N_CONSTANTS:] += gradient
        return cost + weak, H, g


def solve_newton(problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
    """Gauss-Newton from x (12 W + 8,), until the cost after a step agrees with its quadratic model.

    Given the constants the states are almost linear, and stiff at high frame rates: only the constants are
    damped, the states follow them freely. If that is not enough the step is shortened.
    """
    level, iteration = 0, 0
    cost, H, g = problem.normal_equations(x)
    candidate = cost

    def descending() -> Array | None:
        """A step after which the cost is no higher; sets that cost, and the level of damping."""
        nonlocal candidate, level
        step = None
        for tried in range(level, len(DAMPINGS)):
            damped = H
            if DAMPINGS[tried] > 0.0:
                damped = H.copy()
                np.einsum("ii->i", damped)[-N_CONSTANTS:] += DAMPINGS[tried] / CONSTANT_SCALE**2
            try:
                factor = cho_factor(damped, lower=True, check_finite=False)
            except LinAlgError:
                step = None
                continue
            step = np.asarray(-cho_solve(factor, g, check_finite=False))
            if (candidate := problem.cost(x + step)) <= cost + NEGLIGIBLE_COST:
                level = tried
                return step
        share = 0.5
        while step is not None and share > 1e-3:
            if (candidate := problem.cost(x + share * step)) <= cost + NEGLIGIBLE_COST:
                level = len(DAMPINGS) - 1
                return share * step
            share *= 0.5
        return None

    for iteration in range(1, max_iterations + 1):
        step = descending()
        if step is None:
            return Solution(x, cost, iteration, False, "no further decrease")
        expected = cost + float(g @ step + 0.5 * step @ (H @ step))
        x, exact = x + step, level == 0 and abs(candidate - expected) < NEGLIGIBLE_COST
        if exact:
            return Solution(x, candidate, iteration, True, "converged")
        level = max(level - 1, 0)
        if iteration < max_iterations:
            cost, H, g = problem.normal_equations(x)
    return Solution(x, candidate, iteration, False, "iteration limit")


TOLERANCE = 1e-3
"""Largest gradient at the optimum: a thousandth of a standard deviation."""
STATIONARY_COST_CHANGE = 1e-4
"""Negligible change of the cost; the iterations end after three of them in a row."""
MAX_ITERATIONS = 40
MOST_SERIES = 8
"""In a step: the time of an iteration grows with them, to seconds of all at 64, as of a wrong rate."""


class IpoptSolver:
    """Solver of ``WindowProblem``, with a program for each number of series that steps have needed."""

    name = "ipopt"

    def __init__(self, n_frames: int) -> None:
        """n_frames: the largest number of states of a problem."""
        self.n_frames, self.size = n_frames, N_STATE * n_frames + N_CONSTANTS
        self._programs = dict[int, Any]()

    def solve(self, problem: WindowProblem, x: Array) -> Solution:
        """Minimize from x (12 W + 8,); not where steps need so many series that the next pairs would wait."""
        series = int(problem.steps.series.max(initial=1))
        if series > MOST_SERIES:
            return Solution(x, problem.cost(x), 0, False, f"{series} series in a step")
        if series not in self._programs:
            self._programs[series] = self._build(problem.prior.form, series)
        program = self._programs[series]
        states, constants = np.arange(N_STATE * problem.n_frames), np.arange(self.size)[-N_CONSTANTS:]
        at = np.concatenate([states, constants])
        before, H, _ = problem.normal_equations(x)
        size = np.ones(self.size)
        # the scale is limited for weakly determined unknowns: 1 m, 1 rad and ratios of 1 are large enough
        size[at] = 1.0 / np.sqrt(np.maximum(np.diagonal(H), 1.0))
        result = program(x0=0.0, p=self._parameters(problem, x, at, size))
        stats = program.stats()
        status = str(stats["return_status"])
        found = x + (size * np.asarray(result["x"]).ravel())[at]
        # evaluated by the reference implementation: a step that diverges is not taken
        cost = problem.cost(found) if np.isfinite(found).all() else np.inf
        if not cost <= before + STATIONARY_COST_CHANGE:
            return Solution(x, before, int(stats["iter_count"]), False, f"no decrease: {status}")
        return Solution(found, cost, int(stats["iter_count"]), status in OPTIMAL, status)

    def _build(self, form: InertiaForm, series: int) -> Any:
        """Unknowns z (n), x = start + size z. Parameters: start, size, q (n each), Q (n, n), steps, prior."""
        n = self.size
        # entries that each step between states reads (W - 1, 32), and the constants (1, 8)
        states = N_STATE * np.arange(self.n_frames - 1)[:, None] + np.arange(2 * N_STATE)
        constants = np.arange(n - N_CONSTANTS, n)[None]
        slots = np.hstack([states, np.repeat(constants, len(states), axis=0)])
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
        # cells of the upper triangle, counted by columns
        cells = []
        for each in (slots, constants):
            second, first = (each[:, index] for index in np.tril_indices(each.shape[1]))
            cells.append((second * (second + 1) // 2 + first).ravel())
        where = np.concatenate(cells)
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
