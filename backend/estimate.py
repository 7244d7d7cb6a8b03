"""Full smoothing: from measurements and an initial motion to motion, mass properties and covariance.

``fit`` leads from initial guesses to a motion and its noise: hypotheses, pruning, known and unknown
disturbances. The optimum of the whole problem and the reported estimate follow.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.initialization.initialize import robust_landmarks
from polhode.backend.initialization.multistart import (
    N_HYPOTHESES,
    HypothesisFit,
    InitialGuess,
    KnownMotion,
    initial_guesses,
    known_guess,
    long_gaps,
    try_hypotheses,
)
from polhode.backend.initialization.rates import FAST_HINT, frame_rates
from polhode.backend.outliers_and_noise.noise_and_outliers import PrunedFit, remove_outliers
from polhode.backend.outliers_and_noise.process_level import estimate_process_noise, with_level
from polhode.backend.outliers_and_noise.systematic import SharedErrors, with_systematic
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.result import FAR_TURNS, assemble
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.solve import solve
from polhode.backend.uncertainty.ambiguity import (
    OpenRotation,
    choose_hypothesis,
    end_of,
    open_rotations,
    revolution_off,
    with_ambiguous_rotation,
)
from polhode.backend.uncertainty.self_calibration import determined_errors
from polhode.backend.wrenches.known_wrench import fit_known_wrench
from polhode.backend.wrenches.unknown_wrench import find_disturbed_steps
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Bools, Ints, inverse_pose, make_pose
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Advance, Progress
from polhode.runtime.threads import single_threaded

MIN_AGREEING_SHARE, SUSPICIOUS_RATIO = 0.65, 30.0
"""With a smaller share of agreeing observations, or disturbances estimated this factor stronger than stated
(power), frames may contradict one another."""
MIN_KEPT_LANDMARKS = 0.9
"""If a smaller share of the landmarks is kept, wrong initial poses may have misplaced them: they are placed
again."""
MIN_OBSERVATION_SHARE, MIN_OBSERVATIONS = 0.3, 12
"""Frames are strong from this share of the observations in the richest tenth of the frames, and this
number."""
MIN_FRAMES = 6
"""Frames with known poses from which a motion is tried."""


@dataclass(frozen=True)
class Fit:
    """A motion near the optimum, and the problem with the noise levels estimated from the data."""

    pruned: PrunedFit
    trials: dict[str, HypothesisFit]
    """Fits of the hypotheses, by name"""
    choice: tuple[OpenRotation, ...]
    """The rotations between frames that fit equally well, the chosen one first"""
    wrench_runner_up: dict[str, float]
    """Additional cost of the other directions of a known torque's axes, by name"""

    @property
    def agreement(self) -> float:
        """Share of the observations that agree with the motion."""
        return float(np.mean(self.pruned.kept.observations))


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
        starts = initial_guesses(tracks, first, data, config.max_rate_rad_s)
        try:
            fitted = _fit(data, starts, config, advance)
        except (RunFailure, LinAlgError) as error:
            failure = failure if failure is not None else error
            continue
        stronger = disturbance_ratio(fitted.pruned.data, data.accel_psd, data.torque_psd)
        if fitted.agreement >= MIN_AGREEING_SHARE and stronger <= SUSPICIOUS_RATIO:
            return _with_disturbances(data, fitted, starts, config)
        found.append((fitted, starts))
        advance = lambda: None  # noqa: E731
    if not found:
        assert failure is not None
        raise failure
    # what looks like a contradiction may be a disturbance
    return _with_disturbances(data, *max(found, key=lambda one: one[0].agreement), config)


def disturbance_ratio(found: MotionData, accel_psd: float, torque_psd: float) -> float:
    """Estimated over stated disturbances (power), the larger ratio of force and torque."""
    return max(found.accel_psd / accel_psd, found.torque_psd / torque_psd)


