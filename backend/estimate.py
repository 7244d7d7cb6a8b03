"""Full smoothing: from measurements and an initial motion to motion, mass properties and covariance.

``fit`` leads from initial guesses to a motion and its noise: hypotheses, pruning, known and unknown
disturbances. The optimum of the whole problem and the reported estimate follow.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.initialization.gaps import long_gaps
from polhode.backend.initialization.initialize import robust_landmarks
from polhode.backend.initialization.multistart import (
    N_HYPOTHESES,
    HypothesisFit,
    InitialGuess,
    KnownMotion,
    initial_guesses,
    known_guess,
    try_hypotheses,
)
from polhode.backend.initialization.rates import FAST_HINT, frame_rates
from polhode.backend.outliers_and_noise.outliers import NoiseScales, PrunedProblem, remove_outliers
from polhode.backend.outliers_and_noise.process_level import estimate_process_noise
from polhode.backend.outliers_and_noise.systematic import with_systematic
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.result import FAR_TURNS, assemble
from polhode.backend.solvers.solve import solve
from polhode.backend.uncertainty.ambiguity import (
    HypothesisChoice,
    ambiguous_turns_deg,
    choose_hypothesis,
    with_ambiguous_rotation,
)
from polhode.backend.wrenches.known_wrench import fit_known_wrench
from polhode.backend.wrenches.unknown_wrench import find_disturbed_steps
from polhode.config.backend_settings import Backend
from polhode.errors import RunFailure
from polhode.lie import inverse_pose, make_pose
from polhode.progress import Advance, Progress
from polhode.records import Bools, InitialMotion, Ints, MotionEstimate, StereoTracks
from polhode.threads import single_threaded

MAX_SEARCHES = 3
"""For unknown disturbances: once strong ones have a node the noise level is lower, and weak ones stand
out."""
MIN_AGREEMENT, SUSPICIOUS = 0.65, 30.0
"""With a smaller share of agreeing observations, or disturbances estimated this factor stronger than stated
(power), frames may contradict one another."""
MIN_KEPT_LANDMARKS, MAX_REPLACEMENTS = 0.9, 2
"""If a smaller share of the landmarks is kept, wrong initial poses may have misplaced them: they are placed
again."""
SHARE, LEAST = 0.3, 12
"""Frames are strong from this share of the observations in the richest tenth of the frames, and this
number."""
ENOUGH_FRAMES = 6
MAX_STRETCHES = 2
"""Stretches between long gaps that are tried, those with most observations first."""


@dataclass(frozen=True)
class Fit:
    """A motion near the optimum, and the problem with the noise levels estimated from the data."""

    data: MotionData
    kept: PrunedProblem
    iterate: Iterate
    """Solution with all landmarks"""
    scales: NoiseScales
    trials: dict[str, HypothesisFit]
    """Fits of the hypotheses, by name"""
    choice: HypothesisChoice
    """The hypothesis that was chosen"""
    wrench_runner_up: dict[str, float]
    """Additional cost of the other directions of a known torque's axes, by name"""


def fit(
    data: MotionData,
    tracks: StereoTracks,
    initial: InitialMotion,
    config: Backend,
    advance: Advance,
    known: KnownMotion | None = None,
) -> Fit:
    """Fit the motion; where frames seem to contradict one another, also from fewer of them.

    known: a motion that is near the optimum, from which alone the fit starts. Raises RunFailure or
    LinAlgError if no guess leads to a motion that most observations agree with.
    """
    if known is not None:
        starts = [known_guess(tracks, initial, data, known)]
        return _with_disturbances(data, _fit(data, starts, config, advance), starts, config)
    failure: RunFailure | LinAlgError | None = None
    found: list[tuple[Fit, list[InitialGuess]]] = []
    for first in (initial, *motions_from_fewer_frames(tracks, initial)):
        starts = initial_guesses(tracks, first, data)
        try:
            found.append((_fit(data, starts, config, advance), starts))
        except (RunFailure, LinAlgError) as error:
            failure = failure if failure is not None else error
            continue
        if not _doubtful(found[-1][0], data):
            return _with_disturbances(data, *found[-1], config)
        advance = _no_progress
    if not found:
        assert failure is not None
        raise failure
    # what looks like a contradiction may be a disturbance
    return _with_disturbances(data, *max(found, key=lambda one: _agreement(one[0])), config)


