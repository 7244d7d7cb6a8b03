"""From the solution to the estimate that is reported: states in P, covariances, identifiability, warnings."""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.initialization.rates import FAST_HINT
from polhode.backend.outliers_and_noise.correlated_noise import (
    KINDS,
    CorrelatedNoise,
    measure_correlation,
    turns_between,
)
from polhode.backend.outliers_and_noise.noise_and_outliers import PrunedFit, whitened_residuals
from polhode.backend.outliers_and_noise.systematic import common_slide
from polhode.backend.problem.iterate import COM, ERR_THETA, ERR_W, N_CONSTANTS, POSE, XI
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.robust_kernel import robust_information, robust_weight, score_gain
from polhode.backend.uncertainty.calibration_response import whitened_effects
from polhode.backend.uncertainty.covariance import (
    DependentErrors,
    Marginals,
    body_jacobians,
    marginals,
    mark_jacobians,
    observation_jacobians,
    pose_covariances,
    state_covariances,
    state_jacobians,
    with_constants,
    with_infinite,
)
from polhode.backend.uncertainty.identifiability import (
    IdentifiabilityAnalysis,
    analyse,
    undetermined_states,
    with_more,
)
from polhode.backend.uncertainty.principal_axes import (
    AxesDerivative,
    axes_derivative,
    free_axis_covariance,
    nonlinear_turns,
    ratio_covariance,
)
from polhode.backend.uncertainty.self_calibration import score_of, stretches, unmodelled_errors
from polhode.backend.wrenches.known_wrench import with_absolute_scale
from polhode.backend.wrenches.unknown_wrench import describe_impulse, estimate_impulses
from polhode.config.backend_settings import Backend, CorrelatedErrors
from polhode.geometry.lie import Array, Bools, make_pose
from polhode.records.estimate import (
    CalibrationPart,
    Identifiability,
    InitialMotion,
    Landmarks,
    MassProperties,
    MotionEstimate,
    NoiseLevels,
    SolverOutcome,
)
from polhode.records.tracks import StereoTracks

FAR_TURNS = "between frames: near half a revolution and beyond"
"""Of the warning that poses do not determine the direction of rotation"""


def assemble(
    tracks: StereoTracks, found: PrunedFit, initial: InitialMotion, config: Backend
) -> MotionEstimate:
    """The estimate at a solution, for all observations, with covariances of the pruned problem.

    Of config the errors that observations have in common. Those that all landmarks share (slide) are left out
    where parts are compared, which share them.
    """
    data, kept, iterate, small = found.data, found.kept, found.iterate, found.small
    residuals = whitened_residuals(MotionFit(data, iterate))
    squares = np.sum(residuals**2, axis=1)
    weight = np.where(kept.observations, robust_weight(squares, data.robust_scale), 0.0)
    s = np.sum(residuals[kept.observations] ** 2, axis=1)
    correlated, errors = _dependent_errors(small, config.correlated_errors, config.light_px)
    information, effects = robust_information(s, data.robust_scale), whitened_effects(small, tracks)
    longer = stretches(small)
    m = marginals(small, information, errors, effects, longer)
    pull = score_gain(s, data.robust_scale) * (weight[:, None] * residuals)[kept.observations]
    unmodelled = unmodelled_errors(small.data, longer, config.systematic_px, config.light_px)
    all_effects = np.concatenate([longer, effects], axis=2), m.refitted
    score = score_of(small, pull, information, all_effects, errors, unmodelled)
    derivative = axes_derivative(data.form, iterate)
    R_GP = derivative.R_GP
    w_P = iterate.w_G @ R_GP
    determined = _with_calibration(analyse(m.constants_information, derivative, w_P), small, m, derivative)
    covariance, joint = _state_covariances(small, m, derivative, determined, w_P)
    true = FrameStates.of(iterate, data.camera_N)
    mass = with_absolute_scale(_mass(small, m, derivative, determined), small, m, derivative)
    axes_known = mass.identifiable.axes_P
    disturbances = estimate_impulses(small, m, derivative, axes_known, tracks.timestamps_ns)
    warnings = _warnings(tracks, weight, mass.identifiable, initial)
    turn = np.rad2deg(np.linalg.norm(iterate.w_G[:-1], axis=1) * data.dt_s).max()
    if turn > 150.0:
        warnings.append(
            f"up to {turn:.0f} degrees {FAR_TURNS}, poses do not determine the direction of rotation, "
            "Euler's equation alone does"
        )
    if disturbances is not None:
        first_ns = int(tracks.timestamps_ns[0])
        warnings += [describe_impulse(impulse, first_ns) for impulse in disturbances.impulses]
    stated = np.median(tracks.sigma_px, axis=0)
    landmark_sigma = np.sqrt(np.trace(m.landmarks, axis1=1, axis2=2) / 3.0)
    of_body, of_marks = body_jacobians(iterate, data.camera_N), mark_jacobians(iterate, R_GP, data.camera_N)
    return MotionEstimate(
        timestamps_ns=tracks.timestamps_ns,
        r_N=true.centres(),
        v_N=iterate.v_N,
        R_NP=true.true_attitudes() @ R_GP,
        w_P=w_P,
        X_NG=make_pose(iterate.R_NG, iterate.p_NG),
        covariance=covariance,
        covariance_last_joint=joint,
        covariance_last_body=state_covariances(iterate, m, of_body)[1],
        covariance_X_NG=pose_covariances(iterate, m),
        covariance_of_marks=state_covariances(iterate, m, of_marks)[0],
        mass=mass,
        landmarks=Landmarks(small.iterate.p_G, landmark_sigma, np.diff(kept.data.start)),
        residuals_px=data.unsorted(residuals / data.inv_sigma),
        inlier_weight=data.unsorted(weight),
        noise=NoiseLevels(
            float(found.scales[0] * 0.5 * (stated[0] + stated[1])),
            float(found.scales[2] * stated[2]),
            data.accel_psd,
            data.torque_psd,
            *data.level_decades,
            drift_px=0.0 if correlated is None else correlated.slow / float(np.median(data.inv_sigma[:, 0])),
        ),
        solver=SolverOutcome("", 0, 0.0, False, reduced_chi2(small, s)),
        warnings=tuple(warnings),
        disturbances=disturbances,
        calibration=_calibration_part(tracks, small, m, derivative),
        calibration_score=score,
    )


