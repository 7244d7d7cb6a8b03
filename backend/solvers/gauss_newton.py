"""Gauss-Newton with Levenberg damping, landmarks eliminated: reference solver and source of covariances."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.kernels import prior_kernel
from polhode.backend.dynamics.residuals import FrameStates, add_steps, dynamics_jacobians, dynamics_residuals
from polhode.backend.problem.inertia import N_INERTIA, InertiaForm, inertia_derivative
from polhode.backend.problem.iterate import (
    N_CAMERA,
    N_CONSTANTS,
    N_POSE,
    N_STATE,
    POSE,
    POSITION,
    ROTATION,
    Iterate,
)
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import LN_MASS, LN_PRIOR, LN_SCALE, wrench_residual
from polhode.backend.solvers.chain import eliminate_chain, solve_with_chain
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.robust_kernel import kernel_curvature, robust_cost, robust_weight
from polhode.backend.solvers.schur import (
    back_substitute,
    stereo_normal_equations,
    stereo_residuals,
    subtract_landmarks,
)
from polhode.geometry.lie import Array, right_jacobian_so3
from polhode.records.estimate import ProgramEnd

ITERATION_LIMIT = "limit of iterations (backend.max_iterations)"
TIME_LIMIT = "limit of time (backend.max_seconds)"
TOLERANCE = 1e-8
"""Relative decrease of the cost that ends the iterations."""
STALL_TOLERANCE, STALL_ITERATIONS = 1e-6, 8
"""This number of successive iterations with a smaller relative decrease ends them too: they follow a valley
of a quantity that the data do not determine."""
STEP_FRACTIONS, MIN_DECREASE_SHARE = (0.5, 0.25, 0.125, 0.0625), 0.1
"""Fractions of a step that are tried, and the share of the decrease predicted by the slope that is
required."""
MIN_DAMPING, MAX_DAMPING = 1e-8, 1e8
"""Of all unknowns, in units of the Hessian's diagonal."""
CONSTANT_SCALE = np.repeat([0.01, 0.1], [3, N_INERTIA])
"""Scales of com_G [m] and xi."""