def _doubtful(found: Fit, stated: MotionData) -> bool:
    """Whether many observations disagree, or the motion appears strongly disturbed."""
    stronger = disturbance_ratio(found.data, stated.accel_psd, stated.torque_psd)
    return _agreement(found) < MIN_AGREEMENT or stronger > SUSPICIOUS


def disturbance_ratio(found: MotionData, accel_psd: float, torque_psd: float) -> float:
    """Estimated over stated disturbances (power), the larger ratio of force and torque."""
    return max(found.accel_psd / accel_psd, found.torque_psd / torque_psd)


def _agreement(found: Fit) -> float:
    """Share of the observations that agree with the motion."""
    return float(np.mean(found.kept.observations))


def _replace_landmarks(tracks: StereoTracks, kept: PrunedProblem, iterate: Iterate) -> Iterate:
    """Place the landmarks that were removed again, by the poses found since then."""
    X_RG = inverse_pose(tracks.X_NR) @ make_pose(iterate.R_NG, iterate.p_NG)
    p_G, known = robust_landmarks(tracks, X_RG, np.ones(tracks.n_frames, dtype=np.bool_))
    return replace(iterate, p_G=np.where((known & ~kept.landmarks)[:, None], p_G, iterate.p_G))


def _no_progress() -> None:
    return None


def _with_disturbances(data: MotionData, found: Fit, starts: list[InitialGuess], config: Backend) -> Fit:
    """The fit, repeated with nodes for unknown disturbances where these contradict free motion."""
    for _ in range(MAX_SEARCHES if config.unknown_wrench == "found" else 0):
        small = found.kept.restrict(found.iterate)
        try:
            disturbed = find_disturbed_steps(
                found.kept.data, small, data.node_sigma, config.process_noise == "given"
            )
            if disturbed is None:
                break
            with_nodes = replace(data, nodes=disturbed[0], node_sigma=disturbed[1])
            found = _fit(with_nodes, starts, config, _no_progress)
        except (RunFailure, LinAlgError):
            # keep the fit without further nodes
            break
    return found


def _fit(data: MotionData, starts: list[InitialGuess], config: Backend, advance: Advance) -> Fit:
    trials = try_hypotheses(data, starts, advance)
    choice = choose_hypothesis(trials, data.dt_s)
    stated = data
    data, kept, iterate, scales = remove_outliers(stated, trials[choice.name].iterate)
    for _ in range(MAX_REPLACEMENTS):
        if np.mean(kept.landmarks) >= MIN_KEPT_LANDMARKS:
            break
        data, kept, iterate, scales = remove_outliers(
            stated, _replace_landmarks(starts[0].tracks, kept, iterate)
        )
    advance()
    runner_up: dict[str, float] = {}
    if data.impulses is not None and data.impulses.acting.any():
        fitted, runner_up = fit_known_wrench(kept.data, kept.restrict(iterate))
        iterate = kept.expand(fitted, iterate)
    if config.process_noise == "estimated":
        level = estimate_process_noise(kept.data, kept.restrict(iterate))
        iterate, kept = kept.expand(level.iterate, iterate), replace(kept, data=level.data)
        data = replace(data, accel_psd=level.data.accel_psd, torque_psd=level.data.torque_psd)
    advance()
    return Fit(data, kept, iterate, scales, trials, choice, runner_up)


def motions_from_fewer_frames(tracks: StereoTracks, initial: InitialMotion) -> list[InitialMotion]:
    """Initial motions with fewer known poses, for sequences in which some frames contradict the others.

    A body whose sides look alike, by a third of a revolution about the axis of a dish for example, is given a
    wrong attitude where few features are seen, or after a long absence. Such frames agree among themselves,
    and no motion fits both them and the others. Fitted to the strong frames or to one stretch between long
    gaps, the motion extends into the rest by Euler's equation; observations that agree with it count again.
    """
    seen = np.bincount(tracks.frame, minlength=tracks.n_frames)
    out: list[Bools] = []
    rich = float(np.quantile(seen[initial.connected], 0.9))
    strong = np.asarray(initial.connected & (seen >= max(SHARE * rich, LEAST)))
    for known in (strong, *_stretches(tracks, initial, seen)):
        enough = known.sum() >= ENOUGH_FRAMES and not np.array_equal(known, initial.connected)
        if enough and not any(np.array_equal(known, other) for other in out):
            out.append(known)
    # the other poses stay as they are: in a first fit with loose steps their frames have no effect
    return [replace(initial, connected=known) for known in out]


