"""The corridor and the speeds of the surface against the closed forms of a pure spin, and differences."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.geometry.lie import Array, exp_so3
from polhode.planning.approach.corridor import corridor
from polhode.planning.approach.surface_speed import (
    slowest_points,
    surface_speed,
    velocity_covariance,
)
from polhode.planning.prediction import nominal_motion, predict, propagate_members
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


def test_a_point_at_rest_meets_the_axis_once_a_turn() -> None:
    motion = nominal_motion(estimate((0.0, 0.0, SPIN), (0.0, 0.0, 0.0)), TIMES)
    half_angle_rad = np.deg2rad(10.0)
    found = corridor(motion, np.array([0.1, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.5, half_angle_rad)
    # 2 m along the axis as it is after 6 s
    at = 240
    rests_N = found.tip_N[at] + 2.0 * found.axis_N[at]
    angle_rad = found.angle_rad(rests_N)
    assert np.argmin(angle_rad) == at and angle_rad[at] < 1e-9
    # the axis turns by SPIN dt; seen from the docking point, which moves along, by 2.1 / 2 of that
    near = found.time_s[found.contains(rests_N)]
    turned_rad = SPIN * (TIMES - TIMES[at])
    tip, rest = 0.1 * np.stack([np.cos(turned_rad), np.sin(turned_rad)], axis=1), np.array([2.1, 0.0])
    seen_rad = np.arctan2(*(rest - tip).T[::-1]) - turned_rad
    expected = TIMES[np.abs(np.angle(np.exp(1j * seen_rad))) <= half_angle_rad]
    np.testing.assert_array_equal(near, expected)
    assert 0.5 < np.ptp(near) < 1.0


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
    found = velocity_covariance(predict(last, times, 0.0, 0.0), (p_G - target.com_G) @ last.R_GP)
    d = np.random.default_rng(3).normal(size=(20_000, 20)) @ root.T
    J = last.J_G + np.einsum("nk,kij->nij", d[:, 12:17], last.J_jacobian)
    R, w = propagate_members(last, d, J, times)
    lever = p_G[:, None] - target.com_G - d[:, 17:20]
    for k in range(len(times)):
        for n in range(len(p_G)):
            drawn: Array = last.v_N + d[:, 3:6] + np.einsum("mij,mj->mi", R[k], np.cross(w[k], lever[n]))
            expected = np.cov(drawn.T)
            sigma = np.sqrt(np.diag(expected))
            # 20,000 draws: an element scatters by at most 1 % of the two sigmas
            np.testing.assert_allclose(
                found[k, n] / sigma / sigma[:, None], expected / sigma / sigma[:, None], atol=0.04
            )


def test_disturbances_make_velocities_less_certain_with_time() -> None:
    target, times = estimate((0.1, 0.5, 0.3), size=0.0), np.array([1.0, 4.0])
    found = velocity_covariance(predict(target.last, times, 1e-6, 0.0), np.array([[0.1, 0.0, 0.0]]))
    np.testing.assert_allclose(found[:, 0], times[:, None, None] * 1e-6 * np.eye(3), atol=1e-12)