def _with_disturbances(data: MotionData, found: Fit, starts: list[InitialGuess], config: Backend) -> Fit:
    """The fit, repeated with nodes for unknown disturbances where these contradict free motion."""
    # once strong disturbances have a node the noise level is lower, and weak ones stand out
    for _ in range(3 if config.unknown_wrench == "found" else 0):
        try:
            is_given = config.process_noise == "given"
            disturbed = find_disturbed_steps(found.pruned.small, data.node_sigma, is_given)
            if disturbed is None:
                break
            with_nodes = replace(data, nodes=disturbed[0], node_sigma=disturbed[1])
            found = _fit(with_nodes, starts, config, lambda: None)
        except (RunFailure, LinAlgError):
            # keep the fit without further nodes
            break
    return found


def _fit(data: MotionData, starts: list[InitialGuess], config: Backend, advance: Advance) -> Fit:
    trials = try_hypotheses(data, starts, advance)
    choice = choose_hypothesis(trials, data.dt_s, config.max_rpm is not None)
    assert choice[0].name is not None
    pruned = remove_outliers(MotionFit(data, trials[choice[0].name].iterate))
    for _ in range(2):
        if np.mean(pruned.kept.landmarks) >= MIN_KEPT_LANDMARKS:
            break
        pruned = remove_outliers(_replace_landmarks(data, starts[0].tracks, pruned))
    advance()
    runner_up: dict[str, float] = {}
    if data.impulses is not None and data.impulses.acting.any():
        fitted, runner_up = fit_known_wrench(pruned.small)
        pruned = pruned.with_solution(fitted)
    if config.process_noise == "estimated":
        pruned = _with_level(pruned)
    advance()
    return Fit(pruned, trials, choice, runner_up)


def _with_level(pruned: PrunedFit) -> PrunedFit:
    """The fit with the level of the disturbances that the data give."""
    level = estimate_process_noise(pruned.small)
    data = with_level(pruned.data, level.data.accel_psd, level.data.torque_psd)
    return replace(
        pruned.with_solution(level.iterate),
        data=replace(data, level_decades=level.data.level_decades),
        kept=replace(pruned.kept, data=level.data),
    )


def _hypothesis(
    tracks: StereoTracks, initial: InitialMotion, found: Fit, rotation: OpenRotation, config: Backend
) -> MotionEstimate | None:
    """The estimate of a motion that was not chosen; None: it was not fitted, or is no motion after all."""
    if rotation.name is None:
        return None
    try:
        pruned = remove_outliers(MotionFit(found.pruned.data, found.trials[rotation.name].iterate))
        if config.process_noise == "estimated":
            pruned = _with_level(pruned)
        ended = solve(pruned.small, config.model_copy(update={"solver": "gauss_newton"}))
        whole = pruned.with_solution(ended.iterate)
        found_motion = assemble(tracks, whole, initial, config)
    except (RunFailure, LinAlgError):
        return None
    return with_systematic(found_motion, tracks, SharedErrors(config.systematic_px))


def _replace_landmarks(stated: MotionData, tracks: StereoTracks, found: PrunedFit) -> MotionFit:
    """Place the landmarks that were removed again, by the poses found since then."""
    at = found.iterate
    X_RG = inverse_pose(tracks.X_NR) @ make_pose(at.R_NG, at.p_NG)
    p_G, known = robust_landmarks(tracks, X_RG, np.ones(tracks.n_frames, dtype=np.bool_))
    again = (known & ~found.kept.landmarks)[:, None]
    return MotionFit(stated, replace(at, p_G=np.where(again, p_G, at.p_G)))


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
    least = max(MIN_OBSERVATION_SHARE * rich, MIN_OBSERVATIONS)
    strong = np.asarray(initial.connected & (seen >= least))
    for known in (strong, *_richest_stretches(tracks, initial, seen)):
        enough = known.sum() >= MIN_FRAMES and not np.array_equal(known, initial.connected)
        if enough and not any(np.array_equal(known, other) for other in out):
            out.append(known)
    # the other poses stay as they are: in a first fit with loose steps their frames have no effect
    return [replace(initial, connected=known) for known in out]


def _richest_stretches(tracks: StereoTracks, initial: InitialMotion, seen: Ints) -> list[Bools]:
    """The two stretches (F,) between long gaps with most observations."""
    w_G = frame_rates(tracks.time_s, tracks.X_NR @ initial.X_RG, initial.connected)
    starts = [gap.after for gap in long_gaps(tracks.time_s, initial.connected, w_G) if gap.after is not None]
    stretch = np.searchsorted(starts, np.arange(tracks.n_frames), side="right")
    shown = np.bincount(stretch, seen * initial.connected)
    most = np.argsort(-shown, kind="stable")[:2]
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


