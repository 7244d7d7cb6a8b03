"""Patches of one surface point in two frames: relative rotation, and whether they show the same mark.

With many weak key points a third of those within 1.5 px of the true position are coincidences, or the light
has changed the surface beyond recognition: nothing can be learned from them. Therefore both patches are cut
by the ground truth, rotated to the same orientation, and correlated.
"""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.frontend.features.patches import (
    Patches,
    cut_patches,
    image_jacobian,
    rotate_affines,
    tangent_affines,
    tangent_vectors,
)
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.train.descriptor.surface_points import ScenePoints

HALF_PX = 12.0
"""Half the side of the patches at the median depth of the first frame [px]."""
MIN_CORRELATION = 0.3
"""Correlation of the logarithms above which two patches show the same mark."""


def same_appearance(points: ScenePoints) -> Bools:
    """Whether each sighting (M,) has a key point that looks like the original."""
    known = np.asarray(np.isfinite(points.p_K).all(axis=1))
    redetected = (points.again >= 0) & known[points.point] & known[points.again]
    result = np.zeros(len(points.point), dtype=bool)
    first = points.frame[points.point]
    for a in range(len(points.grey)):
        for b in range(len(points.grey)):
            here = np.flatnonzero(redetected & (first == a) & (points.other == b))
            if len(here):
                result[here] = _correlations(points, a, b, here) > MIN_CORRELATION
    return result


def patch_rotation(
    affine_a: Array, affine_b: Array, p_a: Array, normal_a: Array, R_ba: Array, p_b: Array, rig: RectifiedRig
) -> Array:
    """Angle (n,) [rad] in patch b of the direction that is x in patch a; maps (n, 2, 2) of
    ``features.patches``.

    p_a, normal_a (n, 3) in camera a; p_b (n, 3) in camera b; R_ba (3, 3): axes of camera a in b, seen from
    the body.
    """
    direction_a = tangent_vectors(p_a, normal_a, affine_a[:, :, 0], rig)
    pixels = np.einsum("nij,nj->ni", image_jacobian(p_b, rig), direction_a @ R_ba.T)
    x, y = np.linalg.solve(affine_b, pixels[..., None])[..., 0].T
    return np.asarray(np.arctan2(y, x))


def scene_rig(points: ScenePoints) -> RectifiedRig:
    """The scene's left camera; patches need no baseline."""
    height, width = points.grey.shape[1:]
    u, v = points.centre_px
    return RectifiedRig(float(points.focal_px), float(u), float(v), 1.0, int(width), int(height))


def camera_rotation(points: ScenePoints, a: int, b: int) -> Array:
    """R_ba (3, 3): axes of the camera at frame a in those at frame b, seen from the body."""
    return np.asarray(points.X_KG[b, :3, :3] @ points.X_KG[a, :3, :3].T)


def correlation(a: Patches, b: Patches) -> Array:
    """Normalised correlation (n,) of the logarithms of patches (n, 1, s, s)."""
    flat = [np.log1p(each / 4.0).reshape(len(each), -1) for each in (a, b)]
    x, y = (each - each.mean(axis=1, keepdims=True) for each in flat)
    norm = np.linalg.norm(x, axis=1) * np.linalg.norm(y, axis=1)
    return np.asarray((x * y).sum(axis=1) / np.maximum(norm, 1e-6), dtype=np.float64)


def _correlations(points: ScenePoints, a: int, b: int, sighting: Ints) -> Array:
    """Correlation (n,) of the patches of frame a's points and of their key points in frame b."""
    own, again = points.point[sighting], points.again[sighting]
    half_m = np.full(len(own), HALF_PX * float(np.median(points.p_K[own, 2])) / float(points.focal_px))
    rig, R_ba = scene_rig(points), camera_rotation(points, a, b)
    affine_a, affine_b = (
        tangent_affines(points.p_K[i], points.normal_K[i], rig, half_m) for i in (own, again)
    )
    rotation = patch_rotation(
        affine_a, affine_b, points.p_K[own], points.normal_K[own], R_ba, points.p_K[again], rig
    )
    patches_a = cut_patches(points.grey[a], points.uv_px[own], affine_a)
    patches_b = cut_patches(points.grey[b], points.uv_px[again], rotate_affines(affine_b, rotation))
    return correlation(patches_a, patches_b)
