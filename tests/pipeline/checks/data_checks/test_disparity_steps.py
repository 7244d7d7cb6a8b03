"""Steps of all disparities: found with their size, and not where something else is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.pipeline.checks.data_checks.disparity_steps import (
    disparity_change,
    disparity_steps,
    offset_jacobian,
    offset_residual,
)
from polhode.records.tracks import StereoTracks
from polhode.simulation.monte_carlo import SyntheticScene, generate

FRAMES, SIGMA_PX = 24, (0.2, 0.1)
SCENE = SyntheticScene(
    frames=FRAMES, landmarks=150, detection=0.8, sigma_uv_px=0.2, sigma_d_px=0.1,
    J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.3, 0.5, 0.3),
)  # fmt: skip


@pytest.fixture(scope="module")
def tracks() -> StereoTracks:
    return generate(SCENE, 3).tracks


def steps_of(tracks: StereoTracks, change_px: Array | float = 0.0) -> tuple[Array, Array]:
    """Where disparities are changed by (M,)."""
    return disparity_steps(replace(tracks, uvd_px=tracks.uvd_px + np.outer(change_px, [0, 0, 1])), SIGMA_PX)


def test_the_derivative_is_that_of_the_residual(tracks: StereoTracks) -> None:
    rig, uvd = tracks.rig, tracks.uvd_px[:4]
    p_A = rig.triangulate(uvd)
    X_BA = make_pose(exp_so3([0.1, -0.2, 0.15]), np.array([0.02, 0.01, 0.03]))

    def residual(step: Array) -> Array:
        R = exp_so3(step[3:6])
        X = make_pose(R @ X_BA[:3, :3], R @ X_BA[:3, 3] + step[:3])
        return np.asarray(offset_residual(rig, X, 0.3 + step[6], p_A, uvd)).ravel()

    numeric = approx_fprime(np.zeros(7), residual, 1e-7)
    np.testing.assert_allclose(offset_jacobian(rig, X_BA, p_A).reshape(-1, 7), numeric, rtol=1e-4, atol=1e-3)


def test_an_offset_between_two_views_is_found_within_its_sigma(tracks: StereoTracks) -> None:
    rig, rng = tracks.rig, np.random.default_rng(2)
    sigma = np.array([0.2, 0.2, 0.1])
    scores = []
    for _ in range(40):
        p_A = np.array([0.0, 0.0, 1.0]) + 0.15 * rng.uniform(-1.0, 1.0, (60, 3))
        p_B = p_A @ exp_so3([0.02, 0.1, -0.05]).T + [-0.1, 0.0, 0.01]
        seen = [rig.project(p) + sigma * rng.standard_normal(p.shape) for p in (p_A, p_B)]
        # six points that moved by themselves
        seen[1][:6] += 15.0
        found = disparity_change(rig, seen[0], seen[1] + [0.0, 0.0, 0.8], sigma)
        assert found is not None
        scores.append((found[0] - 0.8) / found[1])
    assert abs(np.mean(scores)) < 0.6 and 0.7 < np.std(scores) < 1.4


@pytest.mark.parametrize("at", [3, 12, 21])
def test_a_step_is_found_where_it_is(tracks: StereoTracks, at: int) -> None:
    steps, sigma = steps_of(tracks, np.where(tracks.frame >= at, 0.8, 0.0))
    place = int(np.nanargmax(np.abs(steps)))
    assert place == at - 1 and steps[place] == pytest.approx(0.8, abs=0.15)
    assert steps[place] > 5.5 * sigma[place]


def test_a_step_in_a_gap_is_found(tracks: StereoTracks) -> None:
    rows = np.flatnonzero((tracks.frame < 8) | (tracks.frame > 14))
    landmark = np.unique(tracks.landmark[rows], return_inverse=True)[1]
    parts = {name: getattr(tracks, name)[rows] for name in ("frame", "uvd_px", "sigma_px")}
    gap = replace(tracks, landmark=landmark, **parts)
    steps, sigma = steps_of(gap, np.where(gap.frame >= 12, 1.5, 0.0))
    place = int(np.nanargmax(np.abs(steps)))
    assert 7 <= place <= 14 and steps[place] > 5.5 * sigma[place]


def test_without_a_step_with_one_bad_frame_or_nothing_in_common_nothing_is_significant(
    tracks: StereoTracks,
) -> None:
    steps, sigma = steps_of(tracks)
    assert np.isfinite(steps).all() and (np.abs(steps) < 4.0 * sigma).all()
    steps, sigma = steps_of(tracks, np.where(tracks.frame == 12, 0.8, 0.0))
    assert (np.abs(steps) < 5.0 * sigma).all()
    steps, sigma = steps_of(replace(tracks, landmark=np.arange(len(tracks.landmark))))
    assert np.isnan(steps).all() and np.isnan(sigma).all()
