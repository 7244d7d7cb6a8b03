"""Which part of the true surface the left camera has seen, and seen lit: what completion is measured on.

A point counts when, in at least one frame, it lies inside the image, nothing stands between it and the
camera (rays cast with embree from the true poses), it is not seen edge-on, and the left image is brighter
there than the sky: a point in shadow shows nothing.
"""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.dataset import StereoSequence
from polhode.lie import Array, inverse_pose, transform_points
from polhode.mapping.visibility import CLEARANCE, Caster
from polhode.records import Bools

MAX_FRAMES = 60
LIT_OVER_SKY = 12.0
"""Intensity above the sky's that counts as lit [8-bit levels]."""


def seen_and_lit(
    mesh: trimesh.Trimesh,
    p_G: Array,
    normal_G: Array,
    X_NG: Array,
    sequence: StereoSequence,
    min_frames: int = 1,
) -> Bools:
    """(n,) true where a point of the true surface was seen and lit, in so many frames at least.

    mesh, p_G (n, 3), normal_G (n, 3) in the true G [m]; X_NG (F, 4, 4) true poses at the sequence's pairs.
    At most 60 frames are used, evenly spread.
    """
    caster = Caster(mesh)
    found = np.zeros(len(p_G), dtype=np.int64)
    count = len(X_NG)
    for k in np.unique(np.linspace(0, count - 1, min(count, MAX_FRAMES)).round().astype(int)):
        X_CG = inverse_pose(sequence.X_NC[k]) @ X_NG[k]
        left = sequence.read_left(int(k))[0]
        # Points that have been seen often enough need no further test.
        candidate = np.flatnonzero(found < min_frames)
        lit = candidate[_bright(left, transform_points(X_CG, p_G[candidate]), sequence)]
        eye_G = inverse_pose(X_CG)[:3, 3]
        found[lit[caster.sees(eye_G, p_G[lit], normal_G[lit], CLEARANCE * mesh.scale)]] += 1
    return np.asarray(found >= min_frames)


def light_level(left: NDArray[np.uint8]) -> float:
    """Intensity above which a pixel of a left image shows light: well above the sky's."""
    return float(np.percentile(left, 5)) + LIT_OVER_SKY


def _bright(left: NDArray[np.uint8], p_C: Array, sequence: StereoSequence) -> Bools:
    """(n,) true where a point projects onto a pixel of the recorded image that is brighter than the sky."""
    rig = sequence.calibration
    front = p_C[:, 2] > 1e-6
    uv = np.full((len(p_C), 2), -1.0)
    if front.any():
        projected, _ = cv2.projectPoints(p_C[front], np.zeros(3), np.zeros(3), rig.K0, rig.dist0)
        uv[front] = projected.reshape(-1, 2)
    smooth = cv2.blur(left.astype(np.float32), (3, 3))
    level = light_level(left)
    column, row = np.round(np.nan_to_num(uv, nan=-1.0)).clip(-1, 1e6).astype(np.int64).T
    inside = front & (column >= 0) & (column < rig.width_px) & (row >= 0) & (row < rig.height_px)
    bright = np.zeros(len(p_C), dtype=bool)
    bright[inside] = smooth[row[inside], column[inside]] > level
    return bright
