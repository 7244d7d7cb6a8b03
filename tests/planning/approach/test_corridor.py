"""The corridor and the speeds of the surface against the closed forms of a pure spin, and differences."""

import numpy as np
import pytest

from polhode.planning.approach.corridor import corridor
from polhode.planning.approach.surface_speed import slowest_points, surface_speed, velocity
from polhode.planning.prediction import nominal_motion
from tests.planning.bodies import estimate

SPIN = 0.4
TIMES = np.linspace(0.0, 12.0, 481)


def test_a_pure_spin_needs_the_centripetal_acceleration_alone() -> None:
    motion = nominal_motion(estimate((0.0, 0.0, SPIN), (0.01, 0.0, 0.0)), TIMES)
    found = corridor(motion, np.array([0.1, 0.0, 0.05]), np.array([2.0, 0.0, 0.0]), 0.5, np.deg2rad(10.0))
    size = np.linalg.norm(found.acceleration_N, axis=1)
    np.testing.assert_allclose(size, SPIN**2 * 0.6, rtol=1e-7)
    assert found.delta_v_m_s == pytest.approx(SPIN**2 * 0.6 * 12.0, rel=1e-7)
    # towards the axis: against the lever's part across it
    axis_N = motion.w_N / SPIN
    lever = found.place_N - motion.com_N
    across = lever - np.sum(lever * axis_N, axis=1, keepdims=True) * axis_N
    np.testing.assert_allclose(found.acceleration_N, -(SPIN**2) * across, atol=1e-9)
    assert found.contains(found.place_N).all()
    sideways = np.cross(found.axis_N, axis_N)
    assert found.contains(found.place_N + 0.5 * np.tan(np.deg2rad(9.9)) * sideways).all()
    assert not found.contains(found.place_N + 0.5 * np.tan(np.deg2rad(10.1)) * sideways).any()


def test_a_tumble_needs_what_differences_of_the_place_say() -> None:
    motion = nominal_motion(estimate((0.1, 0.5, 0.3), (0.01, 0.0, 0.0), com_G=(0.02, 0.01, 0.0)), TIMES)
    found = corridor(motion, np.array([0.1, 0.0, 0.05]), np.array([1.0, 1.0, 0.0]), 0.3, 0.2)
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
    # an inspector that moves along with a point sees it at rest
    own = velocity(motion, 0, p[1:2])[0]
    assert surface_speed(motion, p, normal, target.last.covariance, own).now_m_s[1] == pytest.approx(0.0)


def test_the_sigma_of_a_speed_is_what_draws_scatter() -> None:
    target = estimate((0.1, 0.5, 0.3), (0.01, 0.0, 0.0), com_G=(0.02, 0.01, 0.0))
    p, last = np.array([[0.15, 0.05, -0.1]]), target.last
    found = surface_speed(nominal_motion(target, TIMES), p, np.array([[1.0, 0.0, 0.0]]), last.covariance)
    d = np.random.default_rng(1).multivariate_normal(np.zeros(20), last.covariance, 20_000)
    u = (last.v_N + d[:, 3:6]) @ last.R_NG + np.cross(last.w_G + d[:, 9:12], p - target.com_G - d[:, 17:20])
    assert np.linalg.norm(u, axis=1).std() == pytest.approx(found.sigma_m_s[0], rel=0.03)