def with_calibration(
    tracks: StereoTracks, estimate: MotionEstimate, config: Backend, progress: Progress
) -> tuple[StereoTracks, MotionEstimate]:
    """Measurements freed of the calibration's errors that they determine, and the estimate from these.

    The same ones where nothing is determined, or more than one rotation is left open. The estimate's
    covariances have what is left of the errors; effects of the tracks are of one sigma of that.
    """
    effects, part, score = tracks.calibration, estimate.calibration, estimate.calibration_score
    if effects is None or part is None or score is None or estimate.hypotheses:
        return tracks, estimate
    determined = determined_errors(score, effects)
    if determined is None:
        return tracks, estimate
    correction = effects.mixed(determined.mean[:, None])
    freed = tracks.freed(correction, effects.mixed(determined.factor))
    mass = estimate.mass
    w_G = estimate.w_P @ mass.R_GP.T
    known = KnownMotion(estimate.v_N, w_G, mass.com_G, second_moments_from_inertia(mass.J_G))
    seen = np.isin(np.arange(tracks.n_frames), tracks.frame)
    initial = InitialMotion(inverse_pose(tracks.X_NR) @ estimate.X_NG, seen)
    try:
        found = estimate_motion(freed, initial, config, progress, known)
    except RunFailure:
        return tracks, estimate
    assert found.calibration is not None
    far = [warning for warning in estimate.warnings if FAR_TURNS in warning]
    return freed, replace(
        found,
        warnings=(*found.warnings, *far),
        solver=replace(found.solver, runner_up=estimate.solver.runner_up),
        calibration=replace(found.calibration, estimated=determined.errors, correction=correction),
        calibration_score=score,
    )


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
        ended = solve(found.pruned.small, config)
        solution = ended.solution
        advance()
        whole = found.pruned.with_solution(ended.iterate)
        estimate = assemble(tracks, whole, initial, config)
        advance()
    trials, best = found.trials, found.choice[0].name
    assert best is not None
    runner_up = {name: trial.cost - trials[best].cost for name, trial in trials.items() if name != best}
    outcome = replace(
        estimate.solver,
        name=ended.solver,
        iterations=ended.iterations,
        cost=solution.cost,
        converged=solution.converged,
        message=f"{solution.message}; best hypothesis: {best}",
        runner_up=runner_up | found.wrench_runner_up,
        ipopt=solution.program,
    )
    estimate = with_systematic(estimate, tracks, SharedErrors(config.systematic_px))
    stronger = disturbance_ratio(whole.data, config.accel_psd, config.torque_psd)
    much_disturbed = stronger >= SUSPICIOUS_RATIO
    rotations = open_rotations(found.choice, trials, data.dt_s, much_disturbed, config.max_rpm is not None)
    if len(rotations) > 1:
        step_s = float(np.median(data.dt_s))
        hypotheses = [end_of(estimate, rotations[0])]
        for rotation in rotations[1:]:
            other = _hypothesis(tracks, initial, found, rotation, config)
            hypotheses.append(
                revolution_off(estimate, step_s, rotation) if other is None else end_of(other, rotation)
            )
        estimate = with_ambiguous_rotation(estimate, tuple(hypotheses))
    end_s = float(np.sum(data.dt_s))
    unused = [
        f"backend.unknown_wrench_s: {start:g} to {end:g} s is outside the sequence of {end_s:g} s"
        for start, end in config.unknown_wrench_s
        if end <= 0.0 or start >= end_s
    ]
    warnings = [*estimate.warnings, *unused]
    if known is not None:
        # which frames are far apart in time does not matter to it
        warnings = [warning for warning in warnings if FAR_TURNS not in warning]
    if not solution.converged:
        warnings.append(f"the solver stopped before convergence: {solution.message} ({FAST_HINT})")
    noise = replace(estimate.noise, times_stated=stronger)
    return replace(estimate, solver=outcome, warnings=tuple(warnings), noise=noise)
