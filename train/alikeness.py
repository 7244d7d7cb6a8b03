"""Which key points that are found again show the same mark, and not another one that happens to be there.

With many weak key points a third of those within 1.5 px of the true place are coincidences, or the light has
changed the surface beyond recognition: nothing can be learned from them. So both patches are cut by the
truth, turned alike, and correlated.
"""

import numpy as np

from polhode.camera import RectifiedRig
from polhode.frontend.features.patches import Patches, cut_patches, tangent_affines, turned
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.train.points import ScenePoints
from polhode.train.surface_turn import turn_between

HALF_PX = 12.0
"""Half the side of the patches at the middle depth of the first frame [px]."""
ALIKE = 0.3
"""Correlation of the logarithms above which two patches show one mark."""


def alike(points: ScenePoints) -> Bools:
    """Sightings (M,) that are found again and look like it."""
    found = points.again >= 0
    known = np.asarray(np.isfinite(points.p_K).all(axis=1))
    found &= known[points.point] & known[points.again]
    result = np.zeros(len(points.point), dtype=bool)
    first = points.frame[points.point]
    for a in range(len(points.grey)):
        for b in range(len(points.grey)):
            here = np.flatnonzero(found & (first == a) & (points.other == b))
            if len(here):
                result[here] = _correlations(points, a, b, here) > ALIKE
    return result


def rig_of(points: ScenePoints) -> RectifiedRig:
    """The scene's left camera; patches need no baseline."""
    height, width = points.grey.shape[1:]
    u, v = points.centre_px
    return RectifiedRig(float(points.focal_px), float(u), float(v), 1.0, int(width), int(height))


def turn_of(points: ScenePoints, a: int, b: int) -> Array:
    """R_ba (3, 3): axes of camera a at its frame in those of camera b, both as the body sees them."""
    return np.asarray(points.X_KG[b, :3, :3] @ points.X_KG[a, :3, :3].T)


def _correlations(points: ScenePoints, a: int, b: int, sighting: Ints) -> Array:
    """Correlation (n,) of the patches of sightings of frame a's points in frame b."""
    own, again = points.point[sighting], points.again[sighting]
    half_m = np.full(len(own), HALF_PX * float(np.median(points.p_K[own, 2])) / float(points.focal_px))
    rig, R_ba = rig_of(points), np.broadcast_to(turn_of(points, a, b), (len(own), 3, 3))
    affine_a, affine_b = (
        tangent_affines(points.p_K[i], points.normal_K[i], rig, half_m) for i in (own, again)
    )
    turn = turn_between(
        affine_a, affine_b, points.p_K[own], points.normal_K[own], R_ba, points.p_K[again], rig
    )
    patches_a = cut_patches(points.grey[a], points.uv_px[own], affine_a)
    patches_b = cut_patches(points.grey[b], points.uv_px[again], turned(affine_b, turn))
    return correlation(patches_a, patches_b)


def correlation(a: Patches, b: Patches) -> Array:
    """Normalised correlation (n,) of the logarithms of patches (n, 1, s, s)."""
    flat = [np.log1p(each / 4.0).reshape(len(each), -1) for each in (a, b)]
    x, y = (each - each.mean(axis=1, keepdims=True) for each in flat)
    norm = np.linalg.norm(x, axis=1) * np.linalg.norm(y, axis=1)
    return np.asarray((x * y).sum(axis=1) / np.maximum(norm, 1e-6), dtype=np.float64)
