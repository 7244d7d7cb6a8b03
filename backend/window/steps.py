"""The solves of one step: of the whole history while there is one, of the window alone afterwards."""

import numpy as np

from backend.gauss_newton import Solution
from backend.kernels import N_CONSTANTS
from backend.window.belief import Belief
from backend.window.history import History
from backend.window.newton import NewtonSolver
from backend.window.problem import WindowProblem, WindowSolver
from backend.window.quadratic import Quadratic, eliminate
from backend.window.state import last_information
from backend.window.vision import N_POSE
from polhode.lie import Array

INNER_ITERATIONS = 10
MOST_ROUNDS = 8
"""Of linearising vision anew."""
SMALL_TURN_RAD, SMALL_CHANGE = 2e-3, 0.02
"""A step of the attitudes, and of com_G and xi, after which vision need not be linearised again."""


def solve_whole(belief: Belief, history: History) -> None:
    """All states so far, with the vision that is active linearised at the solution."""
    sight, active = belief.sight(), belief.active
    for _ in range(MOST_ROUNDS):
        belief.renew_inertia()
        condensed = belief.condensed(sight)
        x = history.vector(active.constants)
        links = history.links(x, belief.J_G, belief.noise_of_steps)
        problem = WindowProblem(
            history.vision(active, condensed), history.R_ref, links, belief.weak_prior, belief.shape
        )
        solution = NewtonSolver().solve(problem, x, INNER_ITERATIONS)
        step = solution.x - x
        history.take(solution.x)
        active.constants = solution.x[-N_CONSTANTS:].copy()
        belief.move_landmarks(condensed, step[history.pose_entries(active.frames)])
        if _small(step[history.pose_entries(history.frames)], step[-N_CONSTANTS:]):
            break
    history.steps = links
    _remember(belief, problem, solution)


def expand_arrival(belief: Belief, history: History) -> None:
    """Make the arrival cost from the history, about the present solution."""
    active = belief.active
    active.arrival = history.arrival(active, belief.shape.form, belief.R_inertia)
    active.links = history.steps.part(slice(len(history.frames) - len(active.recent), None))


def solve_window(belief: Belief, solver: WindowSolver) -> None:
    """The recent states, the key poses and the constants under the arrival cost."""
    sight, active = belief.sight(), belief.active
    n = active.n_keys
    for _ in range(MOST_ROUNDS):
        condensed = belief.condensed(sight)
        x, at = active.vector(), active.pose_entries
        H, g = active.arrival.H.copy(), active.arrival.gradient(x)
        H[np.ix_(at, at)] += condensed.S
        g[at] += condensed.g
        left = eliminate(H, g, np.arange(n), np.arange(n, len(x)))
        vision = Quadratic(left.H, left.g, x[n:])
        problem = WindowProblem(vision, active.R_ref, active.links, belief.weak_prior, belief.shape)
        solution = solver.solve(problem, x[n:], INNER_ITERATIONS)
        step = solution.x - x[n:]
        step = np.concatenate([left.follow(step), step])
        active.take(x + step)
        belief.move_landmarks(condensed, step[at])
        if _small(step[at], step[-N_CONSTANTS:]):
            break
    _remember(belief, problem, solution)


def _small(poses: Array, constants: Array) -> bool:
    turn = np.abs(poses.reshape(-1, N_POSE)[:, 3:]).max()
    return bool(turn < SMALL_TURN_RAD and np.abs(constants).max() < SMALL_CHANGE)


def _remember(belief: Belief, problem: WindowProblem, solution: Solution) -> None:
    _, H, _ = problem.normal_equations(solution.x)
    belief.last = last_information(H, problem.shape.weak_prior(solution.x, problem.weak_prior)[2])
