"""Stereo odometry with ORB features: how a camera is tracked through a world at rest, applied to the target.

The front end of ORB-SLAM (Mur-Artal and Tardos 2017) in its simplest form, by OpenCV: ORB features of the
masked left image, their depth by stereo, the pose of each frame by matching with the features of the frames
before it and RANSAC over perspective-three-point solutions. Where the last frames do not suffice, all frames
with a pose are tried. There is no bundle adjustment, no loop closure and no model of the motion.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np

from lab.end_to_end.found_poses import FoundPoses
from polhode.frontend.rectification import RectifiedPair
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points

FEATURES = 2000
LOCAL_FRAMES = 5
"""The last frames, whose points are matched together"""
MIN_INLIERS = 15
RATIO = 0.8
REPROJECTION_PX = 2.0
STEREO_ROW_PX, STEREO_WINDOW_PX = 1.0, 15


@dataclass(frozen=True)
class Features:
    """Features with depth of one frame."""

    uv: Array
    """(n, 2) in the rectified left image"""
    p_R: Array
    """(n, 3) [m]"""
    descriptors: np.ndarray
    """(n, 32) bytes"""


@dataclass(frozen=True)
class Posed:
    """A frame with a pose, and its points in G."""

    frame: int
    X_RG: Array
    p_G: Array
    descriptors: np.ndarray


def orb_odometry(pairs: Iterable[RectifiedPair], rig: RectifiedRig) -> FoundPoses:
    """G is the left camera at the first frame. A frame whose pose is not found is left out."""
    posed: list[Posed] = []
    for frame, pair in enumerate(pairs):
        features = stereo_features(pair, rig)
        X_RG = _pose(features, posed, rig)
        if X_RG is not None:
            p_G = transform_points(inverse_pose(X_RG), features.p_R)
            posed.append(Posed(frame, X_RG, p_G, features.descriptors))
    return FoundPoses(
        np.array([each.frame for each in posed], dtype=np.int64),
        np.stack([each.X_RG for each in posed]),
        np.concatenate([each.p_G for each in posed]),
    )


def stereo_features(pair: RectifiedPair, rig: RectifiedRig) -> Features:
    """ORB features of the left image that are found on the same row of the right one."""
    orb = cv2.ORB.create(FEATURES)
    points, descriptors = orb.detectAndCompute(pair.left, pair.mask_left.astype(np.uint8))
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 32), dtype=np.uint8))
    left = np.array([each.pt for each in points], dtype=np.float32)
    start = left - np.array([_rough_disparity_px(pair), 0.0], dtype=np.float32)
    window = (STEREO_WINDOW_PX, STEREO_WINDOW_PX)
    right, found, _ = cv2.calcOpticalFlowPyrLK(
        pair.left, pair.right, left, start, winSize=window, maxLevel=2, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    uvd = np.column_stack([left, left[:, 0] - right[:, 0]]).astype(np.float64)
    good = (found.ravel() > 0) & (np.abs(left[:, 1] - right[:, 1]) < STEREO_ROW_PX) & (uvd[:, 2] > 1.0)
    return Features(uvd[good, :2], rig.triangulate(uvd[good]), descriptors[good])


def _rough_disparity_px(pair: RectifiedPair) -> float:
    """How far the outline of the target as a whole is displaced: the start of each feature's disparity."""
    left, right = (np.flatnonzero(mask.any(axis=0)) for mask in (pair.mask_left, pair.mask_right))
    if len(left) == 0 or len(right) == 0:
        return 0.0
    return float(left[0] - right[0] + left[-1] - right[-1]) / 2.0


def _pose(features: Features, posed: Sequence[Posed], rig: RectifiedRig) -> Array | None:
    """X_RG (4, 4) from the last frames, else from any of the others; None: not found."""
    if not posed:
        return np.eye(4) if len(features.p_R) >= MIN_INLIERS else None
    candidates = (_resection(features, group, rig) for group in _groups(posed))
    return next((X_RG for X_RG in candidates if X_RG is not None), None)


def _groups(posed: Sequence[Posed]) -> Iterator[Sequence[Posed]]:
    yield posed[-LOCAL_FRAMES:]
    for each in islice(reversed(posed), LOCAL_FRAMES, None):
        yield [each]


def _resection(features: Features, group: Sequence[Posed], rig: RectifiedRig) -> Array | None:
    """The pose that the matches with the points of some frames agree on; None: too few do."""
    if len(features.uv) < MIN_INLIERS:
        return None
    known = np.concatenate([each.descriptors for each in group])
    p_G = np.concatenate([each.p_G for each in group])
    if len(known) < MIN_INLIERS:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(features.descriptors, known, k=2)
    # The second best is a rival only if it is another point of the target.
    good = [
        (a.queryIdx, a.trainIdx)
        for a, b in pairs
        if a.distance < RATIO * b.distance or np.linalg.norm(p_G[a.trainIdx] - p_G[b.trainIdx]) < 2e-3
    ]
    if len(good) < MIN_INLIERS:
        return None
    here, there = np.array(good).T
    p, uv = p_G[there], features.uv[here]
    cv2.setRNGSeed(0)
    found, turn, shift, inliers = cv2.solvePnPRansac(
        p, uv, rig.K, None, iterationsCount=500, reprojectionError=REPROJECTION_PX, confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not found or inliers is None or len(inliers) < MIN_INLIERS:
        return None
    chosen = inliers.ravel()
    turn, shift = cv2.solvePnPRefineLM(p[chosen], uv[chosen], rig.K, None, turn, shift)
    return make_pose(exp_so3(turn.ravel()), shift.ravel())
