"""A camera that moves, with stated poses that are noisy: errors as large as the covariance says."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.geometry.lie import log_so3
from polhode.records.estimate import MotionEstimate
from polhode.simulation.monte_carlo import SyntheticSequence, generate
from tests.backend.motions import QUIET, TUMBLE, estimated, nees, state_errors, xi_of

SCENE = replace(
    TUMBLE, camera_moves=True, sigma_camera_p_m=5e-4, sigma_camera_theta_rad=3.5e-4, accel_psd=1e-8,
    torque_psd=1e-8,
)  # fmt: skip


def consistency(sequence: SyntheticSequence, estimate: MotionEstimate) -> list[float]:
    """NEES of position, velocity, attitude, rate, centre of mass and inertia."""
    truth, mass, errors = sequence.truth, estimate.mass, state_errors(sequence, estimate)
    parts = [slice(n, n + 3) for n in range(0, 12, 3)]
    out = [nees(errors[:, at], estimate.covariance[:, at, at]) for at in parts]
    # G is where the estimate has it at the first frame
    R_NG = estimate.R_NP[0] @ mass.R_GP.T
    com = R_NG.T @ (estimate.r_N[0] - truth.r_N[0])
    R_GP = R_NG.T @ truth.R_NP[0]
    off = xi_of(mass.J_G) - xi_of(R_GP @ np.diag(truth.moments) @ R_GP.T)
    return [*out, nees(com[None], mass.cov_com_G[None]), nees(off[None], mass.cov_J[None])]


def test_errors_are_as_large_as_the_covariance_says() -> None:
    sequences = [generate(SCENE, seed) for seed in range(8)]
    values = np.array([consistency(each, estimated(each, QUIET)) for each in sequences])
    # 24 and 40 degrees of freedom for the constants; the states of a sequence are correlated
    assert np.all((values.mean(axis=0) > 0.5) & (values.mean(axis=0) < 1.6)), values.mean(axis=0)


def test_the_noise_lies_where_it_was_put() -> None:
    sequence = generate(replace(SCENE, sigma_camera_p_m=5e-3, sigma_camera_theta_rad=0.0), 1)
    estimate = estimated(sequence, QUIET)
    # the poses seen from the stated camera differ from the true ones by that noise
    seen = estimate.X_NG[:, :3, 3] + np.einsum("fij,j->fi", estimate.X_NG[:, :3, :3], estimate.mass.com_G)
    noise = np.linalg.norm(seen - estimate.r_N, axis=1) / np.sqrt(3.0)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(5e-3, rel=0.2)
    R_seen = estimate.X_NG[:, :3, :3] @ estimate.mass.R_GP
    assert np.abs(log_so3(np.swapaxes(R_seen, 1, 2) @ estimate.R_NP)).max() < 1e-6