@dataclass(frozen=True)
class Damping:
    """Damping of a step, of all unknowns or of the constants alone; either grows when a step is rejected.

    Given the constants, the states are stiff but almost linear: near the solution only the constants need
    damping, and the states follow them freely. Far from the solution any unknown may overshoot.
    """

    of_all: float = MIN_DAMPING
    """In units of the Hessian's diagonal (Marquardt)."""
    of_constants: float = 0.0
    """In units of ``CONSTANT_SCALE``."""

    def more(self, times: int) -> "list[Damping]":
        """Dampings to try after a number of rejections; empty if steps cannot be made shorter."""
        of_constants = max(self.of_constants, 1e-3) * 100.0**times
        of_all = max(self.of_all, 1e-6) * 4.0**times * 2.0 ** (times * (times - 1) // 2)
        more = [Damping(of_constants=of_constants)] if of_constants < 1e5 else []
        return more + ([Damping(of_all=of_all)] if of_all < MAX_DAMPING else [])

    def less(self) -> "Damping":
        """The damping with which the next iteration begins."""
        of_constants = 0.01 * self.of_constants
        return Damping(max(MIN_DAMPING, 0.1 * self.of_all), of_constants if of_constants > 0.01 else 0.0)


@dataclass(frozen=True)
class Solution:
    """The result of a solver, the same for all solvers."""

    x: Array
    """vector of the unknowns about the fixed reference"""
    cost: float
    iterations: int
    converged: bool
    message: str
    program: ProgramEnd | None = None
    """IPOPT's own figures, if it was IPOPT"""


@dataclass
class NormalEquations:
    """Gauss-Newton system at a point: dense part (states and constants), landmarks, coupling."""

    H: Array
    """(n, n) lower triangle valid, landmarks not yet eliminated"""
    g: Array
    """(n,) gradient"""
    C: Array
    """(L, 3, 3)"""
    h: Array
    """(L, 3) gradient of the landmarks"""
    E: Array
    """(M, 6, 3)"""
    cost: float
    n_state: int = N_STATE
    """unknowns of a frame in H and g"""


class WeakPrior:
    """The weak prior on com_G and xi (``kernels.prior_residual``), whose kernel is built once."""

    def __init__(self, form: InertiaForm) -> None:
        self.form = form
        self._kernel: Any = prior_kernel(form)
        self._known: tuple[bytes, tuple[float, Array, Array]] | None = None

    def __call__(self, constants: Array, parameters: Array) -> tuple[float, Array, Array]:
        """Cost, gradient (8,) and Hessian (8, 8) at com_G, xi (8,)."""
        # it is evaluated repeatedly at the same point
        at = constants.tobytes() + parameters.tobytes()
        if self._known is None or self._known[0] != at:
            cost, gradient, upper = self._kernel(constants, parameters)
            cols, rows = np.tril_indices(N_CONSTANTS)
            block = np.zeros((N_CONSTANTS, N_CONSTANTS))
            block[rows, cols] = block[cols, rows] = np.asarray(upper).ravel()
            self._known = at, (float(cost), np.asarray(gradient).ravel(), block)
        return self._known[1]


class GaussNewton:
    """Solver of the weighted problem that ``ipopt.MotionProgram`` states; kernels are built once."""

    name = "gauss_newton"

    def __init__(self, data: MotionData, with_dynamics: bool = True, line_search: bool = False) -> None:
        """line_search: a step that overshoots is shortened before damping is tried.

        Damping turns a step away from the valley along which the constants must move: from a cold start, a
        line search needs half to a sixth of the iterations. The brief solves of ``multistart`` use damping
        only.
        """
        self.data = data
        self.with_dynamics = with_dynamics
        self.line_search = line_search
        self._prior: Callable[[Array, Array], tuple[float, Array, Array]] = WeakPrior(data.form)

    def solve(
        self, fixed: LinearizationPoint, x: Array, max_iterations: int, max_seconds: float = np.inf
    ) -> Solution:
        """Minimize from x; each iteration takes one damped step.

        Raises LinAlgError where no damping makes the normal equations positive definite.
        """
        begin = perf_counter()
        damping = Damping()
        system = self.normal_equations(fixed, x)
        converged, iteration, stalled = False, 0, 0
        for iteration in range(1, max_iterations + 1):
            try:
                found = self._descend(fixed, x, system, damping)
            except LinAlgError:
                # without the curvature of the kernel, which far from a solution can outweigh all else
                squares = np.sum(self.residuals(fixed, x)[0] ** 2, axis=1)
                system = self.normal_equations(fixed, x, robust_weight(squares, self.data.robust_scale))
                found = self._descend(fixed, x, system, damping)
            if found is None:
                return Solution(x, system.cost, iteration, True, "no further decrease")
            x, cost, damping = found
            decrease = system.cost - cost
            stalled = stalled + 1 if decrease <= STALL_TOLERANCE * cost else 0
            if decrease <= TOLERANCE * max(cost, 1.0) or stalled >= STALL_ITERATIONS:
                converged = True
                break
            damping = damping.less()
            if perf_counter() - begin > max_seconds:
                return Solution(x, float(cost), iteration, False, TIME_LIMIT)
            if iteration < max_iterations:
                system = self.normal_equations(fixed, x)
        return Solution(x, float(cost), iteration, converged, "converged" if converged else ITERATION_LIMIT)

    def _descend(
        self, fixed: LinearizationPoint, x: Array, system: NormalEquations, damping: Damping
    ) -> tuple[Array, float, Damping] | None:
        """A point of no higher cost, that cost and the damping that led there; None if there is none."""
        trials, rejected = [damping], 0
        while trials:
            best, least = None, system.cost * (1.0 + 1e-13)
            for trial in trials:
                step = self.step(system, trial)
                candidate, cost = x + step, self._cost_or_nan(fixed, x + step)
                if self.line_search and rejected == 0 and not cost <= least:
                    candidate, cost = self._search_along(fixed, x, system, step)
                if np.isfinite(cost) and cost <= least:
                    best, least = (candidate, float(cost), trial), cost
            if best is not None:
                return best
            rejected += 1
            trials = damping.more(rejected)
            if fixed.reference.wrench is not None:
                # with the unknowns of a wrench the valley is curved too: only damping of all unknowns follows
                # it
                trials = [trial for trial in trials if trial.of_constants == 0.0]
        return None

    def _search_along(
        self, fixed: LinearizationPoint, x: Array, system: NormalEquations, step: Array
    ) -> tuple[Array, float]:
        """The longest fraction of a step with a sufficient decrease (Armijo); infinite cost if none has."""
        slope = float(system.g @ step[: len(system.g)] + system.h.ravel() @ step[len(system.g) :])
        for length in STEP_FRACTIONS:
            cost = self._cost_or_nan(fixed, x + length * step)
            if cost <= system.cost + MIN_DECREASE_SHARE * length * slope:
                return x + length * step, cost
        return x, np.inf

    def _cost_or_nan(self, fixed: LinearizationPoint, x: Array) -> float:
        """The objective; infinite or NaN where a very long step overflows, and so rejected."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.cost(fixed, x)

    def cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """The objective."""
        squares = np.sum(self.residuals(fixed, x)[0] ** 2, axis=1)
        return self.with_other_costs(robust_cost(squares, self.data.robust_scale), fixed, x)

    def with_other_costs(self, of_vision: float, fixed: LinearizationPoint, x: Array) -> float:
        """The objective, given the contribution of the stereo measurements."""
        n = fixed.reference.n_states
        total = of_vision + self.dynamics_cost(fixed, x)
        total += self._prior(x[n : n + N_CONSTANTS], fixed.prior)[0]
        total += self.camera_cost(fixed, x) + 0.5 * float(np.sum(self._wrench(fixed, x)[0] ** 2))
        return total + 0.5 * float(np.sum(fixed.gauge_information * self._gauge_offset(fixed, x) ** 2))

    def dynamics_cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """Contribution of the dynamics to the objective."""
        if not self.with_dynamics:
            return 0.0
        states, at = self.states(fixed, x)
        residuals = dynamics_residuals(states, fixed.steps, at.J_G(self.data.form))
        return 0.5 * float(np.sum(residuals**2))

    def camera_cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """Contribution of the errors of the camera's pose to the objective."""
        return 0.5 * float(np.sum(fixed.camera_information * camera_errors(fixed, x) ** 2))

    def prior_information(self, fixed: LinearizationPoint, x: Array) -> Array:
        """Gauss-Newton Hessian (8, 8) of the weak prior on com_G and xi; (19, 19) with a known wrench."""
        n, c = fixed.reference.n_states, fixed.reference.n_constants
        block, body = np.zeros((c, c)), slice(n, n + N_CONSTANTS)
        block[:N_CONSTANTS, :N_CONSTANTS] = self._prior(x[body], fixed.prior)[2]
        logs = np.array([LN_SCALE, LN_MASS]) + N_CONSTANTS if c > N_CONSTANTS else np.zeros(0, dtype=int)
        block[logs, logs] = LN_PRIOR**-2
        return block

    def residuals(self, fixed: LinearizationPoint, x: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Whitened stereo residuals (M, 3), and A (F, 3, 3), p_NG (F, 3), p_G (L, 3) at x."""
        d = self.data
        at = fixed.reference.moved_to(x)
        A = d.R_RN @ at.R_NG
        p_NG, p_G = np.ascontiguousarray(at.p_NG), np.ascontiguousarray(at.p_G)
        r = stereo_residuals(d.frame, d.landmark, d.uvd_px, d.inv_sigma, d.rig, A, d.R_RN, d.t_R, p_NG, p_G)
        return r, (A, p_NG, p_G)

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """Linearize at x; robust weights unless given (M,). ``prior=False`` omits prior and gauge."""
        d, s, n_states = self.data, fixed.reference.n_state, fixed.reference.n_states
        r, (A, p_NG, p_G) = self.residuals(fixed, x)
        squares = np.sum(r**2, axis=1)
        # the curvature of the kernel speeds up convergence; given weights have none
        w = robust_weight(squares, d.robust_scale) if weight is None else weight
        curvature = kernel_curvature(squares, d.robust_scale) if weight is None else np.zeros_like(squares)
        theta = x[:n_states].reshape(-1, s)[:, ROTATION]
        point = (A, d.R_RN, d.t_R, p_NG, p_G, right_jacobian_so3(theta), r, w, curvature)
        H6, g6, C, h, E = stereo_normal_equations(d.frame, d.landmark, d.inv_sigma, d.rig, *point)
        n = fixed.reference.n_dense
        H, g, total = np.zeros((n, n)), np.zeros(n), robust_cost(squares, d.robust_scale)
        for k in range(d.n_frames):
            H[s * k : s * k + 6, s * k : s * k + 6] += H6[k]
            g[s * k : s * k + 6] += g6[k]
        total = self.add_other_terms(total, fixed, x, H, g, prior)
        return NormalEquations(H, g, C, h, E, total, s)

    def add_other_terms(
        self, of_vision: float, fixed: LinearizationPoint, x: Array, H: Array, g: Array, prior: bool = True
    ) -> float:
        """Add all terms but the stereo measurements' to H (n, n) and g (n,); the objective, given theirs."""
        n, form, of_dynamics = fixed.reference.n_states, self.data.form, 0.0
        if self.with_dynamics:
            states, at = self.states(fixed, x)
            dJ = inertia_derivative(form, at.xi, at.R_inertia)
            residual, jacobian = dynamics_jacobians(states, fixed.steps, at.J_G(form), dJ)
            add_steps(H, g, residual, jacobian, at.n_state)
            of_dynamics = 0.5 * float(np.sum(residual**2))
        total = of_vision + of_dynamics
        error = camera_errors(fixed, x)
        if len(error):
            slots = np.arange(len(error))[:, None] * fixed.reference.n_state + N_STATE + np.arange(N_CAMERA)
            H[slots, slots] += fixed.camera_information
            g[slots] += fixed.camera_information * error
        total += self.camera_cost(fixed, x)
        residual, jacobian = self._wrench(fixed, x)
        if not prior:
            # the logarithms come last
            residual, jacobian = residual[:-2], jacobian[:-2]
        known = slice(n + 3, n + 3 + jacobian.shape[1])
        H[known, known] += jacobian.T @ jacobian
        g[known] += jacobian.T @ residual
        total += 0.5 * float(np.sum(residual**2))
        if prior:
            body, pose = slice(n, n + N_CONSTANTS), np.arange(N_POSE)
            cost, gradient, hessian = self._prior(x[body], fixed.prior)
            H[body, body] += hessian
            g[body] += gradient
            offset = self._gauge_offset(fixed, x)
            H[pose, pose] += fixed.gauge_information
            g[POSE] += fixed.gauge_information * offset
            total += cost + 0.5 * float(np.sum(fixed.gauge_information * offset**2))
        untouched = np.diagonal(H) == 0.0
        H[untouched, untouched] = 1.0
        return total

    def reduced(self, system: NormalEquations, damping: float = 0.0) -> tuple[Array, Array, Array]:
        """Eliminate the landmarks: S (n, n) lower, gradient (n,), C^-1 (L, 3, 3)."""
        C_inv = self._inverse_landmarks(system, damping)
        S, g = system.H.copy(), system.g.copy()
        S[np.diag_indices_from(S)] *= 1.0 + damping
        subtract_landmarks(S, g, self.data.frame, self.data.start, system.E, C_inv, system.h, system.n_state)
        return S, g, C_inv

    @staticmethod
    def _inverse_landmarks(system: NormalEquations, damping: float) -> Array:
        C = system.C + (damping + 1e-12) * np.eye(3) * np.trace(system.C, axis1=1, axis2=2)[:, None, None]
        return np.asarray(np.linalg.inv(C))

    def step(self, system: NormalEquations, damped: Damping) -> Array:
        """The damped step of all unknowns.

        Raises LinAlgError where no damping makes the system positive definite: where an element of the
        diagonal is negative.
        """
        d, damping = self.data, damped.of_all
        while True:
            try:
                C_inv = self._inverse_landmarks(system, damping)
                chain = eliminate_chain(system.H, system.g, d.n_frames, system.n_state, damping)
                S, g = chain.dense, chain.dense_gradient
                at = N_POSE * d.n_frames + np.arange(N_CONSTANTS)
                S[at, at] += damped.of_constants / CONSTANT_SCALE**2
                subtract_landmarks(S, g, d.frame, d.start, system.E, C_inv, system.h, N_POSE)
                step, _ = solve_with_chain(chain, system.n_state)
                break
            except LinAlgError:
                damping = max(damping, 1e-8) * 10.0
                if damping > MAX_DAMPING:
                    raise
        marks = back_substitute(step, d.frame, d.start, system.E, C_inv, -system.h, system.n_state)
        return np.concatenate([step, marks.ravel()])

    def states(self, fixed: LinearizationPoint, x: Array) -> tuple[FrameStates, Iterate]:
        """The states, and the iterate, at x."""
        at = fixed.reference.moved_to(x)
        of_frames = x[: at.n_states].reshape(-1, at.n_state)
        return FrameStates(of_frames, at.R_NG, self.data.camera_N, at.com_G, at.wrench, at.R_torque), at

    def _wrench(self, fixed: LinearizationPoint, x: Array) -> tuple[Array, Array]:
        at, form = fixed.reference.moved_to(x), self.data.form
        if at.wrench is None or at.R_torque is None:
            return np.zeros(0), np.zeros((0, N_INERTIA))
        dJ = inertia_derivative(form, at.xi, at.R_inertia)
        return wrench_residual(at.J_G(form), dJ, at.wrench, at.R_torque, fixed.bias_sigma)

    @staticmethod
    def _gauge_offset(fixed: LinearizationPoint, x: Array) -> Array:
        return np.concatenate([x[POSITION] - fixed.reference.p_NG[0], x[ROTATION]])


def camera_errors(fixed: LinearizationPoint, x: Array) -> Array:
    """Errors (F, 6) of the camera's stated poses in the unknowns x; (0, 6) if the poses are exact."""
    s = fixed.reference.n_state
    if s == N_STATE:
        return np.zeros((0, N_CAMERA))
    return np.asarray(x[: fixed.reference.n_states].reshape(-1, s)[:, N_STATE:])
