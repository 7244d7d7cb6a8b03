"""The solve of the whole problem: the choice of the solver, its limits, and the fallback to IPOPT."""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.constraints import constraints_of
from polhode.backend.solvers.gauss_newton import GaussNewton, Solution
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, linearization_point, recenter_inertia
from polhode.config.backend_settings import Backend

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
    constraints: dict[str, bool] = field(default_factory=dict)
    """Those of the configuration, by name: whether each changed the optimum, or its limit is reached"""


def solve(data: MotionData, iterate: Iterate, config: Backend) -> SolvedMotion:
    """The optimum. If Gauss-Newton does not converge, IPOPT continues from its best point.

    IPOPT makes progress in valleys where Gauss-Newton is slow, but takes several times as long. Gauss-Newton
    gets half of the iterations and of the time; IPOPT, if needed, all iterations and the remaining time.
    An optimum that violates none of the configuration's constraints is that of the constrained problem, too;
    else IPOPT continues with them. Raises LinAlgError if neither solver has a solution.
    """
    constraints = constraints_of(data, iterate, config)
    found = _unconstrained(data, iterate, config)
    if not constraints:
        return found
    fixed = linearization_point(data, found.iterate, TIGHT_GAUGE)
    active = constraints.reached(fixed, found.iterate.vector())
    if not constraints.hold(fixed, found.iterate.vector()):
        program = MotionProgram(data, constraints)
        at, solution, more = refine(program, data, found.iterate, config.max_iterations, config.max_seconds)
        found = SolvedMotion(MotionProgram.name, at, solution, found.iterations + more)
        fixed = linearization_point(data, at, TIGHT_GAUGE)
    # also one whose limit the free optimum lies beyond, even if nothing holds the new one at that limit
    now = constraints.reached(fixed, found.iterate.vector())
    return replace(found, constraints={name: active[name] or now[name] for name in now})


def _unconstrained(data: MotionData, iterate: Iterate, config: Backend) -> SolvedMotion:
    limits = (config.max_iterations, config.max_seconds)
    if config.solver == "ipopt":
        return SolvedMotion(MotionProgram.name, *refine(MotionProgram(data), data, iterate, *limits))
    begin, newton = perf_counter(), None
    half = (max(config.max_iterations // 2, 1), 0.5 * config.max_seconds)
    with suppress(LinAlgError):
        newton = SolvedMotion(
            GaussNewton.name, *refine(GaussNewton(data, line_search=True), data, iterate, *half)
        )
    if newton is not None and newton.solution.converged:
        return newton
    done, start = (0, iterate) if newton is None else (newton.iterations, newton.iterate)
    left_s = config.max_seconds - (perf_counter() - begin)
    if newton is not None and left_s <= 0.0:
        return newton
    try:
        at, solution, more = refine(MotionProgram(data), data, start, config.max_iterations, left_s)
    except LinAlgError:
        if newton is None:
            raise
        return newton
    if newton is not None and not solution.converged and newton.solution.cost <= solution.cost:
        return newton
    message = f"{solution.message}, after {done} iterations of {GaussNewton.name} without convergence"
    return SolvedMotion(MotionProgram.name, at, replace(solution, message=message), done + more)


def refine(
    solver: GaussNewton | MotionProgram,
    data: MotionData,
    iterate: Iterate,
    max_iterations: int,
    max_seconds: float = np.inf,
) -> tuple[Iterate, Solution, int]:
    """Solve, update references and whitening; repeat until the cost is stationary or a limit is reached."""
    before, total, end = np.inf, 0, perf_counter() + max_seconds
    for _ in range(MAX_PASSES):
        iterate = recenter_inertia(data, iterate)
        fixed = linearization_point(data, iterate, TIGHT_GAUGE)
        left = (max_iterations - total, end - perf_counter())
        solution = solver.solve(fixed, iterate.vector(), *left)
        iterate, total = iterate.moved_to(solution.x), total + solution.iterations
        if abs(before - solution.cost) <= PASS_TOLERANCE * max(solution.cost, 1.0):
            # the cost is stationary, whatever ended the last solve
            solution = replace(solution, converged=True)
            break
        if total >= max_iterations or perf_counter() >= end:
            break
        before = solution.cost
    return iterate, solution, total
