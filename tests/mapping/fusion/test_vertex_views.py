"""Sums over the frames that saw each vertex: weights, sides, and what frames have in common."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.mapping.fusion.depth_frame import FrameTensors, frame_tensors
from polhode.mapping.fusion.vertex_views import FADING_RAD, VertexViews, views_of_vertices
from tests.mapping.analytic_depth import DISTANCE_M, RIG, depth_of

VOXEL_M, SIGMA_M = 3e-3, 1e-3
CUT_M = (4 * VOXEL_M, 3 * VOXEL_M)
POINT, UP = np.array([[0.0, 0.0, 0.002]]), np.array([[0.0, 0.0, 1.0]])
"""On the upper side of a plate 4 mm thick."""


def seen_from(turn_rad: float) -> tuple[FrameTensors, Array]:
    """The plate from a direction that differs from its normal by an angle, without noise."""
    plate = trimesh.creation.box((0.3, 0.3, 0.004))
    X = make_pose(exp_so3([np.pi + turn_rad, 0.0, 0.0]), [0.0, 0.0, DISTANCE_M])
    depth = depth_of(plate, X, 0.0, np.random.default_rng(0))
    seen = np.isfinite(depth.depth_m)
    depth.sigma_m[seen] = SIGMA_M
    tensors = frame_tensors(depth, RIG)
    assert tensors is not None
    return tensors, X


def views(*turns_rad: float, offset_m: float = 0.0) -> VertexViews:
    frames = [seen_from(turn) for turn in turns_rad]
    return views_of_vertices(frames, RIG, POINT + offset_m * UP, UP, CUT_M, VOXEL_M)


def test_frames_tell_how_far_a_vertex_is_off_and_from_which_side() -> None:
    found = views(0.0, 0.3, offset_m=1e-3)
    assert found.front_m[0] == pytest.approx(1e-3, abs=1e-4)
    assert found.front_weight[0] == pytest.approx(found.weight[0])
    assert found.back_share[0] == 0.0
    # a frame on the other side sees it from behind
    found = views(0.0, np.pi)
    assert 0.2 < found.back_share[0] < 0.6
    assert found.front_m[0] == pytest.approx(0.0, abs=1e-4)
    # where no frame saw a vertex nothing is known
    for found in (views(0.0, offset_m=0.1), views_of_vertices([], RIG, POINT, UP, CUT_M, VOXEL_M)):
        assert found.weight[0] == 0.0 and np.isinf(found.shared_m[0]) and found.back_share[0] == 0.0


def test_frames_that_disagree_about_a_vertex_have_a_large_chi_square() -> None:
    alike = views(0.0, 0.0, 0.0)
    assert alike.front_count[0] == 3.0 and alike.front_chi2[0] < 1e-6
    # the same depth from one frame that is moved by two of its sigmas
    frames = [seen_from(0.0), seen_from(0.0)]
    shift = make_pose(np.eye(3), [0.0, 0.0, 2.0 * SIGMA_M])
    frames[1] = (frames[1][0], shift @ frames[1][1])
    found = views_of_vertices(frames, RIG, POINT, UP, CUT_M, VOXEL_M)
    assert found.front_chi2[0] == pytest.approx(2.0, rel=0.05)


def test_errors_of_frames_in_the_same_direction_do_not_average_out() -> None:
    one, same, apart = views(0.2), views(0.2, 0.2, 0.2, 0.2), views(-1.0, 1.0)
    assert one.shared_m[0] == pytest.approx(one.weight[0] ** -0.5, rel=1e-3)
    assert same.shared_m[0] == pytest.approx(one.shared_m[0], rel=1e-3)
    correlation = np.exp(-2.0 / FADING_RAD)
    assert apart.shared_m[0] == pytest.approx(apart.weight[0] ** -0.5 * np.sqrt(1.0 + correlation), rel=0.02)
