"""The solves of one step: of the whole history while there is one, of the window alone afterwards."""

import numpy as np

from polhode.backend.dynamics.kernels import N_CONSTANTS
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.active import add_parts
from polhode.backend.window.causal_state import last_information
from polhode.backend.window.estimator_state import Belief
from polhode.backend.window.history import History, WholeVision
from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.problem import WindowProblem, WindowSolver
from polhode.backend.window.quadratic import Quadratic, eliminate
from polhode.backend.window.vision import GATE, N_POSE, Condensed
from polhode.lie import Array

INNER_ITERATIONS = 10
MOST_ROUNDS = 8
"""Of linearising vision anew."""
LONG_HISTORY = 32
"""Frames of a history beyond which one frame's work on it is limited; the next one goes on."""
LONG_ITERATIONS = 4
"""In all, of such a history: in the flat valley of an unknown inertia they would never end."""
SMALL_TURN_RAD = 2e-3
"""A step of the attitudes after which vision need not be linearised again."""


def solve_whole(belief: Belief, history: History) -> None:
    """All states so far, with the vision that is active linearised at the solution."""
    sight, active = belief.sight(), belief.active
    left = LONG_ITERATIONS if len(history.frames) > LONG_HISTORY else MOST_ROUNDS * INNER_ITERATIONS
    for _ in range(MOST_ROUNDS):
        belief.renew_inertia()
        condensed = belief.condensed(sight)
        x = history.vector(active.constants)
        links = history.links(x, belief.J_G, belief.J_noise, belief.disturbances)
        vision = history.vision(active, condensed)
        problem = WindowProblem(vision.quadratic, history.R_ref, links, belief.weak_prior, belief.shape)
        solution = NewtonSolver().solve(problem, x, min(left, INNER_ITERATIONS))
        left -= solution.iterations
        step = take_whole(belief, history, vision, condensed, solution.x)
        if _small(step) or left <= 0:
            break
    history.steps = links
    _remember(belief, problem, solution, condensed)


def take_whole(
    belief: Belief, history: History, vision: WholeVision, condensed: Condensed, x: Array
) -> Array:
    """Take a solution of the whole history. Returns the steps of its seen poses (6 N,)."""
    step = history.take(x, vision)
    belief.active.constants = x[-N_CONSTANTS:].copy()
    belief.move_landmarks(condensed, step[history.entries(belief.active.frames, N_POSE)])
    return step


def expand_arrival(belief: Belief, history: History) -> None:
    """Make the arrival cost from the history, about the present solution."""
    active = belief.active
    active.arrival = history.arrival(active, belief.shape.form, belief.R_inertia)
    active.links = history.steps.part(slice(len(history.frames) - len(active.recent), None))


def solve_window(belief: Belief, solver: WindowSolver) -> None:
    """The recent states, the seen poses and the constants under the arrival cost."""
    sight, active = belief.sight(), belief.active
    n = active.n_seen
    for _ in range(MOST_ROUNDS):
        condensed = belief.condensed(sight)
        x, at = active.vector(), active.seen_entries
        H, g = active.arrival.H.copy(), active.arrival.gradient(x)
        add_parts(H, g, [(at, condensed.S, condensed.g), *active.camera_parts()])
        left = eliminate(H, g, np.arange(n), np.arange(n, len(x)))
        vision = Quadratic(left.H, left.g, x[n:])
        problem = WindowProblem(vision, active.R_ref, active.links, belief.weak_prior, belief.shape)
        solution = solver.solve(problem, x[n:], INNER_ITERATIONS)
        step = solution.x - x[n:]
        step = np.concatenate([left.follow(step), step])
        active.take(x + step)
        belief.move_landmarks(condensed, step[at], n_fixed=len(active.keys) + 1)
        if _small(step[at]):
            break
    _remember(belief, problem, solution, condensed)


def _small(poses: Array) -> bool:
    return bool(np.abs(poses.reshape(-1, N_POSE)[:, 3:]).max() < SMALL_TURN_RAD)


def _remember(belief: Belief, problem: WindowProblem, solution: Solution, condensed: Condensed) -> None:
    _, H, _ = problem.normal_equations(solution.x)
    belief.contradicted = float(np.mean(condensed.squared > GATE**2)) if len(condensed.squared) else 0.0
    belief.last = last_information(H, problem.shape.weak_prior(solution.x, problem.weak_prior)[2])
