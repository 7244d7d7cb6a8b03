"""Rectification, and segmentation of the target: raw images and calibration to a rectified pair with masks.

Images of any calibrated stereo rig become those of an ideal one, which has two identical pinhole cameras, a
baseline along x and corresponding rows. Its axes follow from geometry alone (Fusiello, Trucco, Verri, "A
compact algorithm for rectification of stereo pairs", 2000): x along the baseline, z near the mean viewing
direction. Toed-in, swapped and stacked cameras need no special case.

The target is segmented by its brightness against the black sky, or by a given mask.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.camera import RectifiedRig
from polhode.dataset import StereoCalibration, StereoSequence
from polhode.errors import InputError
from polhode.lie import Array, inverse_pose, make_pose
from polhode.records import Bools

Image = NDArray[np.uint8]
MAX_GROWTH = 1.6
"""Largest ratio of the rectified to the original image size; what lies beyond it is cropped."""
IDEAL_TOLERANCE = 1e-6
"""Images of a rig that deviates from the ideal one by less than this [rad, m], a thousandth of a pixel, are
not resampled."""

MAX_SLOPE = 100.0
"""Of a ray of the rectified image against its axis."""
MAX_ROUND_TRIP = 0.1
"""Error of the inverse of the distortion at the border, over the size of the image; a usable model has a
thousandth of a pixel."""


@dataclass(frozen=True)
class Crop:
    """A bounding box in an image [px]: columns u0..u1, rows v0..v1, upper ends excluded."""

    u0: int
    v0: int
    u1: int
    v1: int

    @property
    def width_px(self) -> int:
        return self.u1 - self.u0

    @property
    def height_px(self) -> int:
        return self.v1 - self.v0


def target_mask(image: Image, given: Bools | None = None) -> Bools:
    """Mask (H, W) of the target: the given one, or the pixels brighter than the sky, closed over shadows."""
    if given is not None:
        return given
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5), dtype=np.uint8)
    bright = (smooth > sky_level(smooth)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    if count <= 1:
        return np.zeros(image.shape, dtype=bool)
    area = np.asarray(stats)[1:, cv2.CC_STAT_AREA].astype(np.int64)
    largest = int(area.max())
    # Shadow can separate parts of one spacecraft; stars and hot pixels are tiny.
    kept = 1 + np.flatnonzero(area >= max(25, 0.02 * largest))
    lit = np.isin(labels, kept).astype(np.uint8)
    reach = max(3, int(0.04 * np.sqrt(largest)) | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    return np.asarray(cv2.morphologyEx(lit, cv2.MORPH_CLOSE, kernel), dtype=bool)


def sky_level(smooth: Image) -> float:
    """Intensity above which a smoothed pixel is not sky: the darkest level plus four times its scatter."""
    dark = smooth[smooth <= np.percentile(smooth, 10)].astype(np.float64)
    return float(np.median(dark)) + 4.0 * max(1.0, float(np.std(dark)))


def target_crop(mask: Bools, margin_px: int = 8) -> Crop | None:
    """Bounding box of a mask (H, W) with a margin; None when the mask is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    height, width = (int(n) for n in mask.shape)
    return Crop(
        max(0, int(columns[0]) - margin_px),
        max(0, int(rows[0]) - margin_px),
        min(width, int(columns[-1]) + 1 + margin_px),
        min(height, int(rows[-1]) + 1 + margin_px),
    )


@dataclass(frozen=True)
class Rectifier:
    """Maps images of the two cameras into the rectified pair."""

    rig: RectifiedRig
    X_CR: Array
    """(4, 4) pose of the rectified left camera R in the left camera as calibrated, C (a rotation)."""
    maps: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...] | None
    """Pixel maps (left, right); None when the rig is ideal already."""

    def __call__(self, image: Image, side: int, interpolation: int = cv2.INTER_CUBIC) -> Image:
        """Rectify one grey image or mask (H, W); side 0 left, 1 right."""
        if self.maps is None:
            return image
        map_u, map_v = self.maps[side]
        return np.asarray(cv2.remap(image, map_u, map_v, interpolation), dtype=np.uint8)