def _calibration_part(
    tracks: StereoTracks, fit: MotionFit, m: Marginals, derivative: AxesDerivative
) -> CalibrationPart | None:
    if tracks.calibration is None:
        return None
    iterate, (n, s) = fit.iterate, (fit.iterate.n_states, fit.iterate.n_state)
    poses = m.by_calibration[:n].reshape(iterate.n_frames, s, -1)[:, POSE]
    at = np.r_[n - s : n, n : n + N_CONSTANTS]
    last, of_J = m.by_calibration[at], m.by_calibration[n + 3 : n + N_CONSTANTS]
    T = state_jacobians(iterate, derivative, fit.data.camera_N)[-1]
    k, axes = derivative.ratios @ of_J, derivative.axes @ of_J
    return CalibrationPart(
        tracks.calibration.source, with_constants(T, last @ last.T), k @ k.T, axes @ axes.T, poses
    )


def _with_calibration(
    found: IdentifiabilityAnalysis, fit: MotionFit, m: Marginals, derivative: AxesDerivative
) -> IdentifiabilityAnalysis:
    """Sigmas and descriptions with the calibration's part; what is determined is judged without it."""
    n = fit.iterate.n_states
    of_J = m.by_calibration[n + 3 : n + N_CONSTANTS]
    moves = derivative.R_GP.T @ m.by_calibration[n : n + 3], derivative.ratios @ of_J, derivative.axes @ of_J
    return replace(found, record=with_more(found.record, np.linalg.norm(np.vstack(moves), axis=1)))


def _dependent_errors(
    fit: MotionFit, known: CorrelatedErrors, light_px: float
) -> tuple[CorrelatedNoise | None, DependentErrors | None]:
    """How the errors of the observations depend on one another, from the residuals, and what of it is
    ``known`` to the covariance. None: too few observations, or nothing.
    """
    data, iterate = fit.data, fit.iterate
    to_landmark = observation_jacobians(fit)[1]
    turn_rad = turns_between(iterate.R_NG, data.R_RN @ iterate.R_NG)
    found = measure_correlation(data, whitened_residuals(fit), to_landmark, turn_rad)
    if found is None:
        return None, None
    if known == "none":
        return found, None
    drift_px = found.slow / float(np.median(data.inv_sigma[:, 0]))
    slide_px = float(np.hypot(light_px, drift_px)) if known == "slide" else 0.0
    common = common_slide(fit, to_landmark, slide_px)
    variance, drift = found.variance(data), found.drift_between(turn_rad)
    if known == "neighbours":
        # the drift as well is taken as independent between frames
        variance, drift = variance + found.drifting.sum(axis=1)[KINDS], np.zeros_like(drift)
    return found, DependentErrors(variance, drift, common)


