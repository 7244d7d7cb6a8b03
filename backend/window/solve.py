"""The solves of one frame's update: of the whole history while it is kept, of the window alone afterwards.

Gauss-Newton leads to the optimum, and IPOPT continues with the recent states and the constants, by default.
While the history is kept, brief solves from several inertias decide whether another one fits better.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.residuals import add_steps
from polhode.backend.initialization.multistart import inertia_hypotheses
from polhode.backend.initialization.rates import interpolated_rates, interval_rates
from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.backend.problem.iterate import N_CONSTANTS, N_POSE, N_STATE, RATE, ROTATION
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.active import add_parts
from polhode.backend.window.causal_state import last_information
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.history import History, HistoryVision
from polhode.backend.window.problem import (
    NEGLIGIBLE,
    Elimination,
    NewtonSolver,
    Quadratic,
    WindowProblem,
    WindowSolver,
    eliminate,
    factor_jacobians,
)
from polhode.backend.window.vision import GATE, CondensedVision
from polhode.lie import Array

INNER_ITERATIONS = 10
MAX_ROUNDS = 8
"""Largest number of linearizations of the observations."""
LONG_HISTORY = 32
"""Number of frames of the history beyond which the iterations per frame are limited; the next frame
continues."""
LONG_ITERATIONS = 4
"""Total iterations for such a history: in the flat valley of an unknown inertia they would not converge."""
SMALL_TURN_RAD = 2e-3
"""Step of the attitudes below which the observations need not be linearized again."""
PASSES = (3, 3, 3, 2)
"""Iterations of the solves of one hypothesis; the whitening is renewed between them."""
SAME_INERTIA = 0.03
"""Two inertias (second moments of determinant 1) closer than this will end in the same minimum."""
CLEARLY_BETTER = 1.0
"""Decrease of the cost that another inertia must achieve; a smaller one is not significant."""


@dataclass(frozen=True)
class InertiaCandidate:
    """The solution from one guess; its cost includes the normalization of the process noise."""

    x: Array
    second: Array
    cost: float


def solve_history(state: EstimatorState, history: History, answer: WindowSolver | None = None) -> bool:
    """Solve for all states so far, with the active observations linearized at the solution.

    Gauss-Newton leads to the optimum; ``answer``, if given, continues with the recent states and the
    constants (``answer_of_recent``). Returns whether its optimum is the one that was taken.
    """
    observations, active = state.observations(), state.active
    left = LONG_ITERATIONS if len(history.frames) > LONG_HISTORY else MAX_ROUNDS * INNER_ITERATIONS
    is_answered = False
    for rounds_left in reversed(range(MAX_ROUNDS)):
        state.recenter_inertia()
        condensed = state.condensed(observations)
        x = history.vector(active.constants)
        factors = history.factors(x, state.J_G, state.J_noise, state.disturbances)
        vision = history.vision(active, condensed)
        problem = WindowProblem(vision.quadratic, history.R_ref, factors, state.weak_prior, state.prior)
        solution = NewtonSolver().solve(problem, x, min(left, INNER_ITERATIONS))
        left -= solution.iterations
        is_last = rounds_left == 0 or left <= 0 or _small(vision.seen_steps(solution.x - x))
        last, at = problem, solution.x
        if is_last and answer is not None:
            recent = answer_of_recent(problem, solution, len(active.recent), answer)
            if recent is not None:
                last, at, solution, is_answered = recent
        set_history(state, history, vision, condensed, solution.x)
        if is_last:
            break
    history.steps = factors
    _remember(state, last, at, condensed)
    return is_answered


class AnswerOfRecent(NamedTuple):
    """What a solver makes of the recent states of a longer problem."""

    problem: WindowProblem
    """That of the recent states and the constants"""
    x: Array
    """Its unknowns at the end"""
    whole: Solution
    """That of the longer problem"""
    is_answered: bool
    """Whether the solver's optimum is the one that was taken"""


