"""Features that the two images of a pair have in common, and where the next and last right images have them.

Unlike the front end, which trusts the calibration and looks along epipolar lines, these matches know nothing
of it: they are there to contradict it.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from polhode.files.images import Grey
from polhode.geometry.lie import Array, Ints, hat, inverse_pose
from polhode.importers.calibrations.rig import EQUIDISTANT, Camera, Rig


@dataclass(frozen=True)
class StereoMatches:
    """Matches of one pair, M of them, in pixels as recorded."""

    left_px: Array
    """(M, 2)"""
    right_px: Array
    """(M, 2)"""
    before_px: Array
    """(M, 2) in the right image before; NaN: not seen there"""
    after_px: Array
    """(M, 2) in the right image after; NaN: not seen there"""
    before_s: float
    """Time of that image, from that of the pair; negative"""
    after_s: float


def match_pair(
    left: Grey, right: Grey, before: Grey, after: Grey, before_s: float, after_s: float
) -> StereoMatches:
    """Match a pair, and its right image with those before and after it. Images (H, W)."""
    points_l, words_l = _described(left)
    points_r, words_r = _described(right)
    stereo = _mutual(words_l, words_r)
    seen = [_seen(points_r, words_r, each)[stereo[:, 1]] for each in (before, after)]
    return StereoMatches(points_l[stereo[:, 0]], points_r[stereo[:, 1]], seen[0], seen[1], before_s, after_s)


def _described(image: Grey) -> tuple[Array, Array]:
    found, words = cv2.SIFT.create(nfeatures=1500).detectAndCompute(image, None)
    if words is None or len(found) < 2:
        return np.empty((0, 2)), np.empty((0, 128))
    return np.array([point.pt for point in found], dtype=np.float64), np.asarray(words, dtype=np.float64)


def _mutual(words_a: Array, words_b: Array) -> Ints:
    """(M, 2) indices of descriptors that are nearest to each other, and clearly so."""
    if len(words_a) < 2 or len(words_b) < 2:
        return np.empty((0, 2), dtype=np.int64)
    squared = (words_a**2).sum(1)[:, None] + (words_b**2).sum(1) - 2.0 * words_a @ words_b.T
    squared = np.maximum(squared, 0.0)
    nearest = squared.argmin(axis=1)
    two = np.partition(squared, 1, axis=1)[:, :2]
    # Lowe's ratio of the nearest to the second nearest descriptor
    clear = (two[:, 0] < 0.8**2 * two[:, 1]) & (squared.argmin(axis=0)[nearest] == np.arange(len(words_a)))
    return np.stack([np.flatnonzero(clear), nearest[clear]], axis=1)


def _seen(points: Array, words: Array, other: Grey) -> Array:
    """(n, 2) where the points are in another image; NaN: nowhere."""
    found, others = _described(other)
    out = np.full((len(points), 2), np.nan)
    matches = _mutual(words, others)
    out[matches[:, 0]] = found[matches[:, 1]]
    return out


def directions(camera: Camera, points_px: Array) -> Array:
    """(M, 3) rays of pixels (M, 2), z = 1; NaN stays NaN."""
    fu, fv, cu, cv = camera.intrinsics
    K = np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])
    seen = np.isfinite(points_px).all(axis=1)
    out = np.full((len(points_px), 3), np.nan)
    if seen.any():
        undistort: Any = cv2.fisheye.undistortPoints if camera.model == EQUIDISTANT else cv2.undistortPoints
        flat = undistort(points_px[seen][:, None], K, np.array(camera.distortion)).reshape(-1, 2)
        out[seen] = np.column_stack([flat, np.ones(len(flat))])
    return out


@dataclass(frozen=True)
class EpipolarGeometry:
    """Where the rays of one camera must appear in the other."""

    R_10: Array
    t_10: Array
    focal_px: float

    @classmethod
    def of(cls, rig: Rig) -> "EpipolarGeometry":
        """From the left camera into the right one."""
        X_10 = inverse_pose(rig.right.X_BC) @ rig.left.X_BC
        return cls(X_10[:3, :3], X_10[:3, 3], float(np.mean(rig.right.intrinsics[:2])))

    def lines(self, left: Array) -> Array:
        """(M, 3) epipolar lines of left rays (M, 3), scaled so that a right ray's product is in pixels."""
        lines = left @ (hat(self.t_10) @ self.R_10).T
        return np.asarray(
            self.focal_px * lines / np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12)[:, None]
        )

    def in_front(self, left: Array, right: Array) -> Array:
        """(M,) whether the point where two rays come closest is in front of both cameras."""
        a, b = left @ self.R_10.T, right
        aa, bb, ab = (a * a).sum(1), (b * b).sum(1), (a * b).sum(1)
        at, bt = -a @ self.t_10, b @ self.t_10
        det = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb)
        depth_left, depth_right = (bb * at + ab * bt) / det, (ab * at + aa * bt) / det
        return np.asarray((depth_left > 0.0) & (depth_right > 0.0))
