"""Image patches resampled in the tangent plane of the surface, at a known size in metres.

Stereo measures the distance and the normal of the surface at each point. A patch in the tangent plane looks
the same from every viewpoint and distance, except for a rotation in its plane (Wu et al., "3D model matching
with viewpoint-invariant patches", 2008), so a descriptor need not learn perspective.

A patch's coordinates (x, y) run from -1 to 1, x right and y down on a surface that faces the camera. Its
affine map A (2, 2) [px] gives their position in the image: (u, v) = uv + A (x, y).
"""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled_reordered

Grey = NDArray[np.float32]
Patches = NDArray[np.float32]
PATCH_PX = 32
"""Side of a patch [px]."""
_BLUR_STEPS = np.sqrt(2.0) ** np.arange(9)
"""Pixels of the image per pixel of the patch for which the image is smoothed."""


def surface_normals(uv_px: Array, plane: Array, rig: RectifiedRig) -> Array:
    """Unit normals (n, 3) in R, towards the camera, of surfaces whose disparity is a plane in the image.

    plane (n, 3): disparity at uv [px] and its slopes along u and v. A plane in space is also a plane in
    disparity, since f b / z is linear in u and v.
    """
    d0 = plane[:, 0] - rig.disparity_offset_px
    offset = uv_px - [rig.cx_px, rig.cy_px]
    n = np.column_stack([plane[:, 1:], (d0 - np.sum(plane[:, 1:] * offset, axis=1)) / rig.focal_px])
    # The normal points against the ray, whose product with n is d0 / f > 0.
    return np.asarray(-n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12))


def tangent_affines(p_R: Array, normal_R: Array, rig: RectifiedRig, half_m: Array) -> Array:
    """Maps (n, 2, 2) [px] of upright patches in the tangent planes at p_R (n, 3) [m], unit normals (n, 3).

    half_m (n,): half the side of a patch on the surface [m]. Upright: the map is symmetric, so it stretches
    but does not rotate. For a rotation see ``rotate_affines``.
    """
    P = image_jacobian(p_R, rig)
    along = np.eye(3) - normal_R[:, :, None] * normal_R[:, None, :]
    # Any basis of the tangent plane gives this product; its symmetric root is the map without rotation.
    square, axes = np.linalg.eigh(P @ along @ np.swapaxes(P, 1, 2))
    # surfaces with a larger inclination are treated as if they had this one [deg]: otherwise one pixel would
    # fill the patch
    floor = square[:, 1:] * np.cos(np.deg2rad(70.0)) ** 2
    stretch = np.sqrt(np.maximum(square, floor))
    return np.asarray((axes * stretch[:, None, :]) @ np.swapaxes(axes, 1, 2) * half_m[:, None, None])


def surface_frames(p_R: Array, normal_R: Array, affine_px: Array, rig: RectifiedRig) -> Array:
    """Axes R_RS (n, 3, 3) of the surface at points (n, 3): x along the patch's x, z along the normal.

    The same point in two frames gives the motion between them: R_AB = R_AS R_BS^T.
    """
    x = tangent_vectors(p_R, normal_R, affine_px[:, :, 0], rig)
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return np.stack([x, np.cross(normal_R, x), normal_R], axis=-1)


def tangent_vectors(p_R: Array, normal_R: Array, step_px: Array, rig: RectifiedRig) -> Array:
    """Vectors (n, 3) [m] in the tangent planes at points (n, 3) whose images are the steps (n, 2) [px]."""
    # The normals are scaled like the projection, so that the system is well conditioned.
    system = np.concatenate([image_jacobian(p_R, rig), rig.focal_px * normal_R[:, None, :]], axis=1)
    rhs = np.concatenate([step_px, np.zeros((len(p_R), 1))], axis=1)
    return np.asarray(np.linalg.solve(system, rhs[..., None])[..., 0])


def image_jacobian(p_R: Array, rig: RectifiedRig) -> Array:
    """d uv / d p_R (n, 2, 3) [px/m] at points (n, 3)."""
    x, y, z = p_R.T
    zero, f = np.zeros_like(z), rig.focal_px
    return np.stack([f / z, zero, -f * x / z**2, zero, f / z, -f * y / z**2], axis=-1).reshape(-1, 2, 3)


