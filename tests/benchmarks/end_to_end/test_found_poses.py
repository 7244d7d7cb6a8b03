"""Poses of any method are compared up to the choice of its body frame, and of nothing else."""

import numpy as np
import pytest
import trimesh

from benchmarks.end_to_end.found_poses import FoundPoses, constant_transform, pose_errors, size_ratio
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, transform_points

X_GA = make_pose(exp_so3([0.4, -0.2, 0.7]), np.array([0.03, -0.01, 0.02]))
SURFACE = trimesh.creation.icosphere(subdivisions=3, radius=0.1)


def true_poses() -> Array:
    """X_RA (12, 4, 4) of a tumble half a metre away."""
    turns = np.linspace(0.0, 5.0, 12)[:, None] * [0.3, 1.0, -0.2]
    return np.stack([make_pose(exp_so3(turn), np.array([0.02, -0.01, 0.5])) for turn in turns])


def found(X_RG: Array, shift_m: float = 0.0) -> FoundPoses:
    """All poses, and the vertices of the surface ``shift_m`` outside of it."""
    outside = SURFACE.vertices * (1.0 + shift_m / 0.1)
    return FoundPoses(np.arange(len(X_RG)), X_RG, transform_points(X_GA, outside))


def test_another_body_frame_is_no_error() -> None:
    truth = true_poses()
    X_RG = truth @ inverse_pose(X_GA)
    np.testing.assert_allclose(constant_transform(X_RG, truth), X_GA, atol=1e-12)
    errors = pose_errors(found(X_RG), truth, SURFACE)
    assert (errors.frames, errors.points) == (12, len(SURFACE.vertices))
    assert errors.rms_position_mm == pytest.approx(0.0, abs=1e-9)
    assert errors.attitude_max_deg == pytest.approx(0.0, abs=1e-6)
    assert errors.scale_error_percent == pytest.approx(0.0, abs=1e-9)
    assert errors.point_median_mm == pytest.approx(0.0, abs=1e-9)


def test_errors_are_those_that_were_made() -> None:
    truth = true_poses()
    wrong = truth.copy()
    wrong[5, :3, 3] += [0.0, 0.0, 0.012]
    wrong[5, :3, :3] = wrong[5, :3, :3] @ exp_so3([0.0, 0.0, np.deg2rad(6.0)])
    errors = pose_errors(found(wrong @ inverse_pose(X_GA), shift_m=0.004), truth, SURFACE)
    assert errors.rms_position_mm == pytest.approx(12.0 / np.sqrt(12.0), rel=0.1)
    assert errors.attitude_max_deg == pytest.approx(6.0 * 11.0 / 12.0, rel=0.02)
    assert errors.attitude_median_deg < 1.0
    assert errors.point_median_mm == pytest.approx(4.0, abs=0.7)


def test_a_larger_world_is_a_scale_error() -> None:
    truth = true_poses()
    larger = truth.copy()
    larger[:, :3, 3] *= 1.02
    assert size_ratio(larger, truth) == pytest.approx(1.02)


def test_two_poses_are_too_few() -> None:
    truth = true_poses()
    with pytest.raises(ValueError, match="fewer than three"):
        pose_errors(found(truth[:2]), truth, SURFACE)
