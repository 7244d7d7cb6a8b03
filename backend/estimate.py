"""Full smoothing: from measurements and an initial motion to motion, mass properties and covariance."""

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.fit import SUSPICIOUS, disturbance_ratio, fit
from polhode.backend.initialization.multistart import N_HYPOTHESES
from polhode.backend.initialization.rotation_direction import FAST_HINT
from polhode.backend.noise.systematic import with_systematic
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.result import assemble
from polhode.backend.solvers.solve import solve
from polhode.backend.uncertainty.ambiguity import ambiguous_turns_deg, with_ambiguous_rotation
from polhode.config.backend import Backend
from polhode.errors import RunFailure
from polhode.progress import Progress
from polhode.records import InitialMotion, MotionEstimate, StereoTracks
from polhode.threads import single_threaded


@single_threaded
def estimate_motion(
    tracks: StereoTracks, initial: InitialMotion, config: Backend, progress: Progress
) -> MotionEstimate:
    """Smooth the whole sequence, from several guesses of the inertia (problem: ``ipopt.MotionProgram``).

    Raises RunFailure when no guess leads to a motion that most observations agree with.
    """
    try:
        # guesses that diverge overflow, and are rejected by their cost
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return _estimate(tracks, initial, config, progress)
    except LinAlgError as error:
        # NumPy's message says nothing about the target
        reason = error if "bounds" in str(error) else "its equations have no solution"
        raise RunFailure(
            f"no consistent motion: the best fit is not a motion of a rigid body ({reason}; {FAST_HINT})"
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
        f"the disturbances appear {stronger:.0f} times as strong as stated (power): an unknown force or "
        "wrong associations may be the cause; the standard deviations are large accordingly",
    ]