def make_rectifier(calibration: StereoCalibration) -> Rectifier:
    """The rectifier of a calibrated rig. Raises InputError when the cameras have no common field of view."""
    if _is_rectified(calibration):
        return Rectifier(_ideal_rig(calibration), np.eye(4), None)
    X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1  # D: right camera as calibrated
    R_CR = _rectified_axes(X_CD)
    R_DR = X_CD[:3, :3].T @ R_CR
    focal = float(
        np.mean([calibration.K0[0, 0], calibration.K0[1, 1], calibration.K1[0, 0], calibration.K1[1, 1]])
    )
    size = (calibration.width_px, calibration.height_px)
    boxes = [
        _image_bounds(calibration.K0, calibration.dist0, R_CR, focal, size),
        _image_bounds(calibration.K1, calibration.dist1, R_DR, focal, size),
    ]
    width, centres_x = _extent(boxes, 0, size[0])
    height, _ = _extent(boxes, 1, size[1])
    top = min(box[0, 1] for box in boxes)
    bottom = max(box[1, 1] for box in boxes)
    cx = [(width - 1) / 2 - centre for centre in centres_x]
    cy = (height - 1) / 2 - (top + bottom) / 2
    rig = RectifiedRig(
        focal_px=focal,
        cx_px=cx[0],
        cy_px=cy,
        baseline_m=float(np.linalg.norm(X_CD[:3, 3])),
        width_px=width,
        height_px=height,
        disparity_offset_px=cx[0] - cx[1],
    )
    maps = (
        _pixel_map(calibration.K0, calibration.dist0, R_CR, rig.K, (width, height)),
        _pixel_map(calibration.K1, calibration.dist1, R_DR, _right_K(rig), (width, height)),
    )
    return Rectifier(rig, make_pose(R_CR, np.zeros(3)), maps)


@dataclass(frozen=True)
class RectifiedPair:
    """One rectified stereo pair with the target's mask in each image: the input of every feature method."""

    left: Image
    right: Image
    mask_left: Bools
    mask_right: Bools


def rectified_pair(sequence: StereoSequence, rectifier: Rectifier, k: int) -> RectifiedPair:
    """Read, rectify and mask pair k."""
    raw = sequence.read_pair(k)
    left, mask_left = _rectified(rectifier, 0, raw.left, raw.mask_left)
    right, mask_right = _rectified(rectifier, 1, raw.right, raw.mask_right)
    return RectifiedPair(left, right, mask_left, mask_right)


def rectified_left(sequence: StereoSequence, rectifier: Rectifier, k: int) -> tuple[Image, Bools]:
    """Left image of pair k and its mask."""
    return _rectified(rectifier, 0, *sequence.read_left(k))


def _rectified(rectifier: Rectifier, side: int, raw: Image, given: Bools | None) -> tuple[Image, Bools]:
    """A rectified image and the target's mask in it, from the given mask where there is one."""
    image, mask = rectifier(raw, side), None
    if given is not None:
        mask = rectifier((given * np.uint8(255)).astype(np.uint8), side, cv2.INTER_NEAREST) > 127
    return image, target_mask(image, mask)


def _is_rectified(calibration: StereoCalibration) -> bool:
    """True for an ideal pair, which must not be resampled: interpolation costs sharpness."""
    X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1
    parallel = np.allclose(X_CD[:3, :3], np.eye(3), atol=IDEAL_TOLERANCE)
    along_x = X_CD[0, 3] > 0 and np.allclose(X_CD[1:3, 3], 0.0, atol=IDEAL_TOLERANCE)
    undistorted = not np.any(calibration.dist0) and not np.any(calibration.dist1)
    K0, K1 = calibration.K0, calibration.K1
    square = np.isclose(K0[0, 0], K0[1, 1], rtol=1e-9)
    same = np.isclose(K0[0, 0], K1[0, 0], rtol=1e-9) and np.allclose(K0[1], K1[1], rtol=1e-9)
    return bool(parallel and along_x and undistorted and square and same)


