"""The solve of the whole problem: Gauss-Newton to the optimum, IPOPT for the answer, their limits."""

from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.problem.iterate import Iterate
from polhode.backend.solvers.gauss_newton import GaussNewton, Solution
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import (
    TIGHT_GAUGE,
    MotionFit,
    linearization_point,
    recenter_inertia,
)
from polhode.config.backend_settings import Backend
from polhode.records.estimate import ProgramEnd

MAX_PASSES = 4
PASS_TOLERANCE = 1e-7
"""The passes end at a smaller relative change of the cost."""


@dataclass(frozen=True)
class SolvedMotion:
    """The final solution, and the solver that found it."""

    solver: str
    """Name of the solver"""
    iterate: Iterate
    solution: Solution
    iterations: int


def solve(start: MotionFit, config: Backend) -> SolvedMotion:
    """The optimum: Gauss-Newton leads to it, IPOPT continues from there and gives the answer.

    Near the optimum IPOPT takes one to three iterations. Where Gauss-Newton does not converge, IPOPT goes on
    from its best point: it makes progress in valleys where Gauss-Newton is slow. Gauss-Newton gets half of
    the iterations and of the time; IPOPT all iterations and the remaining time. With ``backend.solver:
    gauss_newton`` an answer to which Gauss-Newton converged stands.
    Raises LinAlgError if neither solver has a solution.
    """
    data, iterate = start.data, start.iterate
    begin, newton = perf_counter(), None
    half = (max(config.max_iterations // 2, 1), 0.5 * config.max_seconds)
    with suppress(LinAlgError):
        ended = refine(GaussNewton(data, line_search=True), iterate, *half)
        newton = SolvedMotion(GaussNewton.name, *ended)
    done = newton is not None and newton.solution.converged
    if newton is not None and done and config.solver == GaussNewton.name:
        return newton
    left_s = config.max_seconds - (perf_counter() - begin)
    if newton is not None and left_s <= 0.0:
        return newton
    first, cost = (iterate, np.inf) if newton is None else (newton.iterate, newton.solution.cost)
    try:
        before = cost if done else np.inf
        at, solution, more = refine(MotionProgram(data), first, config.max_iterations, left_s, before)
    except LinAlgError:
        if newton is None:
            raise
        return newton
    if newton is None:
        return SolvedMotion(MotionProgram.name, at, solution, more)
    if not solution.converged and (done or cost <= solution.cost):
        # what IPOPT says of it is reported all the same
        return replace(newton, solution=replace(newton.solution, program=solution.program))
    if not done:
        note = f"after {newton.iterations} iterations of {GaussNewton.name} without convergence"
        solution = replace(solution, message=f"{solution.message}, {note}")
    return SolvedMotion(MotionProgram.name, at, solution, newton.iterations + more)


def refine(
    solver: GaussNewton | MotionProgram,
    iterate: Iterate,
    max_iterations: int,
    max_seconds: float = np.inf,
    before: float = np.inf,
) -> tuple[Iterate, Solution, int]:
    """Solve, update references and whitening; repeat until the cost is stationary or a limit is reached.

    ``before``: cost at the start, if another solver ended there.
    """
    data, total, end, ends = solver.data, 0, perf_counter() + max_seconds, list[ProgramEnd]()
    for _ in range(MAX_PASSES):
        iterate = recenter_inertia(data, iterate)
        fixed = linearization_point(data, iterate, TIGHT_GAUGE)
        left = (max_iterations - total, end - perf_counter())
        solution = solver.solve(fixed, iterate.vector(), *left)
        iterate, total = iterate.moved_to(solution.x), total + solution.iterations
        if solution.program is not None:
            ends.append(solution.program)
        if abs(before - solution.cost) <= PASS_TOLERANCE * max(min(before, solution.cost), 1.0):
            # the cost is stationary, whatever ended the last solve
            solution = replace(solution, converged=True)
            break
        if total >= max_iterations or perf_counter() >= end:
            break
        before = solution.cost
    if ends:
        seconds = sum(each.seconds for each in ends)
        solution = replace(solution, program=replace(ends[-1], iterations=total, seconds=seconds))
    return iterate, solution, total