def answer_of_recent(
    problem: WindowProblem, before: Solution, n_recent: int, answer: WindowSolver
) -> AnswerOfRecent | None:
    """Continue from a solution with the latest states and the constants; the earlier states follow.

    The dynamics of the earlier states are linearized at the solution. The step is taken if the whole problem
    costs no more after it. None: the earlier states cannot be eliminated.
    """
    n_old, x = problem.n_frames - n_recent, before.x
    H, g = problem.vision.H.copy(), problem.vision.gradient(x)
    r, D = factor_jacobians(x, problem.R_ref, problem.factors, problem.prior.form, problem.R_inertia)
    # the steps between recent states remain part of the program
    r[n_old:], D[n_old:] = 0.0, 0.0
    add_steps(H, g, r, D, N_STATE)
    old, kept = np.split(np.arange(len(x)), [N_STATE * n_old])
    try:
        left = eliminate(H, g, old, kept)
    except LinAlgError:
        return None
    recent = WindowProblem(
        Quadratic(left.H, left.g, x[kept]),
        problem.R_ref[n_old:],
        problem.factors.part(slice(n_old, None)),
        problem.weak_prior,
        problem.prior,
    )
    start = replace(before, x=x[kept])
    found = answer.solve(recent, x[kept], INNER_ITERATIONS)
    if not found.converged or confirmed(recent, start, found) is start:
        return AnswerOfRecent(recent, x[kept], before, False)
    whole = x + _whole_step(left, found.x - x[kept])
    if not problem.cost(whole) <= before.cost + NEGLIGIBLE:
        return AnswerOfRecent(recent, x[kept], before, False)
    return AnswerOfRecent(recent, found.x, replace(before, x=whole), True)


def set_history(
    state: EstimatorState, history: History, vision: HistoryVision, condensed: CondensedVision, x: Array
) -> Array:
    """Set a solution of the whole history. Returns the steps of its seen poses (6 N,)."""
    step = history.take(x, vision)
    state.active.constants = x[-N_CONSTANTS:].copy()
    state.move_landmarks(condensed, step[history.entries(state.active.frames, N_POSE)])
    return step


def expand_arrival(state: EstimatorState, history: History) -> None:
    """Form the arrival cost from the history, about the present solution."""
    active = state.active
    active.arrival = history.arrival(active, state.prior.form, state.R_inertia)
    active.factors = history.steps.part(slice(len(history.frames) - len(active.recent), None))


def solve_window(state: EstimatorState, answer: WindowSolver | None = None) -> bool:
    """Solve for the recent states, the seen poses and the constants under the arrival cost.

    Gauss-Newton leads to the optimum; ``answer``, if given, continues from there. Returns whether its optimum
    is the one that was taken.
    """
    is_answered = False
    observations, active = state.observations(), state.active
    n, newton = active.n_seen, NewtonSolver()
    for rounds_left in reversed(range(MAX_ROUNDS)):
        condensed = state.condensed(observations)
        x, at = active.vector(), active.seen_entries
        H, g = active.arrival.H.copy(), active.arrival.gradient(x)
        add_parts(H, g, [(at, condensed.S, condensed.g), *active.camera_parts()])
        left = eliminate(H, g, np.arange(n), np.arange(n, len(x)))
        vision = Quadratic(left.H, left.g, x[n:])
        problem = WindowProblem(vision, active.R_ref, active.factors, state.weak_prior, state.prior)
        solution = newton.solve(problem, x[n:], INNER_ITERATIONS)
        is_last = rounds_left == 0 or _small(_whole_step(left, solution.x - x[n:])[at])
        if is_last and answer is not None:
            found = answer.solve(problem, solution.x, INNER_ITERATIONS)
            solution = confirmed(problem, solution, found)
            is_answered = found.converged and solution is found
        step = _whole_step(left, solution.x - x[n:])
        active.take(x + step)
        state.move_landmarks(condensed, step[at], n_fixed=len(active.keys) + 1)
        if is_last:
            break
    _remember(state, problem, solution.x, condensed)
    return is_answered


