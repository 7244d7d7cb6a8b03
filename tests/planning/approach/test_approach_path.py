"""A camera's path to the target: where it begins and ends, and that it looks where it should."""

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3, make_pose
from polhode.planning.approach.approach_path import ApproachPath, along_corridor, towards_centre
from polhode.planning.approach.corridor import corridor
from polhode.planning.prediction import BodyMotion

T = np.linspace(0.0, 20.0, 41)
W_N = np.array([0.1, 0.3, -0.2])
COM_N = np.array([0.1, -0.05, 0.9]) + T[:, None] * np.array([1e-3, 2e-3, -1e-3])
R_NG = exp_so3(T[:, None] * W_N)
COM_G = np.array([0.02, 0.0, 0.01])
MOTION = BodyMotion(
    T, R_NG, COM_N - R_NG @ COM_G, COM_N, np.tile([1e-3, 2e-3, -1e-3], (41, 1)), np.tile(W_N, (41, 1)),
    np.zeros((41, 3)),
)  # fmt: skip
CAMERA = make_pose(exp_so3([0.02, -0.01, 0.03]), np.array([0.01, 0.0, 0.02]))


def require_looking_at(path: ApproachPath, point_N: np.ndarray) -> None:
    """Rigid poses, the point on the optical axis at the stated distance."""
    R, p = path.X_NR[:, :3, :3], path.X_NR[:, :3, 3]
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    in_camera = np.einsum("kji,kj->ki", R, point_N - p)
    np.testing.assert_allclose(in_camera[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(in_camera[:, 2], path.distance_m)


def test_towards_the_centre_it_comes_from_the_camera_on_a_line_and_stops() -> None:
    path = towards_centre(MOTION, CAMERA, 0.3)
    require_looking_at(path, COM_N)
    np.testing.assert_allclose(path.X_NR[0, :3, 3], CAMERA[:3, 3])
    assert path.distance_m[-1] == pytest.approx(0.3)
    assert (np.diff(path.distance_m) < 0.0).all()
    line = (path.X_NR[:, :3, 3] - COM_N) / path.distance_m[:, None]
    np.testing.assert_allclose(line, np.tile(line[0], (len(T), 1)), atol=1e-12)
    # at rest at both ends
    speed = np.gradient(path.distance_m, T)
    assert np.abs(speed[[0, -1]]).max() < 0.1 * np.abs(speed).max()
    # the image stays upright: y of the camera as before
    assert (path.X_NR[:, :3, 1] @ CAMERA[:3, 1] > 0.9).all()


def test_a_camera_that_is_near_keeps_its_distance() -> None:
    path = towards_centre(MOTION, CAMERA, 5.0)
    np.testing.assert_allclose(path.distance_m, np.linalg.norm(CAMERA[:3, 3] - COM_N[0]))


@pytest.mark.parametrize("axis_G", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -2.0], [1.0, 1.0, 1.0]])
def test_along_a_corridor_it_turns_with_the_target(axis_G: list[float]) -> None:
    point_G = np.array([0.1, 0.0, 0.02])
    cone = corridor(MOTION, point_G, np.array(axis_G), 0.25, 0.2)
    path = along_corridor(MOTION, cone, CAMERA, 0.25)
    require_looking_at(path, cone.tip_N)
    assert path.distance_m[-1] == pytest.approx(0.25)
    assert path.distance_m[0] == pytest.approx(np.linalg.norm(CAMERA[:3, 3] - cone.tip_N[0]))
    assert cone.contains(path.X_NR[:, :3, 3]).all()
    # in G the camera moves on a line and does not rotate
    R_GR = np.swapaxes(R_NG, 1, 2) @ path.X_NR[:, :3, :3]
    np.testing.assert_allclose(R_GR, np.tile(R_GR[0], (len(T), 1, 1)), atol=1e-12)
