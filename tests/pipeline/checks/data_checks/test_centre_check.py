"""The centre of mass from poses alone: exact without noise, within its sigmas with noise."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_body import propagate
from polhode.pipeline.checks.data_checks.disparity_steps import fit_view
from polhode.pipeline.checks.data_checks.mass_check import MIN_FRAMES, SeenPath, centre_change, centre_of

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)
TIME_S = 0.5 * np.arange(40.0)
EVERY = np.ones(40, dtype=np.bool_)
COM_G, MOVED_G, NONE = np.array([0.02, -0.01, 0.03]), np.array([0.004, -0.003, 0.005]), np.zeros(3)
SIGMA_M = 3e-4


def path(seed: int, moved_G: Array = NONE, accel_psd: float = 0.0, point_G: Array = COM_G) -> SeenPath:
    """A tumble whose centre of mass is another one from the middle on."""
    rng, w = np.random.default_rng(seed), np.array([0.3, 0.4, 0.2])
    R_NG = propagate(TIME_S, NONE, NONE, np.eye(3), w, np.diag([1.5, 1.2, 0.9]))[2]
    steps = np.sqrt(accel_psd * 0.5) * rng.normal(size=(40, 3))
    r_N = np.array([0.1, 0.0, 1.0]) + 0.01 * TIME_S[:, None] + np.cumsum(0.5 * np.cumsum(steps, 0), 0)
    com_G = np.where(np.arange(40)[:, None] < 20, COM_G, COM_G + moved_G)
    p_N = r_N + np.einsum("nij,nj->ni", R_NG, point_G - com_G) + SIGMA_M * rng.normal(size=r_N.shape)
    covariance = np.tile(SIGMA_M**2 * np.eye(3), (40, 1, 1))
    return SeenPath(np.arange(40, dtype=np.int64), TIME_S, R_NG, p_N, point_G, covariance)


def test_the_centre_is_the_point_that_does_not_circle() -> None:
    for point_G in (COM_G, np.array([0.1, 0.05, 0.0])):
        whole, r_N = path(1, point_G=point_G), np.array([0.1, 0.0, 1.0]) + 0.01 * TIME_S[:, None]
        exact = replace(whole, p_N=r_N + np.einsum("nij,j->ni", whole.R_NG, point_G - COM_G))
        np.testing.assert_allclose(centre_of(exact, EVERY).com_G, COM_G, atol=1e-7)


@pytest.mark.parametrize("accel_psd", [0.0, 1e-6])
def test_errors_agree_with_their_covariance(accel_psd: float) -> None:
    found = [centre_of(path(seed, accel_psd=accel_psd), EVERY) for seed in range(40)]
    errors = [each.com_G - COM_G for each in found]
    squares = [e @ np.linalg.solve(each.cov_G, e) for e, each in zip(errors, found, strict=True)]
    # chi-squared with 120 degrees of freedom, four standard deviations
    assert abs(np.sum(squares) - 120.0) < 4.0 * np.sqrt(2.0 * 120.0)


def test_a_change_is_found_with_its_instant_and_size_and_one_body_shows_none() -> None:
    change = centre_change(path(3, MOVED_G), 15, 25)
    assert change is not None and change.first_after == 20 and change.sigmas > 10.0
    error = change.change_G - MOVED_G
    assert error @ np.linalg.solve(change.cov_G, error) < 16.0
    found = [centre_change(path(seed, accel_psd=psd), 12, 28) for seed in range(3) for psd in (0.0, 1e-5)]
    assert max(each.sigmas for each in found if each is not None) < 5.5
    # both sides need frames
    whole = path(1)
    assert centre_change(whole, 0, MIN_FRAMES - 2) is None
    assert centre_change(whole, 40 - MIN_FRAMES, 39) is None


def test_a_pose_follows_from_its_landmarks_with_its_covariance() -> None:
    rng, squares = np.random.default_rng(2), []
    X_RG = make_pose(exp_so3(np.array([0.3, -0.2, 0.5])), [0, 0, 0.8])
    sigma_px = np.array([0.2, 0.2, 0.1])
    for _ in range(40):
        p_G = 0.1 * rng.normal(size=(30, 3))
        uvd = RIG.project(transform_points(X_RG, p_G)) + sigma_px * rng.normal(size=(30, 3))
        start = X_RG @ make_pose(exp_so3(0.02 * rng.normal(size=3)), 0.01 * rng.normal(size=3))
        fitted = fit_view(RIG, start, p_G, uvd, sigma_px, with_offset=False)
        assert fitted is not None
        between = fitted.X_BA @ inverse_pose(X_RG)
        rotation = np.array([between[2, 1], between[0, 2], between[1, 0]])
        error = np.concatenate([fitted.X_BA[:3, 3] - between[:3, :3] @ X_RG[:3, 3], rotation])
        squares.append(error @ np.linalg.solve(fitted.covariance, error))
    # chi-squared with 240 degrees of freedom, four standard deviations, and what the robust weights lose
    assert abs(np.sum(squares) - 240.0) < 4.0 * np.sqrt(2.0 * 240.0)
    same = np.tile(RIG.project(X_RG[None, :3, 3]), (9, 1))
    assert fit_view(RIG, X_RG, np.zeros((9, 3)), same, sigma_px, with_offset=False) is None
