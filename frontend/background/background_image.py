"""The background's image behind the target, put together from other frames, in which the target is elsewhere.

The target tumbles before a background that stays, so that most of what it hides is seen at other times. The
images of other frames are moved into one frame by the homography of the background's plane (Hartley,
Zisserman, "Multiple View Geometry", 13.1), what they show of the target is left out, and the median of the
rest is the background, as in mosaics (Irani, Anandan, "Video indexing based on mosaic representations", Proc.
IEEE 1998). Points that are tracked on the background correct what is left: the Earth passes by, and poses are
noisy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.background.far_plane import Floats, Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, inverse_pose, make_pose

REACH_FRAMES = 24
"""Frames before and after from which the background is taken,"""
SAMPLES = 24
"""as many of them, spread evenly."""
MIN_SAMPLES = 2
"""Values of a pixel from which on its background is known."""
HIDDEN = np.uint8(255)
"""Value of a pixel where the target hides the background, or that lies outside."""
MIN_TRACKED, MIN_INLIERS = 12, 0.3
"""Points on the background, and the share that agrees on a correction; with fewer there is none."""
MAX_POINTS = 150
INLIER_PX = 0.6
MAX_GAIN = 2.0
"""Of exposures, by which the images of other frames are brought to that of one."""


@dataclass(frozen=True)
class FirstLook:
    """One image of a pair at working size."""

    image: Image
    """(h, w)"""
    hidden: Bools
    """(h, w) the target, as one pair alone shows it, and what the camera does not show"""


FirstLooks = tuple[FirstLook, FirstLook]
"""Left and right"""


@dataclass(frozen=True)
class BackgroundImage:
    """What would be seen if the target were not there."""

    image: Floats
    """(h, w)"""
    spread: Floats
    """(h, w) standard deviation between the frames it is taken from [DN]"""
    known: Bools
    """(h, w)"""


def frames_around(k: int, count: int) -> list[int]:
    """Indices of the frames, of ``count``, from which the background of frame k is taken."""
    first = max(0, min(k - REACH_FRAMES, count - 1 - 2 * REACH_FRAMES))
    last = min(count - 1, first + 2 * REACH_FRAMES)
    spread = np.unique(np.linspace(first, last, SAMPLES + 1).round().astype(int)).tolist()
    return [j for j in spread if j != k]


def plane_homography(
    m_N: Array, rig: RectifiedRig, X_NR: Array, X_NS: Array, sides: tuple[int, int] = (0, 0)
) -> Array:
    """(3, 3): pixels of the plane m . p_N = 1 from the rectified camera at X_NR to the one at X_NS (4, 4).

    Both poses are those of the left camera; sides: 0 left, 1 right, of the one and of the other.
    """
    (K, X_NR), (L, X_NS) = (_camera(rig, X, side) for X, side in zip((X_NR, X_NS), sides, strict=True))
    m = X_NR[:3, :3].T @ m_N / (1.0 - m_N @ X_NR[:3, 3])
    X_SR = inverse_pose(X_NS) @ X_NR
    H = L @ (X_SR[:3, :3] + np.outer(X_SR[:3, 3], m)) @ np.linalg.inv(K)
    return np.asarray(H / H[2, 2])


def _camera(rig: RectifiedRig, X_NR: Array, side: int) -> tuple[Array, Array]:
    """K (3, 3) and pose (4, 4) of one of the cameras."""
    K = rig.K
    if side == 1:
        K[0, 2] -= rig.disparity_offset_px
        X_NR = X_NR @ make_pose(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
    return K, X_NR


def reduced_homography(H: Array, scale: int) -> Array:
    """The same (3, 3) between images whose pixels are the means of scale x scale pixels."""
    half = 0.5 * (scale - 1)
    enlarge = np.array([[scale, 0.0, half], [0.0, scale, half], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(enlarge) @ H @ enlarge)


def background_images(
    own: FirstLooks, others: Sequence[FirstLooks], plane: Array, rig: RectifiedRig, X_NR: Array, X_NS: Array
) -> tuple[BackgroundImage, BackgroundImage]:
    """The background in both images of a pair at X_NR (4, 4), from pairs at X_NS (n, 4, 4), and from itself.

    plane: m (3,) in N. What one camera sees of it, the other may not, since the target is in the way.
    """
    scale = max(1, round(rig.width_px / own[0].image.shape[1]))

    def homography(X: Array, sides: tuple[int, int]) -> Array:
        return reduced_homography(plane_homography(plane, rig, X_NR, X, sides), scale)

    free = [~_widened(each.hidden) for each in own]
    points = _points(own[0].image, free[0])
    to_right = homography(X_NR, (0, 1))
    layers: list[list[Image]] = [[], []]
    for side in (0, 1):
        _append(
            layers[side], _layer(own[side], free[side], own[1 - side], homography(X_NR, (side, 1 - side)))
        )
    for other, X in zip(others, X_NS, strict=True):
        of_left = _correction(own[0].image, points, _moved(other[0].image, homography(X, (0, 0))))
        corrections = (of_left, to_right @ of_left @ np.linalg.inv(to_right))
        for side, correction in enumerate(corrections):
            for source in (0, 1):
                H = homography(X, (side, source)) @ correction
                _append(layers[side], _layer(own[side], free[side], other[source], H))
    return _median(layers[0], own[0]), _median(layers[1], own[1])


def _append(layers: list[Image], layer: Image | None) -> None:
    if layer is not None:
        layers.append(layer)


def _median(layers: list[Image], own: FirstLook) -> BackgroundImage:
    if len(layers) < MIN_SAMPLES:
        nothing = np.zeros(own.image.shape, dtype=np.float32)
        return BackgroundImage(nothing, nothing, np.zeros(own.image.shape, dtype=bool))
    values = np.sort(np.stack(layers, axis=-1), axis=-1)
    count = (values < HIDDEN).sum(axis=-1)
    low, middle, high = (_quantile(values, count, share) for share in (0.25, 0.5, 0.75))
    spread = high - low
    known = (count >= MIN_SAMPLES) & (spread <= 16.0)  # largest interquartile range of those values
    image, sigma = (np.where(known, each, np.float32(0.0)) for each in (middle, spread / np.float32(1.35)))
    return BackgroundImage(image.astype(np.float32), sigma.astype(np.float32), known)


def _layer(own: FirstLook, free: Bools, other: FirstLook, H: Array) -> Image | None:
    """Another image's background (h, w) in the place and exposure of this one; HIDDEN: unseen.

    free (h, w): where this one shows the background. None: it does not fit.
    """
    image = _moved(other.image, H)
    seen = _moved(np.where(_widened(other.hidden), np.uint8(0), np.uint8(255)), H) == 255
    common = seen & free
    if common.sum() < 0.05 * common.size:  # share of an image in which both must show the background
        return None
    sums = [float(cv2.mean(each, common.astype(np.uint8))[0]) for each in (own.image, image)]
    gain = sums[0] / max(sums[1], 1.0)
    if 1.0 / MAX_GAIN < gain < MAX_GAIN:
        image = np.asarray(cv2.convertScaleAbs(image, alpha=gain), dtype=np.uint8)
    # median difference to the frame's own background, in excess of which another frame is left out
    if np.median(cv2.absdiff(image, own.image)[common]) > 6.0:
        return None
    return np.where(seen, np.minimum(image, HIDDEN - np.uint8(1)), HIDDEN)


def _correction(own: Image, points: NDArray[np.float32], moved: Image) -> Array:
    """(3, 3) affine: pixels of the image (h, w) to those of another one that was moved to its place."""
    if len(points) < MIN_TRACKED:
        return np.eye(3)
    found, tracked, _ = cv2.calcOpticalFlowPyrLK(own, moved, points, np.zeros_like(points))
    good = np.asarray(tracked)[:, 0] > 0
    if good.sum() < MIN_TRACKED:
        return np.eye(3)
    cv2.setRNGSeed(1)
    A, inlier = cv2.estimateAffine2D(points[good], found[good], ransacReprojThreshold=INLIER_PX)
    if A is None or np.asarray(inlier).mean() < MIN_INLIERS:
        return np.eye(3)
    return np.vstack([np.asarray(A, dtype=np.float64), [0.0, 0.0, 1.0]])


def _points(image: Image, free: Bools) -> NDArray[np.float32]:
    """Corners (n, 1, 2) of the background."""
    mask = free.astype(np.uint8)
    found = cv2.goodFeaturesToTrack(image, MAX_POINTS, 0.02, 6.0, mask=mask)
    return np.zeros((0, 1, 2), dtype=np.float32) if found is None else np.asarray(found, dtype=np.float32)


def _moved(image: Image, H: Array) -> Image:
    """An image (h, w) in the place of another one; H: (3, 3) from that one's pixels to its own."""
    size = image.shape[1], image.shape[0]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(image, H, size, flags=flags), dtype=np.uint8)


def _widened(hidden: Bools) -> Bools:
    size = 2 * 2 + 1  # widened by 2 px
    return np.asarray(cv2.dilate(hidden.astype(np.uint8), np.ones((size, size))) > 0)


def _quantile(ordered: Image, count: NDArray[np.int64], share: float) -> Floats:
    """Of the first ``count`` (h, w) of ordered values (h, w, n)."""
    at = np.clip(np.round(share * (count - 1)).astype(np.int64), 0, ordered.shape[-1] - 1)
    return np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0].astype(np.float32)
