"""Patches: cut where the surface is, alike from every side."""

import numpy as np
import pytest

from polhode.frontend.features.local_planes import local_planes
from polhode.frontend.features.patches import (
    cut_patches,
    rotate_affines,
    surface_normals,
    tangent_affines,
    upright_affines,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480, 3.0)
WAVES = np.random.default_rng(3).normal(size=(24, 3))
POINTS = np.array([[0.0, 0.0, 0.0], [0.05, 0.02, 0.0], [-0.06, 0.04, 0.0], [0.03, -0.05, 0.0]])
"""On the textured plane z = 0 of G."""
ROWS = slice(120, 360)
"""Of the image in which the points are seen; the rest is not drawn."""


def plane_view(X_RG: Array) -> tuple[np.ndarray, Array]:
    """Image and disparity (480, 640) of the plane."""
    v, u = np.mgrid[ROWS, :640].astype(np.float64)
    ray = np.stack([(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones_like(u)], -1)
    n, p0 = X_RG[:3, 2], X_RG[:3, 3]
    z = (n @ p0) / (ray @ n)
    p_G = (ray * z[..., None] - p0) @ X_RG[:3, :3]
    texture = np.cos(p_G[..., :2] @ (400.0 * WAVES[:, :2].T) + 6.0 * WAVES[:, 2]).sum(axis=-1)
    image, disparity = np.zeros((480, 640), np.uint8), np.full((480, 640), np.nan)
    image[ROWS] = np.clip(128.0 + 20.0 * texture, 0, 255)
    disparity[ROWS] = RIG.focal_px * RIG.baseline_m / z + RIG.disparity_offset_px
    return image, disparity


def test_a_patch_in_the_tangent_plane_is_alike_from_both_sides() -> None:
    """Turned by 50 degrees out of plane; in plane by what the maps say."""
    patches, plain = [], []
    for turn in (-0.45, 0.45):
        X_RG = make_pose(exp_so3([0.1, turn, 0.2]), [0.0, 0.0, 0.6])
        image, disparity = plane_view(X_RG)
        p_R = transform_points(X_RG, POINTS)
        uv = RIG.project(p_R)[:, :2]
        normals = surface_normals(uv, local_planes(disparity.astype(np.float32), uv), RIG)
        assert np.allclose(normals, X_RG[:3, 2] * -np.sign(X_RG[:3, 2] @ X_RG[:3, 3]), atol=2e-3)
        affine = tangent_affines(p_R, normals, RIG, np.full(len(p_R), 0.02))
        # The body's x axis in the image gives the turn in the plane.
        ahead = RIG.project(transform_points(X_RG, POINTS + np.array([1e-4, 0.0, 0.0])))[:, :2] - uv
        x, y = np.linalg.solve(affine, ahead[..., None])[..., 0].T
        patches.append(cut_patches(image, uv, rotate_affines(affine, np.arctan2(y, x))))
        plain.append(cut_patches(image, uv, upright_affines(np.full(4, 15.0))))
    for one, other in zip(*patches, strict=True):
        assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.97
    assert np.corrcoef(plain[0].ravel(), plain[1].ravel())[0, 1] < 0.8


def test_patches_are_read_at_pixel_centres_and_smoothed_where_they_shrink_the_image() -> None:
    ramp = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
    patch = cut_patches(ramp, np.array([[60.0, 50.0]]), upright_affines(np.array([16.0])))[0, 0]
    assert np.allclose(patch[5], 60.0 + np.arange(32) - 15.5, atol=0.02)
    checks = ((np.indices((300, 300)).sum(axis=0) % 2) * 255).astype(np.uint8)
    patch = cut_patches(checks, np.array([[150.0, 150.0]]), upright_affines(np.array([64.0])))[0, 0]
    assert patch.std() < 0.05 * 127.5


@pytest.mark.parametrize("count", [0, 1, 2500])
def test_any_number_of_patches(count: int) -> None:
    found = cut_patches(
        np.zeros((40, 40), np.uint8), np.full((count, 2), 20.0), upright_affines(np.full(count, 8.0))
    )
    assert found.shape == (count, 1, 32, 32)


def test_a_jump_of_depth_does_not_bend_the_plane_and_an_unknown_surface_has_none() -> None:
    disparity = np.full((80, 80), 30.0, dtype=np.float32)
    disparity += 0.1 * np.arange(80, dtype=np.float32)
    disparity[:, 45:] -= 12.0
    planes = local_planes(disparity, np.array([[40.0, 40.0], [5.0, 40.0]]))
    assert np.allclose(planes, [[34.0, 0.1, 0.0], [30.5, 0.1, 0.0]], atol=1e-2)
    assert np.isnan(local_planes(np.full((50, 50), np.nan, np.float32), np.array([[25.0, 25.0]]))).all()