def _ideal_rig(calibration: StereoCalibration) -> RectifiedRig:
    X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1
    K0, K1 = calibration.K0, calibration.K1
    return RectifiedRig(
        float(K0[0, 0]),
        float(K0[0, 2]),
        float(K0[1, 2]),
        float(X_CD[0, 3]),
        calibration.width_px,
        calibration.height_px,
        float(K0[0, 2] - K1[0, 2]),
    )


def _rectified_axes(X_CD: Array) -> Array:
    """R_CR (3, 3): x along the baseline, z as close as possible to the mean viewing direction."""
    x = X_CD[:3, 3] / np.linalg.norm(X_CD[:3, 3])
    forward = np.array([0.0, 0.0, 1.0]) + X_CD[:3, 2]
    z = forward - x * (x @ forward)
    if np.linalg.norm(z) < 0.2 or X_CD[2, 2] < 0.2:
        raise InputError(
            "the stereo rig: the cameras do not look in the same direction, across their baseline; "
            "check T_BS in cam0/sensor.yaml and cam1/sensor.yaml"
        )
    z = z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _undistort(points: Array, K: Array, dist: Array, R: Array) -> Array:
    """Pixels (n, 2) of a distorted camera -> normalised coordinates (n, 2) along axes rotated by R."""
    source = np.ascontiguousarray(points[:, None, :], dtype=np.float64)
    rotation = np.ascontiguousarray(R.T)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-10)
    out = cv2.undistortPoints(source, K, dist, R=rotation, P=np.eye(3), criteria=criteria)
    return np.asarray(out, dtype=np.float64)[:, 0, :]


def _image_bounds(K: Array, dist: Array, R: Array, focal: float, size: tuple[int, int]) -> Array:
    """Bounds (2, 2) [px] (low, high) of the image's border in rectified coordinates before centring."""
    u, v = np.linspace(0, size[0] - 1, 24), np.linspace(0, size[1] - 1, 24)
    border = np.concatenate(
        [np.stack([u, np.full_like(u, row)], 1) for row in (0, size[1] - 1)]
        + [np.stack([np.full_like(v, column), v], 1) for column in (0, size[0] - 1)]
    )
    rays = _undistort(border, K, dist, R)
    _require_invertible(border, rays, K, dist, R)
    rectified = focal * rays
    return np.stack([rectified.min(axis=0), rectified.max(axis=0)])


def _require_invertible(pixels: Array, rays: Array, K: Array, dist: Array, R: Array) -> None:
    """Raise InputError unless the ``rays`` (n, 2) of the image's border project to its ``pixels`` (n, 2)."""
    off = np.full(len(rays), np.inf)
    sound = abs(rays).max(axis=1) < MAX_SLOPE
    if sound.any():
        points = np.column_stack([rays[sound], np.ones(int(sound.sum()))]) @ R.T
        back, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, dist)
        off[sound] = np.linalg.norm(np.asarray(back)[:, 0, :] - pixels[sound], axis=1)
    if not off.max() < MAX_ROUND_TRIP * abs(pixels).max():
        raise InputError(
            "the stereo rig: the distortion folds the border of the image over itself; correct "
            "distortion_coefficients and intrinsics in cam0/sensor.yaml and cam1/sensor.yaml"
        )


def _extent(boxes: list[Array], axis: int, original: int) -> tuple[int, list[float]]:
    """Common size [px] along an axis, and each camera's centre there."""
    if axis == 0:
        span = max(float(box[1, axis] - box[0, axis]) for box in boxes)
    else:
        span = max(float(box[1, axis]) for box in boxes) - min(float(box[0, axis]) for box in boxes)
    size = int(min(np.ceil(span) + 1, MAX_GROWTH * original))
    return size, [float(box[:, axis].mean()) for box in boxes]


def _right_K(rig: RectifiedRig) -> Array:
    K = rig.K
    K[0, 2] -= rig.disparity_offset_px
    return K


def _pixel_map(
    K: Array, dist: Array, R: Array, K_new: Array, size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    rotation = np.ascontiguousarray(R.T)
    maps = cv2.initUndistortRectifyMap(K, dist, rotation, K_new, size, cv2.CV_32FC1)
    return np.asarray(maps[0], dtype=np.float32), np.asarray(maps[1], dtype=np.float32)