def _state_covariances(
    fit: MotionFit, m: Marginals, derivative: AxesDerivative, determined: IdentifiabilityAnalysis, w_P: Array
) -> tuple[Array, Array]:
    iterate = fit.iterate
    jacobians = state_jacobians(iterate, derivative, fit.data.camera_N)
    covariance, joint = state_covariances(iterate, m, jacobians)
    axes_lost = ~determined.record.axes_P
    neglected = nonlinear_turns(derivative, _cov_J(fit, m), w_P, axes_lost)
    at = np.r_[ERR_THETA, ERR_W]
    covariance[:, at[:, None], at] += neglected
    for whole in (*covariance, joint):
        whole[ERR_THETA, ERR_THETA] = free_axis_covariance(whole[ERR_THETA, ERR_THETA], axes_lost)
    lost = undetermined_states(determined, jacobians, m.response, w_P)
    for k in range(iterate.n_frames):
        covariance[k] = with_infinite(covariance[k], lost[k])
    constants_lost = determined.lost_constants
    joint = with_infinite(joint, np.concatenate([lost[-1], constants_lost[XI], constants_lost[COM]]))
    return covariance, joint


def _cov_J(fit: MotionFit, m: Marginals) -> Array:
    """(5, 5) of xi."""
    n = fit.iterate.n_states
    return np.asarray(m.dense[n + 3 : n + 8, n + 3 : n + 8])


def _mass(
    fit: MotionFit, m: Marginals, derivative: AxesDerivative, determined: IdentifiabilityAnalysis
) -> MassProperties:
    known, n = determined.record, fit.iterate.n_states
    cov_com, cov_J = m.dense[n : n + 3, n : n + 3], _cov_J(fit, m)
    moments, R_GP = derivative.moments, derivative.R_GP
    cov_axes = derivative.axes @ cov_J @ derivative.axes.T
    cov_axes += nonlinear_turns(derivative, cov_J, np.zeros((1, 3)), ~known.axes_P)[0, :3, :3]
    com_lost: Bools = np.abs(R_GP[:, ~known.com_P]).max(axis=1, initial=0.0) > 0.1
    return MassProperties(
        J_G=R_GP @ np.diag(moments) @ R_GP.T,
        moments=moments,
        k1=float(np.log(moments[0] / moments[1])),
        k2=float(np.log(moments[1] / moments[2])),
        cov_k=with_infinite(ratio_covariance(derivative, cov_J), ~np.array([known.k1, known.k2])),
        cov_J=with_infinite(cov_J, determined.lost_constants[XI]),
        R_GP=R_GP,
        cov_R_GP=with_infinite(free_axis_covariance(cov_axes, ~known.axes_P), ~known.axes_P),
        com_G=fit.iterate.com_G,
        cov_com_G=with_infinite(cov_com, com_lost),
        identifiable=known,
        J_by_xi=derivative.of_inertia,
    )


def reduced_chi2(fit: MotionFit, s: Array) -> float:
    """Squares of the stereo residuals, s (M,), and of the dynamics, over the degrees of freedom.

    The errors of the camera's pose are unknowns with one pseudo-measurement each: they use no freedom.
    """
    solver, fixed, x = GaussNewton(fit.data), fit.linearized(), fit.iterate.vector()
    cost = solver.dynamics_cost(fixed, x) + solver.camera_cost(fixed, x)
    n_frames, n_landmarks = fit.data.n_frames, fit.data.n_landmarks
    # six of the unknowns only choose the frame G
    freedom = 3 * len(s) + 12 * (n_frames - 1) + 6 - 12 * n_frames - 8 - 3 * n_landmarks
    return float((s.sum() + 2.0 * cost) / max(freedom, 1))


def _warnings(
    tracks: StereoTracks, weight: Array, known: Identifiability, initial: InitialMotion
) -> list[str]:
    out = []
    lost = [name for name, text in known.detail.items() if text.startswith("not")]
    if lost:
        out.append(f"the motion does not determine: {', '.join(lost)}")
    outliers = float(np.mean(weight == 0.0))
    if outliers > 0.3:
        out.append(
            f"{outliers:.0%} of the observations contradict the motion and were left out ({FAST_HINT})"
        )
    n_empty = len(np.setdiff1d(np.arange(tracks.n_frames), tracks.frame))
    if n_empty:
        frames, were = ("frame", "was") if n_empty == 1 else ("frames", "were")
        out.append(f"{n_empty} {frames} without measurements {were} bridged by the dynamics")
    loose = int(np.sum(~initial.connected)) - n_empty
    if loose > 0:
        out.append(f"{loose} frames could not be connected at first and started from interpolated poses")
    once = int(np.sum(np.bincount(tracks.landmark) == 1))
    if once:
        out.append(f"{once} landmarks were seen only once: each is where that one stereo pair puts it")
    return out
