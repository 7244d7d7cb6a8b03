"""Measurements and a first guess to motion, mass properties and covariance: full smoothing."""

from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.fit import SUSPICIOUS, disturbance_ratio, fit
from polhode.backend.initialization.multistart import N_HYPOTHESES, recenter_inertia
from polhode.backend.initialization.rotation_direction import FAST_HINT
from polhode.backend.noise.systematic import with_systematic
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.result import assemble
from polhode.backend.solvers.gauss_newton import GaussNewton, Solution
from polhode.backend.solvers.ipopt import MotionProgram
from polhode.backend.solvers.linearization_point import TIGHT_GAUGE, linearization_point
from polhode.backend.uncertainty.ambiguity import ambiguous_turns_deg, with_ambiguous_rotation
from polhode.config.backend import Backend
from polhode.errors import RunFailure
from polhode.progress import Progress
from polhode.records import InitialMotion, MotionEstimate, StereoTracks
from polhode.threads import single_threaded

MAX_PASSES = 4
PASS_TOLERANCE = 1e-7
"""Relative change of the cost between passes that ends them."""


@single_threaded
def estimate_motion(
    tracks: StereoTracks, initial: InitialMotion, config: Backend, progress: Progress
) -> MotionEstimate:
    """Full smoothing over the sequence from several guesses of the inertia (``program.MotionProgram``).

    Raises RunFailure when no guess leads to a motion that most observations agree with.
    """
    try:
        # guesses that diverge overflow; their cost sorts them out
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return _estimate(tracks, initial, config, progress)
    except LinAlgError as error:
        # numpy's own words say nothing of the target
        reason = error if "bounds" in str(error) else "its equations have no solution"
        raise RunFailure(
            f"no consistent motion: what fits best is no motion of a body ({reason}; {FAST_HINT})"
        ) from error


def _estimate(
    tracks: StereoTracks, initial: InitialMotion, config: Backend, progress: Progress
) -> MotionEstimate:
    data = motion_data(tracks, config)
    with progress.stage("motion and inertia", N_HYPOTHESES + 4) as advance:
        found = fit(data, tracks, initial, config, advance)
        data, kept, iterate = found.data, found.kept, found.iterate
        ended = solve(kept.data, kept.restrict(iterate), config)
        solution = ended.solution
        advance()
        estimate = assemble(tracks, data, kept, kept.expand(ended.iterate, iterate), found.scales, initial)
        advance()
    trials, best = found.trials, found.choice.name
    runner_up = {name: trial.cost - trials[best].cost for name, trial in trials.items() if name != best}
    runner_up |= found.wrench_runner_up
    outcome = replace(
        estimate.solver,
        name=ended.solver,
        iterations=ended.iterations,
        cost=solution.cost,
        converged=solution.converged,
        message=f"{solution.message}; best hypothesis: {best}",
        runner_up=runner_up,
    )
    estimate = with_systematic(estimate, tracks, config.systematic_px)
    stronger = disturbance_ratio(data, config.accel_psd, config.torque_psd)
    turns_deg = ambiguous_turns_deg(found.choice, trials[best], data.dt_s, stronger >= SUSPICIOUS)
    if turns_deg is not None:
        estimate = with_ambiguous_rotation(estimate, turns_deg)
    warnings = [*estimate.warnings, *_warnings_of_disturbances(data, config, stronger)]
    if not solution.converged:
        warnings.append(f"the solver stopped before convergence: {solution.message} ({FAST_HINT})")
    return replace(estimate, solver=outcome, warnings=tuple(warnings))


def _warnings_of_disturbances(data: MotionData, config: Backend, stronger: float) -> list[str]:
    ends = float(np.sum(data.dt_s))
    out = [
        f"backend.unknown_wrench_s: {start:g} to {end:g} s is outside the sequence of {ends:g} s"
        for start, end in config.unknown_wrench_s
        if end <= 0.0 or start >= ends
    ]
    if stronger < SUSPICIOUS:
        return out
    return [
        *out,
        f"the motion looks disturbed {stronger:.0f} times more strongly than stated (power): a push may be "
        "behind it, or wrong associations; sigmas are wide for that",
    ]


@dataclass(frozen=True)
class SolverResult:
    """Where the last step of the back end ended."""

    solver: str
    """Name of the one that found it"""
    iterate: Iterate
    solution: Solution
    iterations: int


def solve(data: MotionData, iterate: Iterate, config: Backend) -> SolverResult:
    """The optimum. Where Gauss-Newton comes to no end IPOPT goes on from its best.

    IPOPT gets along valleys in which Gauss-Newton creeps, but takes several times as long. Gauss-Newton has
    half of the iterations and of the time; IPOPT, should it be needed, all iterations and the time that is
    left. Raises LinAlgError where neither has a solution.
    """
    limits = (config.max_iterations, config.max_seconds)
    if config.solver == "ipopt":
        return SolverResult(MotionProgram.name, *refine(MotionProgram(data), data, iterate, *limits))
    begin, newton = perf_counter(), None
    half = (max(config.max_iterations // 2, 1), 0.5 * config.max_seconds)
    with suppress(LinAlgError):
        newton = SolverResult(
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
    words = f"{solution.message}, after {done} iterations of {GaussNewton.name} without an end"
    return SolverResult(MotionProgram.name, at, replace(solution, message=words), done + more)


def refine(
    solver: GaussNewton | MotionProgram,
    data: MotionData,
    iterate: Iterate,
    max_iterations: int,
    max_seconds: float = np.inf,
) -> tuple[Iterate, Solution, int]:
    """Solve, renew references and whitening, until the cost rests or a limit is met."""
    before, total, end = np.inf, 0, perf_counter() + max_seconds
    for _ in range(MAX_PASSES):
        iterate = recenter_inertia(data, iterate)
        fixed = linearization_point(data, iterate, TIGHT_GAUGE)
        left = (max_iterations - total, end - perf_counter())
        solution = solver.solve(fixed, iterate.vector(), *left)
        iterate, total = iterate.moved_to(solution.x), total + solution.iterations
        if abs(before - solution.cost) <= PASS_TOLERANCE * max(solution.cost, 1.0):
            # nothing is left to gain, whatever ended the last solve
            solution = replace(solution, converged=True)
            break
        if total >= max_iterations or perf_counter() >= end:
            break
        before = solution.cost
    return iterate, solution, total
