"""A camera that moves, with stated poses that are noisy: errors as large as the covariance says."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.problem.inertia import FORMS, second_moments_from_inertia
from polhode.config.backend_settings import Backend
from polhode.lie import Array, log_so3
from polhode.progress import Silent
from polhode.records import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

SCENE = SyntheticScene(
    frames=40, landmarks=300, detection=0.4, w_G=(0.4, 0.5, 0.45), J_G=np.diag([1.5, 1.2, 0.9]),
    camera_moves=True, sigma_camera_p_m=5e-4, sigma_camera_theta_rad=3.5e-4, accel_psd=1e-8, torque_psd=1e-8,
)  # fmt: skip
KNOWN = Backend(solver="gauss_newton", process_noise="given", accel_psd=1e-8, torque_psd=1e-8)
HALF_TURNS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)


def run(sequence: SyntheticSequence) -> MotionEstimate:
    initial = initialize_motion(sequence.tracks, sequence.relative, KNOWN)
    return estimate_motion(sequence.tracks, initial, KNOWN, Silent())


def nees(error: Array, covariance: Array) -> float:
    """Normalised squared errors (n, m) per degree of freedom, expected 1."""
    squares = [e @ np.linalg.solve(C, e) for e, C in zip(error, covariance, strict=True)]
    return float(np.mean(squares) / error.shape[1])


def consistency(sequence: SyntheticSequence, estimate: MotionEstimate) -> list[float]:
    """NEES of position, velocity, attitude, rate, centre of mass and inertia."""
    truth, mass = sequence.truth, estimate.mass
    turns = [log_so3(np.swapaxes(estimate.R_NP, 1, 2) @ truth.R_NP @ np.diag(h)) for h in HALF_TURNS]
    best = int(np.argmin([np.linalg.norm(t) for t in turns]))
    errors = [truth.r_N - estimate.r_N, truth.v_N - estimate.v_N, turns[best]]
    errors.append(truth.w_P * HALF_TURNS[best] - estimate.w_P)
    out = [
        nees(e, estimate.covariance[:, 3 * n : 3 * n + 3, 3 * n : 3 * n + 3]) for n, e in enumerate(errors)
    ]
    # G is where the estimate has it at the first frame
    R_NG = estimate.R_NP[0] @ mass.R_GP.T
    com = R_NG.T @ (estimate.r_N[0] - truth.r_N[0])
    R_GP = R_NG.T @ truth.R_NP[0]
    form = FORMS["second_moments"]
    xi = [form.coordinates(second_moments_from_inertia(J))[0]
          for J in (mass.J_G, R_GP @ np.diag(truth.moments) @ R_GP.T)]  # fmt: skip
    return [*out, nees(com[None], mass.cov_com_G[None]), nees((xi[0] - xi[1])[None], mass.cov_J[None])]


def test_errors_are_as_large_as_the_covariance_says() -> None:
    values = np.array(
        [consistency(sequence, run(sequence)) for sequence in (generate(SCENE, s) for s in range(8))]
    )
    # 24 and 40 degrees of freedom for the constants; the states of a sequence are correlated
    assert np.all((values.mean(axis=0) > 0.5) & (values.mean(axis=0) < 1.6)), values.mean(axis=0)


def test_noise_of_centimetres_and_tenths_of_degrees_is_smoothed_by_the_dynamics() -> None:
    loud = replace(SCENE, frames=60, sigma_camera_p_m=5e-3, sigma_camera_theta_rad=5e-3)
    sequence = generate(loud, 3)
    estimate = run(sequence)
    # the camera alone leaves this much on each axis across the line of sight
    alone_m = np.hypot(loud.sigma_camera_p_m, loud.sigma_camera_theta_rad * loud.r_N[2])
    error_m = np.sqrt(np.mean((estimate.r_N - sequence.truth.r_N) ** 2))
    assert error_m < 0.35 * alone_m
    assert np.sqrt(np.mean(np.diagonal(estimate.covariance, axis1=1, axis2=2)[:, :3])) < 0.35 * alone_m
    assert abs(estimate.mass.k1 - sequence.truth.k1) < 4.0 * np.sqrt(estimate.mass.cov_k[0, 0]) < 0.02


def test_the_noise_lies_where_it_was_put() -> None:
    sequence = generate(replace(SCENE, sigma_camera_p_m=5e-3, sigma_camera_theta_rad=0.0), 1)
    estimate = run(sequence)
    # the poses seen from the stated camera differ from the true ones by that noise
    seen = estimate.X_NG[:, :3, 3] + np.einsum("fij,j->fi", estimate.X_NG[:, :3, :3], estimate.mass.com_G)
    noise = np.linalg.norm(seen - estimate.r_N, axis=1) / np.sqrt(3.0)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(5e-3, rel=0.2)
    R_seen = estimate.X_NG[:, :3, :3] @ estimate.mass.R_GP
    assert np.abs(log_so3(np.swapaxes(R_seen, 1, 2) @ estimate.R_NP)).max() < 1e-6
