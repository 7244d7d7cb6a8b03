"""Corridor, speeds of the surface and path: closed forms of a pure spin, differences, what it looks at."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3, make_pose
from polhode.planning.approach.corridor import ApproachPath, along_corridor, corridor, towards_centre
from polhode.planning.approach.surface_speed import (
    slowest_points,
    surface_speed,
    velocity_covariance,
)
from polhode.planning.prediction import (
    BodyMotion,
    PredictedMotion,
    nominal_motion,
    predict,
    propagate_members,
)
from tests.planning.bodies import estimate

SPIN = 0.4
TIMES = np.linspace(0.0, 12.0, 481)


def test_a_pure_spin_needs_the_centripetal_acceleration_alone() -> None:
    motion = nominal_motion(estimate((0.0, 0.0, SPIN), (0.01, 0.0, 0.0)), TIMES)
    found = corridor(motion, np.array([0.1, 0.0, 0.05]), np.array([2.0, 0.0, 0.0]), 0.5)
    size = np.linalg.norm(found.acceleration_N, axis=1)
    np.testing.assert_allclose(size, SPIN**2 * 0.6, rtol=1e-7)
    assert found.delta_v_m_s == pytest.approx(SPIN**2 * 0.6 * 12.0, rel=1e-7)
    # towards the axis: against the lever's part across it
    axis_N = motion.w_N / SPIN
    lever = found.place_N - motion.com_N
    across = lever - np.sum(lever * axis_N, axis=1, keepdims=True) * axis_N
    np.testing.assert_allclose(found.acceleration_N, -(SPIN**2) * across, atol=1e-9)


def test_a_tumble_needs_what_differences_of_the_place_say() -> None:
    motion = nominal_motion(estimate((0.1, 0.5, 0.3), (0.01, 0.0, 0.0), com_G=(0.02, 0.01, 0.0)), TIMES)
    found = corridor(motion, np.array([0.1, 0.0, 0.05]), np.array([1.0, 1.0, 0.0]), 0.3)
    dt = TIMES[1]
    second = (found.place_N[2:] - 2.0 * found.place_N[1:-1] + found.place_N[:-2]) / dt**2
    np.testing.assert_allclose(found.acceleration_N[1:-1], second, atol=2e-5)
    np.testing.assert_allclose(
        found.velocity_N[1:-1], (found.place_N[2:] - found.place_N[:-2]) / (2 * dt), atol=1e-5
    )
    # the Euler term counts here
    assert np.abs(np.cross(motion.w_dot_N, found.place_N - motion.com_N)).max() > 0.01


def test_speeds_of_a_pure_spin_grow_with_the_distance_from_the_axis() -> None:
    target = estimate((0.0, 0.0, SPIN), com_G=(0.02, 0.0, 0.0))
    p = np.array([[0.02, 0.0, 0.3], [0.12, 0.0, 0.0], [0.02, 0.2, -0.1]])
    normal = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    motion = nominal_motion(target, TIMES)
    found = surface_speed(motion, p, normal, target.last.covariance)
    expected = SPIN * np.array([0.0, 0.1, 0.2])
    for speed in (found.now_m_s, found.mean_m_s, found.largest_m_s):
        np.testing.assert_allclose(speed, expected, atol=1e-9)
    # w x lever: +y at +x, -x at +y
    np.testing.assert_allclose(found.normal_m_s, [0.0, SPIN * 0.1, -SPIN * 0.2], atol=1e-9)
    assert slowest_points(found.now_m_s, p, 0.05, 2) == [0, 1]
    assert slowest_points(found.now_m_s, p, 0.32, 3) == [0, 2]


def test_the_sigma_of_a_speed_is_what_draws_scatter() -> None:
    # fast enough that the attitude matters beside the rate
    target = estimate((0.1, 0.5, 0.3), (0.2, 0.0, 0.0), com_G=(0.02, 0.01, 0.0))
    p, last = np.array([[0.15, 0.05, -0.1]]), target.last
    found = surface_speed(nominal_motion(target, TIMES), p, np.array([[1.0, 0.0, 0.0]]), last.covariance)
    d = np.random.default_rng(1).multivariate_normal(np.zeros(20), last.covariance, 20_000)
    swing_G = np.cross(last.w_G + d[:, 9:12], p - target.com_G - d[:, 17:20])
    u = last.v_N + d[:, 3:6] + np.einsum("nij,nj->ni", last.R_NG @ exp_so3(d[:, 6:9]), swing_G)
    assert np.linalg.norm(u, axis=1).std() == pytest.approx(found.sigma_m_s[0], rel=0.03)


def test_the_covariance_of_velocities_is_that_of_states_drawn_and_propagated() -> None:
    """With everything correlated, at the last pair and later, also of the point at the centre of mass."""
    target = estimate((0.1, 0.5, 0.3), (0.05, 0.0, 0.0), com_G=(0.02, 0.01, 0.0))
    mixed = np.eye(20) + 0.3 * np.random.default_rng(2).normal(size=(20, 20))
    root = np.sqrt(np.diag(target.last.covariance))[:, None] * mixed
    last = replace(target.last, covariance=root @ root.T, R_GP=np.eye(3)[:, [1, 2, 0]])
    p_G, times = np.array([[0.15, 0.05, -0.1], target.com_G, [0.0, 0.8, 0.0]]), np.array([0.0, 2.0, 6.0])
    given: dict[str, Any] = vars(predict(last, times, 0.0, 0.0)) | {"undetermined": ()}
    motion = PredictedMotion(**given, timestamps_ns=np.arange(3), R_GP=last.R_GP, com_G=target.com_G)
    found = velocity_covariance(motion, (p_G - target.com_G) @ last.R_GP), motion.points_covariance(p_G)
    d = np.random.default_rng(3).normal(size=(20_000, 20)) @ root.T
    J = last.J_G + np.einsum("nk,kij->nij", d[:, 12:17], last.J_jacobian)
    R, w = propagate_members(last, d, J, times)
    lever = p_G[:, None] - target.com_G - d[:, 17:20]
    for k in range(len(times)):
        for n in range(len(p_G)):
            velocity = d[:, 3:6] + np.einsum("mij,mj->mi", R[k], np.cross(w[k], lever[n]))
            place = d[:, 0:3] + times[k] * d[:, 3:6] + np.einsum("mij,mj->mi", R[k], lever[n])
            for covariance, drawn in zip(found, (velocity, place), strict=True):
                expected = np.cov(drawn.T)
                sigma = np.sqrt(np.diag(expected))
                # 20,000 draws: an element scatters by at most 1 % of the two sigmas
                np.testing.assert_allclose(
                    covariance[k, n] / sigma / sigma[:, None], expected / sigma / sigma[:, None], atol=0.04
                )
    # disturbances make velocities less certain with time
    still, later = estimate((0.1, 0.5, 0.3), size=0.0).last, np.array([1.0, 4.0])
    alone = velocity_covariance(predict(still, later, 1e-6, 0.0), np.array([[0.1, 0.0, 0.0]]))
    np.testing.assert_allclose(alone[:, 0], later[:, None, None] * 1e-6 * np.eye(3), atol=1e-12)


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
    # a camera that is near keeps its distance
    near = towards_centre(MOTION, CAMERA, 5.0)
    np.testing.assert_allclose(near.distance_m, np.linalg.norm(CAMERA[:3, 3] - COM_N[0]))
    # the image stays upright: y of the camera as before
    assert (path.X_NR[:, :3, 1] @ CAMERA[:3, 1] > 0.9).all()


@pytest.mark.parametrize("axis_G", [[0.0, 1.0, 0.0], [0.0, 0.0, -2.0], [1.0, 1.0, 1.0]])
def test_along_a_corridor_it_turns_with_the_target(axis_G: list[float]) -> None:
    point_G = np.array([0.1, 0.0, 0.02])
    cone = corridor(MOTION, point_G, np.array(axis_G), 0.25)
    path = along_corridor(MOTION, cone, CAMERA, 0.25)
    require_looking_at(path, cone.tip_N)
    assert path.distance_m[-1] == pytest.approx(0.25)
    assert path.distance_m[0] == pytest.approx(np.linalg.norm(CAMERA[:3, 3] - cone.tip_N[0]))
    along = np.cross(path.X_NR[:, :3, 3] - cone.tip_N, cone.axis_N)
    np.testing.assert_allclose(along, 0.0, atol=1e-12)
    # in G the camera moves on a line and does not rotate
    R_GR = np.swapaxes(R_NG, 1, 2) @ path.X_NR[:, :3, :3]
    np.testing.assert_allclose(R_GR, np.tile(R_GR[0], (len(T), 1, 1)), atol=1e-12)
