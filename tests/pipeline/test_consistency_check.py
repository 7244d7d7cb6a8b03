"""Associations made with the motion stay only when they fit as well as blind ones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import exp_so3, make_pose
from polhode.pipeline.consistency_check import attitude_difference_deg, contradicts_first_method, fits_worse
from polhode.records.estimate import MotionEstimate
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(frames=14, landmarks=300, detection=0.4, J_G=np.diag([1.5, 1.2, 0.9]))


@cache
def solved(wrong: float = 0.0, noise_px: float = 1.0) -> MotionEstimate:
    """The motion when a share of the associations is wrong, or all are noisier."""
    config = Backend(solver="gauss_newton", process_noise="given")
    sequence = generate(replace(SCENE, outliers=wrong, sigma_uv_px=noise_px), 2)
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return estimate_motion(sequence.tracks, initial, config, Silent())


@pytest.mark.parametrize(("wrong", "noise_px"), [(0.15, 1.0), (0.0, 1.4)])
def test_a_worse_fit_is_seen(wrong: float, noise_px: float) -> None:
    assert fits_worse(solved(wrong, noise_px), solved())


def test_as_good_a_fit_is_kept() -> None:
    assert not fits_worse(solved(0.0, 1.04), solved())
    assert not fits_worse(solved(), solved(0.15))


def test_what_does_not_converge_is_refused_unless_nothing_did() -> None:
    def unfinished() -> MotionEstimate:
        return replace(solved(), solver=replace(solved().solver, converged=False))

    assert solved().solver.converged
    assert fits_worse(unfinished(), solved())
    assert not fits_worse(unfinished(), unfinished())


def _turned(
    estimate: MotionEstimate, frames: np.ndarray[tuple[int], np.dtype[np.int64]], angle_deg: float
) -> MotionEstimate:
    """Some frames turned about the camera's axis, and all of them in another body frame."""
    X_NG = estimate.X_NG @ make_pose(exp_so3(np.array([0.3, -0.8, 1.1])), np.array([0.1, 0.0, 0.0]))
    about_z = exp_so3(np.array([0.0, 0.0, np.deg2rad(angle_deg)]))
    X_NG[frames, :3, :3] = about_z @ X_NG[frames, :3, :3]
    return replace(estimate, X_NG=X_NG)


def test_another_motion_is_a_revision_and_another_body_frame_is_none() -> None:
    tracks = generate(replace(SCENE, outliers=0.0, sigma_uv_px=1.0), 2).tracks
    every = np.ones(SCENE.frames, dtype=np.bool_)
    same = _turned(solved(), np.arange(0), 0.0)
    assert attitude_difference_deg(same, solved(), every) < 1e-6
    assert not contradicts_first_method((tracks, same), (tracks, solved()), every)
    # half of the frames turned by 8 degrees against the others: by 4 against the turn that fits best
    other = _turned(solved(), np.arange(SCENE.frames // 2), 8.0)
    np.testing.assert_allclose(attitude_difference_deg(other, solved(), every), 4.0, atol=1e-2)
    assert contradicts_first_method((tracks, other), (tracks, solved()), every)
    # frames that the first method did not see are the second one's own affair
    assert not contradicts_first_method(
        (tracks, other), (tracks, solved()), np.arange(SCENE.frames) >= SCENE.frames // 2
    )


def test_places_of_the_first_method_must_fit_as_well() -> None:
    tracks = generate(replace(SCENE, outliers=0.0, sigma_uv_px=1.0), 2).tracks
    every = np.ones(SCENE.frames, dtype=np.bool_)
    worse = replace(solved(), residuals_px=1.2 * solved().residuals_px)
    assert contradicts_first_method((tracks, worse), (tracks, solved()), every)
    # what only the second method sees has no place with the first one
    elsewhere = replace(tracks, uvd_px=tracks.uvd_px + 3.0)
    assert not contradicts_first_method((elsewhere, worse), (tracks, solved()), every)