def confirmed(problem: WindowProblem, before: Solution, found: Solution) -> Solution:
    """The one that was found, unless it is more than a standard deviation away from the one before.

    The arrival cost is a quadratic form: far from where it was expanded, an optimum of the window is not one
    of all observations.
    """
    _, H, _ = problem.normal_equations(before.x)
    step = found.x - before.x
    return found if step @ H @ step < 1.0 else before


def _whole_step(left: Elimination, step: Array) -> Array:
    """The step of what was eliminated, which follows from that of what was kept, then the latter."""
    return np.concatenate([left.follow(step), step])


def _small(poses: Array) -> bool:
    return bool(np.abs(poses.reshape(-1, N_POSE)[:, ROTATION]).max() < SMALL_TURN_RAD)


def _remember(state: EstimatorState, problem: WindowProblem, x: Array, condensed: CondensedVision) -> None:
    """``problem`` ends with the last state and the constants; x is where it was solved."""
    _, H, _ = problem.normal_equations(x)
    state.contradicted = float(np.mean(condensed.squared > GATE**2)) if len(condensed.squared) else 0.0
    state.last = last_information(H, problem.prior(x[-N_CONSTANTS:], problem.weak_prior)[2])


def choose_inertia(state: EstimatorState, history: History) -> str:
    """Move the history to the best inertia found, if it is significantly better. Returns its name."""
    observations = state.observations()
    condensed = state.condensed(observations)
    vision = history.vision(state.active, condensed)
    before = history.vector(state.active.constants)
    second = state.prior.form.second_moments(state.xi, state.R_inertia)
    present = _descend(state, history, vision.quadratic, before, second, [])
    found = [] if present is None else [present]
    best, name = present, "present"
    start, R_NG, w_G = _differenced_rates(history, before)
    for guess, second in inertia_hypotheses(R_NG, w_G).items():
        candidate = _descend(state, history, vision.quadratic, start, second, found)
        if candidate is None or any(candidate is other for other in found):
            continue
        found.append(candidate)
        if best is None or candidate.cost < best.cost - CLEARLY_BETTER:
            best, name = candidate, guess
    if best is None:
        return "none"
    set_history(state, history, vision, condensed, best.x)
    state.set_inertia(*state.prior.form.coordinates(best.second))
    return name


def _differenced_rates(history: History, x: Array) -> tuple[Array, Array, Array]:
    """The unknowns with the rates by differences of the attitudes; attitudes (N, 3, 3) and rates (N, 3)."""
    R_NG = np.stack([frame.R_NG for frame in history.frames])
    time_s = np.array([frame.time_s for frame in history.frames])
    w_G = interpolated_rates(time_s, *interval_rates(time_s, R_NG)[::-1])
    fresh = x.copy()
    fresh[:-N_CONSTANTS].reshape(-1, N_STATE)[:, RATE] = w_G
    return fresh, R_NG, w_G


def _descend(
    state: EstimatorState,
    history: History,
    vision: Quadratic,
    x: Array,
    second: Array,
    found: list[InertiaCandidate],
) -> InertiaCandidate | None:
    """A brief solve from one inertia; a candidate found before if it leads there, None if it diverges."""
    form, cost = state.prior.form, np.inf
    x = x.copy()
    for iterations in PASSES:
        xi, R_inertia = form.coordinates(second)
        x[-len(xi) :] = xi
        weak = state.weak_prior.copy()
        weak[4:] = R_inertia.T.ravel()
        J_G = inertia_from_second_moments(second)
        factors = history.factors(x, J_G, state.J_noise, state.disturbances)
        problem = WindowProblem(vision, history.R_ref, factors, weak, state.prior)
        try:
            solution = NewtonSolver().solve(problem, x, iterations)
        except LinAlgError:
            return None
        x, cost = solution.x, solution.cost + factors.half_log_det
        second = form.second_moments(x[-len(xi) :], R_inertia)
        for other in found:
            if np.abs(second - other.second).max() < SAME_INERTIA:
                return other
    return InertiaCandidate(x, second, float(cost)) if np.isfinite(cost) else None
