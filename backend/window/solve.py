"""The solves of one frame's update: of the whole history while it is kept, of the window alone afterwards.

Gauss-Newton leads to the optimum, and IPOPT continues with the recent states and the constants, by default.
While the history is kept, brief solves from several inertias decide whether another one fits better, and the
noise levels are estimated: of the pixels from the residuals of the active frames, of the disturbances by the
posterior of ``outliers_and_noise/level_posterior.py`` given the history alone; the landmarks are eliminated
there, and their part of the evidence does not depend on the level.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from polhode.backend.dynamics.residuals import add_steps
from polhode.backend.initialization.multistart import PASSES, SAME_INERTIA, inertia_hypotheses
from polhode.backend.initialization.rates import interpolated_rates, interval_rates
from polhode.backend.outliers_and_noise.level_posterior import posterior
from polhode.backend.outliers_and_noise.noise_and_outliers import (
    MAX_SHARE_OF_POSES,
    MIN_OBSERVATIONS,
    scales_by_median,
)
from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.backend.problem.iterate import N_CONSTANTS, N_POSE, N_STATE, RATE, ROTATION
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.causal_state import last_information
from polhode.backend.window.estimator_state import EstimatorState
from polhode.backend.window.frame import (
    STEREO_GATE,
    CondensedVision,
    FramePoses,
    WindowObservations,
    residuals,
)
from polhode.backend.window.history import ActiveWindow, History, HistoryVision, add_parts
from polhode.backend.window.problem import (
    NEGLIGIBLE_COST,
    DisturbanceLevels,
    Elimination,
    IpoptSolver,
    Quadratic,
    WindowProblem,
    eliminate,
    solve_newton,
)
from polhode.geometry.camera import stereo_jacobian
from polhode.geometry.lie import Array


def estimate_levels(state: EstimatorState, history: History) -> None:
    """Set accel_psd and torque_psd to what their posterior allows: a standard deviation above the means.

    At most to the stated ones, unless the means are above. An inertia that is off by sigmas can hide a
    disturbance.
    """
    vision = history.vision(state.active, state.condensed()).quadratic
    x = history.vector(state.active.constants)

    def minus_log_evidence(accel_psd: float, torque_psd: float) -> float:
        noise = DisturbanceLevels(accel_psd, torque_psd)
        steps = history.steps_at(x, state.J_G, state.J_noise, noise)
        problem = state.problem(vision, history.R_ref, steps)
        try:
            solution = solve_newton(problem, x, 3)
            factor = cholesky(problem.normal_equations(solution.x)[1], lower=True, check_finite=False)
        except LinAlgError:
            return np.inf
        return solution.cost + steps.half_log_det + float(np.log(np.diagonal(factor)).sum())

    found = posterior(state.level_prior, minus_log_evidence)
    levels = zip(found.psd, found.decades, state.level_prior.stated, strict=True)
    allowed = (max(psd, min(psd * 10.0**decades, stated)) for psd, decades, stated in levels)
    state.disturbances = DisturbanceLevels(*allowed)


def estimate_noise(state: EstimatorState) -> None:
    """Rescale the standard deviations of u, v and of the disparity by the median absolute residual."""
    observations = state.observations()
    if len(observations.frame) < MIN_OBSERVATIONS:
        return
    p_G = state.landmarks.p_G[observations.slot]
    r = residuals(observations, FramePoses(state.active.frames), state.model.rig, p_G)
    free = np.maximum(1.0 - freedom_of_fit(state, observations, p_G), 0.05)
    factors = scales_by_median(r, free)
    state.noise = state.noise * factors
    for frame in state.active.frames:
        frame.inv_sigma = frame.inv_sigma / factors


def freedom_of_fit(state: EstimatorState, observations: WindowObservations, p_G: Array) -> Array:
    """Share (M, 3) of the freedom of each residual that is used by landmarks and poses."""
    frames = state.active.frames
    poses = FramePoses(frames)
    A, k = poses.A[observations.frame], observations.frame
    p_R = (
        np.einsum("mij,mj->mi", A, p_G[observations.landmark])
        + (np.einsum("fij,fj->fi", poses.R_RN, poses.p_NG) + poses.t_R)[k]
    )
    D = stereo_jacobian(p_R, state.rig.focal_px, state.rig.baseline_m)
    J = observations.inv_sigma[:, :, None] * (D @ A)
    information = np.add.reduceat(np.swapaxes(J, 1, 2) @ J, observations.start[:-1], axis=0)
    used = np.einsum("mij,mjk,mik->mi", J, np.linalg.inv(information)[observations.landmark], J)
    # the poses are fitted to u and v: six unknowns for the two numbers of each observation
    used[:, :2] += min(3.0 * len(frames) / len(k), MAX_SHARE_OF_POSES)
    return np.asarray(used)


INNER_ITERATIONS = 10
MAX_LINEARIZATIONS = 8
"""Largest number of linearizations of the observations."""


class InertiaCandidate(NamedTuple):
    """The solution from one guess; its cost includes the normalization of the process noise."""

    x: Array
    second: Array
    cost: float


def solve_history(state: EstimatorState, history: History, answer: IpoptSolver | None = None) -> bool:
    """Solve for all states so far, with the active observations linearized at the solution.

    Gauss-Newton leads to the optimum; ``answer``, if given, continues with the recent states and the
    constants (``answer_of_recent``). Returns whether its optimum is the one that was taken.
    """
    active, is_answered = state.active, False
    # In the flat valley of an unknown inertia a long history would not converge: the next frame continues.
    left = 4 if len(history.frames) > 32 else MAX_LINEARIZATIONS * INNER_ITERATIONS
    for rounds_left in reversed(range(MAX_LINEARIZATIONS)):
        # its reference moves to it, while nothing else depends on the reference
        state.set_inertia(state.second_moments)
        condensed = state.condensed()
        x = history.vector(active.constants)
        steps = history.steps_at(x, state.J_G, state.J_noise, state.disturbances)
        vision = history.vision(active, condensed)
        problem = state.problem(vision.quadratic, history.R_ref, steps)
        solution = solve_newton(problem, x, min(left, INNER_ITERATIONS))
        left -= solution.iterations
        is_last = rounds_left == 0 or left <= 0 or _is_small(vision.seen_steps(solution.x - x))
        last, at = problem, solution.x
        if is_last and answer is not None:
            recent = answer_of_recent(problem, solution, len(active.recent), answer)
            if recent is not None:
                last, at, solution, is_answered = recent
        set_history(state, history, vision, condensed, solution.x)
        if is_last:
            break
    history.steps = steps
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
    problem: WindowProblem, before: Solution, n_recent: int, answer: IpoptSolver
) -> AnswerOfRecent | None:
    """Continue from a solution with the latest states and the constants; the earlier states follow.

    The dynamics of the earlier states are linearized at the solution. The step is taken if the whole problem
    costs no more after it. None: the earlier states cannot be eliminated.
    """
    n_old, x = problem.n_frames - n_recent, before.x
    H, g = problem.vision.H.copy(), problem.vision.gradient(x)
    r, D = problem.jacobians(x)
    # the steps between recent states remain part of the program
    r[n_old:], D[n_old:] = 0.0, 0.0
    add_steps(H, g, r, D, N_STATE)
    old, kept = np.split(np.arange(len(x)), [N_STATE * n_old])
    try:
        left = eliminate(H, g, old, kept)
    except LinAlgError:
        return None
    recent = replace(
        problem,
        vision=Quadratic(left.H, left.g, x[kept]),
        R_ref=problem.R_ref[n_old:],
        steps=problem.steps.part(slice(n_old, None)),
    )
    start = replace(before, x=x[kept])
    found = answer.solve(recent, x[kept])
    if not found.converged or confirmed(recent, start, found) is start:
        return AnswerOfRecent(recent, x[kept], before, False)
    whole = x + left.whole_step(found.x - x[kept])
    if not problem.cost(whole) <= before.cost + NEGLIGIBLE_COST:
        return AnswerOfRecent(recent, x[kept], before, False)
    return AnswerOfRecent(recent, found.x, replace(before, x=whole), True)


def set_history(
    state: EstimatorState, history: History, vision: HistoryVision, condensed: CondensedVision, x: Array
) -> None:
    """Set a solution of the whole history."""
    step = history.set_states(x, vision)
    state.active.constants = x[-N_CONSTANTS:].copy()
    state.move_landmarks(condensed, step[history.entries(state.active.frames, N_POSE)])


def solve_window(state: EstimatorState, answer: IpoptSolver | None = None) -> bool:
    """Solve for the recent states, the seen poses and the constants under the arrival cost.

    Gauss-Newton leads to the optimum; ``answer``, if given, continues from there. Returns whether its optimum
    is the one that was taken.
    """
    active, is_answered = state.active, False
    n = active.n_seen
    for rounds_left in reversed(range(MAX_LINEARIZATIONS)):
        condensed = state.condensed()
        x, at = active.vector(), active.seen_entries
        left = window_quadratic(active, condensed)
        problem = state.problem(Quadratic(left.H, left.g, x[n:]), active.R_ref, active.steps)
        solution = solve_newton(problem, x[n:], INNER_ITERATIONS)
        is_last = rounds_left == 0 or _is_small(left.whole_step(solution.x - x[n:])[at])
        if is_last and answer is not None:
            found = answer.solve(problem, solution.x)
            solution = confirmed(problem, solution, found)
            is_answered = found.converged and solution is found
        step = left.whole_step(solution.x - x[n:])
        active.set_vector(x + step)
        state.move_landmarks(condensed, step[at], n_fixed=len(active.keys) + 1)
        if is_last:
            break
    _remember(state, problem, solution.x, condensed)
    return is_answered


def window_quadratic(active: ActiveWindow, condensed: CondensedVision) -> Elimination:
    """Information on recent states and constants by observations and arrival cost, seen poses eliminated."""
    x, n = active.vector(), active.n_seen
    H, g = active.arrival.H.copy(), active.arrival.gradient(x)
    add_parts(H, g, [(active.seen_entries, condensed.S, condensed.g), *active.camera_parts()])
    return eliminate(H, g, np.arange(n), np.arange(n, len(x)))


def confirmed(problem: WindowProblem, before: Solution, found: Solution) -> Solution:
    """The one that was found, unless it is more than a standard deviation away from the one before.

    The arrival cost is a quadratic form: far from where it was expanded, an optimum of the window is not one
    of all observations.
    """
    _, H, _ = problem.normal_equations(before.x)
    step = found.x - before.x
    return found if step @ H @ step < 1.0 else before


def _is_small(poses: Array) -> bool:
    """Whether attitudes change so little [rad] that the observations need not be linearized again."""
    return bool(np.abs(poses.reshape(-1, N_POSE)[:, ROTATION]).max() < 2e-3)


def _remember(state: EstimatorState, problem: WindowProblem, x: Array, condensed: CondensedVision) -> None:
    """``problem`` ends with the last state and the constants; x is where it was solved."""
    _, H, _ = problem.normal_equations(x)
    wrong = condensed.squared > STEREO_GATE**2
    state.contradicted = float(np.mean(wrong)) if len(wrong) else 0.0
    state.last = last_information(H, problem.prior(x[-N_CONSTANTS:], problem.weak_prior)[2])


def choose_inertia(state: EstimatorState, history: History) -> None:
    """Move the history to the best inertia found, if its cost is lower by more than one."""
    condensed = state.condensed()
    vision = history.vision(state.active, condensed)
    before = history.vector(state.active.constants)
    best = _descend(state, history, vision.quadratic, before, state.second_moments, [])
    found = [] if best is None else [best]
    # other candidates start with rates by differences of the attitudes
    R_NG = np.stack([frame.R_NG for frame in history.frames])
    time_s = np.array([frame.time_s for frame in history.frames])
    w_G = interpolated_rates(time_s, *interval_rates(time_s, R_NG)[::-1])
    start = before.copy()
    start[:-N_CONSTANTS].reshape(-1, N_STATE)[:, RATE] = w_G
    for second in inertia_hypotheses(R_NG, w_G).values():
        candidate = _descend(state, history, vision.quadratic, start, second, found)
        if candidate is None or any(candidate is other for other in found):
            continue
        found.append(candidate)
        if best is None or candidate.cost < best.cost - 1.0:
            best = candidate
    if best is not None:
        set_history(state, history, vision, condensed, best.x)
        state.set_inertia(best.second)


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
        steps = history.steps_at(x, J_G, state.J_noise, state.disturbances)
        problem = WindowProblem(vision, history.R_ref, steps, weak, state.prior)
        try:
            solution = solve_newton(problem, x, iterations)
        except LinAlgError:
            return None
        x, cost = solution.x, solution.cost + steps.half_log_det
        second = form.second_moments(x[-len(xi) :], R_inertia)
        for other in found:
            if np.abs(second - other.second).max() < SAME_INERTIA:
                return other
    return InertiaCandidate(x, second, float(cost)) if np.isfinite(cost) else None