def axes_affines(p_R: Array, R_RS: Array, rig: RectifiedRig, half_m: float) -> Array:
    """Maps (n, 2, 2) [px] of patches along the surface's axes (n, 3, 3) at points (n, 3)."""
    return np.asarray(image_jacobian(p_R, rig) @ R_RS[:, :, :2] * half_m)


def upright_affines(half_px: Array) -> Array:
    """Maps (n, 2, 2) [px] of square patches in the image, for surfaces of unknown orientation."""
    return np.asarray(half_px[:, None, None] * np.eye(2))


def rotate_affines(affine_px: Array, angle_rad: Array) -> Array:
    """Maps (n, 2, 2) of patches rotated in their own planes, so that direction ``angle`` becomes their x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(affine_px @ np.stack([c, -s, s, c], axis=-1).reshape(-1, 2, 2))


def root_image(image: Image) -> Image:
    """Square roots of the grey values: shot noise becomes uniform, and dark regions keep their contrast."""
    return np.asarray(np.round(16.0 * np.sqrt(image.astype(np.float32))), dtype=np.uint8)


def cut_patches(image: Image, uv_px: Array, affine_px: Array, size_px: int = PATCH_PX) -> Patches:
    """Patches (n, 1, size, size) of grey values 0..255, smoothed where they are subsampled.

    Beyond the image its border is repeated.
    """
    n = len(uv_px)
    patches = np.zeros((n, 1, size_px, size_px), dtype=np.float32)
    if n == 0:
        return patches
    for smooth, chosen in smoothed_levels(image, affine_px, size_px):
        _cut_each(smooth, uv_px, affine_px, chosen, patches[:, 0])
    return patches


def smoothed_levels(image: Image, affine_px: Array, size_px: int) -> Iterator[tuple[Grey, Ints]]:
    """The image smoothed for the sampling of patches with maps (n, 2, 2), and the patches to cut from it."""
    # The geometric mean of both directions: more would blur the short one, less would alias the long one.
    step = np.sqrt(np.abs(np.linalg.det(affine_px))) * 2.0 / size_px
    level = np.abs(np.log(np.maximum(step, 1e-6))[:, None] - np.log(_BLUR_STEPS)).argmin(axis=1)
    grey = image.astype(np.float32)
    for k in np.unique(level):
        yield _smoothed(grey, float(_BLUR_STEPS[k])), np.flatnonzero(level == k)


@compiled_reordered
def _cut_each(image: Grey, uv_px: Array, affine_px: Array, chosen: Ints, patches: Grey) -> None:
    for k in chosen:
        cut_patch(image, uv_px[k, 0], uv_px[k, 1], affine_px[k], patches[k])


@compiled_reordered
def cut_patch(image: Grey, u: float, v: float, affine_px: Array, patch: Grey) -> None:
    """One patch (s, s) around (u, v) by its map (2, 2), interpolated bilinearly."""
    height, width = image.shape
    size = len(patch)
    for row in range(size):
        y = (2.0 * row + 1.0) / size - 1.0
        start_u, start_v = u + affine_px[0, 1] * y, v + affine_px[1, 1] * y
        for column in range(size):
            x = (2.0 * column + 1.0) / size - 1.0
            at_u = min(max(start_u + affine_px[0, 0] * x, 0.0), width - 1.0)
            at_v = min(max(start_v + affine_px[1, 0] * x, 0.0), height - 1.0)
            left, top = min(int(at_u), width - 2), min(int(at_v), height - 2)
            s, t = np.float32(at_u - left), np.float32(at_v - top)
            upper = image[top, left] + s * (image[top, left + 1] - image[top, left])
            lower = image[top + 1, left] + s * (image[top + 1, left + 1] - image[top + 1, left])
            patch[row, column] = upper + t * (lower - upper)


def _smoothed(grey: Grey, step_px: float) -> Grey:
    """The image smoothed for a sampling distance of ``step_px``."""
    if step_px <= 1.0:
        return grey
    sigma = 0.5 * float(np.sqrt(step_px**2 - 1.0))
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma), dtype=np.float32)
