"""The equidistant fisheye against OpenCV's."""

import cv2
import numpy as np
import pytest

from polhode.geometry import fisheye
from polhode.geometry.lie import Array

K = np.array([[310.0, 0.0, 322.0], [0.0, 305.0, 238.0], [0.0, 0.0, 1.0]])
LENSES = {
    "ideal": np.zeros(4),
    "calibrated": np.array([-0.028, 0.012, -0.009, 0.0016]),
    "folding": np.array([-0.05, -0.02, 0.0, 0.0]),
}


def points(widest_rad: float, count: int = 400) -> Array:
    """Points (n, 3) in front of the camera, up to an angle from the axis."""
    rng = np.random.default_rng(0)
    theta, phi = rng.uniform(0, widest_rad, count), rng.uniform(0, 2 * np.pi, count)
    ray = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return np.asarray(ray * rng.uniform(0.3, 4.0, (count, 1)))


@pytest.mark.parametrize("name", LENSES)
def test_points_are_seen_where_opencv_sees_them(name: str) -> None:
    k = LENSES[name]
    p = points(min(1.4, fisheye.widest_angle_rad(k)))
    expected, _ = cv2.fisheye.projectPoints(p[:, None], np.zeros(3), np.zeros(3), K, k)
    np.testing.assert_allclose(fisheye.project(p, K, k), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("name", LENSES)
def test_rays_are_those_of_opencv(name: str) -> None:
    k = LENSES[name]
    uv = fisheye.project(points(min(1.2, 0.99 * fisheye.widest_angle_rad(k))), K, k)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
    flat = cv2.fisheye.undistortPoints(uv[:, None], K, k, criteria=criteria)[:, 0]
    rays = fisheye.rays(uv, K, k)
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:], flat, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)


@pytest.mark.parametrize("name", LENSES)
def test_rays_project_back_also_from_beside_and_behind_the_camera(name: str) -> None:
    k = LENSES[name]
    p = points(0.999 * fisheye.widest_angle_rad(k))
    rays = fisheye.rays(fisheye.project(p, K, k), K, k)
    np.testing.assert_allclose(rays, p / np.linalg.norm(p, axis=1, keepdims=True), atol=1e-9)


def test_beyond_the_angle_at_which_a_lens_folds_nothing_is_seen() -> None:
    k = LENSES["folding"]
    widest = fisheye.widest_angle_rad(k)
    assert 1.0 < widest < 1.6
    beyond = np.array([[np.sin(widest + 0.01), 0.0, np.cos(widest + 0.01)]])
    assert np.isnan(fisheye.project(beyond, K, k)).all()
    edge = 310.0 * fisheye.radius(np.array([widest]), k)[0] + 322.0
    assert np.isfinite(fisheye.rays(np.array([[edge - 1e-6, 238.0]]), K, k)).all()
    assert np.isnan(fisheye.rays(np.array([[edge + 1.0, 238.0]]), K, k)).all()
    assert fisheye.widest_angle_rad(np.zeros(4)) == np.pi
