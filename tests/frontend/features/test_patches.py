"""Patches: cut where the surface is, alike from every side."""

import numpy as np
import pytest

from polhode.frontend.features.local_planes import local_planes
from polhode.frontend.features.patches import (
    Patches,
    cut_patches,
    dominant_angles,
    rotate_affines,
    surface_normals,
    tangent_affines,
    upright_affines,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480, 3.0)
_WAVES = np.random.default_rng(3).normal(size=(24, 3))


def _plane_view(X_RG: Array) -> tuple[np.ndarray, Array]:
    """Image and disparity (480, 640) of the textured plane z = 0 of G."""
    v, u = np.mgrid[:480, :640].astype(np.float64)
    ray = np.stack([(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones_like(u)], -1)
    n, p0 = X_RG[:3, 2], X_RG[:3, 3]
    z = (n @ p0) / (ray @ n)
    p_G = (ray * z[..., None] - p0) @ X_RG[:3, :3]
    waves = 400.0 * _WAVES[:, :2]
    texture = np.cos(p_G[..., :2] @ waves.T + 6.0 * _WAVES[:, 2]).sum(axis=-1)
    image = np.clip(128.0 + 20.0 * texture, 0, 255).astype(np.uint8)
    return image, RIG.focal_px * RIG.baseline_m / z + RIG.disparity_offset_px


def _patches(X_RG: Array, p_G: Array) -> tuple[Patches, Array, Array]:
    """Upright patches of points of the plane, their maps, the normals that the disparity gave."""
    image, disparity = _plane_view(X_RG)
    p_R = transform_points(X_RG, p_G)
    uv = RIG.project(p_R)[:, :2]
    planes = local_planes(disparity.astype(np.float32), uv)
    normals = surface_normals(uv, planes, RIG)
    affine = tangent_affines(p_R, normals, RIG, np.full(len(p_R), 0.02))
    return cut_patches(image, uv, affine), affine, normals


POINTS = np.array([[0.0, 0.0, 0.0], [0.05, 0.02, 0.0], [-0.06, 0.04, 0.0], [0.03, -0.05, 0.0]])


def test_planes_and_normals_are_those_of_the_surface() -> None:
    X_RG = make_pose(exp_so3([0.5, -0.6, 0.3]), [0.05, -0.03, 0.6])
    _, _, normals = _patches(X_RG, POINTS)
    towards = X_RG[:3, 2] * -np.sign(X_RG[:3, 2] @ X_RG[:3, 3])
    assert np.allclose(normals, towards, atol=2e-3)


def test_a_patch_in_the_tangent_plane_is_alike_from_both_sides() -> None:
    """Turned by 50 degrees out of plane; in plane by what the maps say."""
    a, b = (make_pose(exp_so3([0.1, angle, 0.2]), [0.0, 0.0, 0.6]) for angle in (-0.45, 0.45))
    patches = []
    for X_RG in (a, b):
        _, affine, _ = _patches(X_RG, POINTS)
        p_R = transform_points(X_RG, POINTS)
        uv = RIG.project(p_R)[:, :2]
        # The body's x axis in the image gives the turn in the plane.
        ahead = RIG.project(transform_points(X_RG, POINTS + np.array([1e-4, 0.0, 0.0])))[:, :2] - uv
        angle = _angle_on_surface(affine, np.arctan2(ahead[:, 1], ahead[:, 0]))
        patches.append(cut_patches(_plane_view(X_RG)[0], uv, rotate_affines(affine, angle)))
    for one, other in zip(*patches, strict=True):
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.97
    image_a, image_b = (_plane_view(X)[0] for X in (a, b))
    plain = [
        cut_patches(image, RIG.project(transform_points(X, POINTS))[:, :2], upright_affines(np.full(4, 15.0)))
        for image, X in ((image_a, a), (image_b, b))
    ]
    assert np.corrcoef(plain[0].ravel(), plain[1].ravel())[0, 1] < 0.8


def test_the_dominant_angle_turns_with_the_patch() -> None:
    image, _ = _plane_view(make_pose(np.eye(3), [0.0, 0.0, 0.5]))
    uv = np.random.default_rng(0).uniform([100, 100], [540, 380], (60, 2))
    upright = upright_affines(np.full(60, 12.0))
    first = dominant_angles(cut_patches(image, uv, upright))
    second = dominant_angles(cut_patches(image, uv, rotate_affines(upright, np.full(60, 0.7))))
    change = np.angle(np.exp(1j * (first - second - 0.7)))
    assert np.mean(np.abs(change) < 0.1) > 0.8


def test_patches_are_read_at_pixel_centres() -> None:
    ramp = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
    patch = cut_patches(ramp, np.array([[60.0, 50.0]]), upright_affines(np.array([16.0])))[0, 0]
    assert np.allclose(patch[5], 60.0 + np.arange(32) - 15.5, atol=0.02)


def test_a_patch_that_shrinks_the_image_is_smoothed() -> None:
    checks = ((np.indices((300, 300)).sum(axis=0) % 2) * 255).astype(np.uint8)
    patch = cut_patches(checks, np.array([[150.0, 150.0]]), upright_affines(np.array([64.0])))
    assert patch.std() < 0.05 * 127.5


@pytest.mark.parametrize("count", [0, 1, 2500])
def test_any_number_of_patches(count: int) -> None:
    uv = np.full((count, 2), 20.0)
    assert cut_patches(np.zeros((40, 40), np.uint8), uv, upright_affines(np.full(count, 8.0))).shape == (
        count,
        1,
        32,
        32,
    )


def test_a_jump_of_depth_does_not_bend_the_plane() -> None:
    disparity = np.full((80, 80), 30.0, dtype=np.float32)
    disparity += 0.1 * np.arange(80, dtype=np.float32)
    disparity[:, 45:] -= 12.0
    planes = local_planes(disparity, np.array([[40.0, 40.0], [5.0, 40.0]]))
    assert np.allclose(planes, [[34.0, 0.1, 0.0], [30.5, 0.1, 0.0]], atol=1e-2)


def test_an_unknown_surface_has_no_plane() -> None:
    disparity = np.full((50, 50), np.nan, dtype=np.float32)
    assert np.isnan(local_planes(disparity, np.array([[25.0, 25.0]]))).all()


def _angle_on_surface(affine_px: Array, angle_rad: Array) -> Array:
    """Directions (n,) of the image as they are in upright patches [rad]."""
    direction = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)[..., None]
    x, y = np.linalg.solve(affine_px, direction)[..., 0].T
    return np.asarray(np.arctan2(y, x))
