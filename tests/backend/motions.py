"""Synthetic motions, their estimates and errors, for the tests of the back end."""

from dataclasses import replace

import numpy as np

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.initialization.multistart import initial_guesses, try_hypotheses
from polhode.backend.problem.inertia import FORMS, second_moments_from_inertia
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.config.backend_settings import Backend
from polhode.frontend.calibration_effects import calibration_effects
from polhode.frontend.rectification import make_rectifier
from polhode.geometry.lie import Array, inverse_pose, log_so3, make_pose, transform_points
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.estimate import MotionEstimate
from polhode.records.rig_calibration import StereoCalibration
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence

BOX = np.diag([1.5, 1.2, 0.9])
TUMBLE = SyntheticScene(frames=40, landmarks=300, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=BOX)
FAST = Backend(solver="gauss_newton")
QUIET = Backend(solver="gauss_newton", process_noise="given", accel_psd=1e-8, torque_psd=1e-8)


def estimated(sequence: SyntheticSequence, config: Backend = FAST) -> MotionEstimate:
    """From a cold start."""
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return estimate_motion(sequence.tracks, initial, config, Silent())


def half_turn(sequence: SyntheticSequence, estimate: MotionEstimate) -> tuple[Array, Array]:
    """The half-turn of the axes that fits best (3,), and the errors of the attitude (F, 3) after it."""
    R_NP = np.swapaxes(estimate.R_NP, 1, 2) @ sequence.truth.R_NP
    turns = [log_so3(R_NP @ np.diag(h)) for h in HALF_TURNS]
    best = int(np.argmin([np.linalg.norm(t) for t in turns]))
    return HALF_TURNS[best], turns[best]


def state_errors(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """Truth minus estimate (F, 12) in the order and frames of the covariance, half-turn resolved."""
    truth, (turn, theta) = sequence.truth, half_turn(sequence, estimate)
    errors = [truth.r_N - estimate.r_N, truth.v_N - estimate.v_N, theta, truth.w_P * turn - estimate.w_P]
    return np.concatenate(errors, axis=1)


def sigmas(covariance: Array) -> Array:
    """Standard deviations (F, n)."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def deviations(sequence: SyntheticSequence, estimate: MotionEstimate) -> Array:
    """(F, 12) errors of the states over their sigmas."""
    return state_errors(sequence, estimate) / sigmas(estimate.covariance)


def nees(errors: Array, covariance: Array) -> float:
    """Mean normalised square of errors (n, m) per degree of freedom, expected 1."""
    squares = [e @ np.linalg.solve(C, e) for e, C in zip(errors, covariance, strict=True)]
    return float(np.mean(squares) / errors.shape[1])


def at_truth(sequence: SyntheticSequence, config: Backend | None = None) -> MotionFit:
    """The problem at the truth."""
    data, truth = motion_data(sequence.tracks, config or Backend()), sequence.truth
    J_G = truth.R_GP @ np.diag(truth.moments) @ truth.R_GP.T
    xi, R_inertia = data.form.coordinates(second_moments_from_inertia(J_G, 0.0))
    X, w_G = sequence.X_NG, truth.w_P @ truth.R_GP.T
    camera = np.zeros((len(X), 6)) if data.camera_is_noisy else None
    states = X[:, :3, 3], X[:, :3, :3], truth.v_N, w_G
    return MotionFit(data, Iterate(*states, truth.com_G, xi, R_inertia, sequence.p_G, camera))


def calibrated(sequence: SyntheticSequence) -> SyntheticSequence:
    """The sequence with the default sigmas of its rig's calibration."""
    rig = sequence.tracks.rig
    X_BC1 = make_pose(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
    size_px, none = (rig.width_px, rig.height_px), np.zeros(4)
    calibration = StereoCalibration(rig.K, rig.K, none, none, np.eye(4), X_BC1, *size_px)
    effects = calibration_effects(calibration, make_rectifier(calibration), poses_stated=False)
    return replace(sequence, tracks=replace(sequence.tracks, calibration=effects))


def with_errors(sequence: SyntheticSequence, seed: int, size: float = 1.0) -> tuple[SyntheticSequence, Array]:
    """A calibrated sequence with errors drawn from these sigmas, times a size; the draw (c,)."""
    tracks, effects = sequence.tracks, sequence.tracks.calibration
    assert effects is not None
    z = np.random.default_rng([seed, 9]).normal(0.0, size, int(effects.left.shape[2]))
    X_RG = inverse_pose(sequence.X_NR) @ sequence.X_NG
    p_R = transform_points(X_RG[tracks.frame], sequence.p_G[tracks.landmark][:, None])[:, 0]
    uvd_px = tracks.uvd_px + effects.at(tracks.rig, p_R) @ z
    return replace(sequence, tracks=replace(tracks, uvd_px=uvd_px)), z


def cold_start(sequence: SyntheticSequence, config: Backend) -> MotionFit:
    """A problem where the back end starts, with the inertia of a sphere."""
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    data = motion_data(sequence.tracks, config)
    return MotionFit(data, initial_guesses(sequence.tracks, initial, data)[0].iterate)


def best_hypothesis(sequence: SyntheticSequence, config: Backend) -> MotionFit:
    """A problem near its optimum, by brief solves."""
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    data = motion_data(sequence.tracks, config)
    trials = try_hypotheses(data, initial_guesses(sequence.tracks, initial, data), lambda: None)
    return MotionFit(data, min(trials.values(), key=lambda trial: trial.cost).iterate)


def xi_of(J_G: Array) -> Array:
    """Coordinates (5,) of an inertia in the default form."""
    return FORMS["second_moments"].coordinates(second_moments_from_inertia(J_G))[0]