def _stretches(tracks: StereoTracks, initial: InitialMotion, seen: Ints) -> list[Bools]:
    w_G = frame_rates(tracks.time_s, tracks.X_NR @ initial.X_RG, initial.connected)
    starts = [gap.after for gap in long_gaps(tracks.time_s, initial.connected, w_G) if gap.after is not None]
    stretch = np.searchsorted(starts, np.arange(tracks.n_frames), side="right")
    shown = np.bincount(stretch, seen * initial.connected)
    most = np.argsort(-shown, kind="stable")[:MAX_STRETCHES]
    return [np.asarray(initial.connected & (stretch == n)) for n in most]


@single_threaded
def estimate_motion(
    tracks: StereoTracks,
    initial: InitialMotion,
    config: Backend,
    progress: Progress,
    known: KnownMotion | None = None,
) -> MotionEstimate:
    """Smooth the whole sequence, from several guesses of the inertia (problem: ``ipopt.MotionProgram``).

    known: a motion that is near the optimum, from which alone the solver starts. Raises RunFailure when no
    guess leads to a motion that most observations agree with.
    """
    try:
        # guesses that diverge overflow, and are rejected by their cost
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            return _estimate(tracks, initial, config, progress, known)
    except LinAlgError as error:
        # NumPy's message says nothing about the target
        reason = error if "bounds" in str(error) else "its equations have no solution"
        raise RunFailure(
            f"no consistent motion: the best fit is not a motion of a rigid body ({reason}; {FAST_HINT})"
        ) from error


def _estimate(
    tracks: StereoTracks,
    initial: InitialMotion,
    config: Backend,
    progress: Progress,
    known: KnownMotion | None,
) -> MotionEstimate:
    data = motion_data(tracks, config)
    with progress.stage("motion and inertia", N_HYPOTHESES + 4) as advance:
        found = fit(data, tracks, initial, config, advance, known)
        data, kept, iterate = found.data, found.kept, found.iterate
        ended = solve(kept.data, kept.restrict(iterate), config)
        solution = ended.solution
        advance()
        full = kept.expand(ended.iterate, iterate)
        errors = (config.correlated_errors, config.light_px)
        estimate = assemble(tracks, data, kept, full, found.scales, initial, *errors)
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
        constraints=ended.constraints,
        ipopt=solution.program,
    )
    estimate = with_systematic(estimate, tracks, config.systematic_px, config.focal_error)
    stronger = disturbance_ratio(data, config.accel_psd, config.torque_psd)
    turns_deg = ambiguous_turns_deg(found.choice, trials[best], data.dt_s, stronger >= SUSPICIOUS)
    if turns_deg is not None:
        estimate = with_ambiguous_rotation(estimate, turns_deg)
    warnings = [*estimate.warnings, *_unused_times(data, config)]
    if known is not None:
        # which frames are far apart in time does not matter to it
        warnings = [warning for warning in warnings if FAR_TURNS not in warning]
    if not solution.converged:
        warnings.append(f"the solver stopped before convergence: {solution.message} ({FAST_HINT})")
    noise = replace(estimate.noise, times_stated=stronger)
    return replace(estimate, solver=outcome, warnings=tuple(warnings), noise=noise)


def _unused_times(data: MotionData, config: Backend) -> list[str]:
    ends = float(np.sum(data.dt_s))
    return [
        f"backend.unknown_wrench_s: {start:g} to {end:g} s is outside the sequence of {ends:g} s"
        for start, end in config.unknown_wrench_s
        if end <= 0.0 or start >= ends
    ]
