"""Rectification: raw images and calibration to a rectified pair with the target's masks.

Images of any calibrated stereo rig become those of an ideal one, which has two identical pinhole cameras, a
baseline along x and corresponding rows. Its axes follow from geometry alone (Fusiello, Trucco, Verri, "A
compact algorithm for rectification of stereo pairs", 2000): x along the baseline, z near the mean viewing
direction. Toed-in, swapped and stacked cameras need no special case, nor do cameras of two resolutions: the
common focal length is the mean of both, and the finer image is smoothed before it is resampled. Of a fisheye
the part is used that a plane can show.

Where range images take the place of a right camera, that camera is a virtual one, like the left one and
parallel to it, so that a range is a disparity.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.found_masks import FoundMasks
from polhode.frontend.segmentation import border_of, target_mask
from polhode.geometry import fisheye
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, inverse_pose, make_pose
from polhode.records.dataset import StereoCalibration, StereoImages, StereoSequence
from polhode.records.range_images import RangeModel
from polhode.runtime.errors import InputError

Image = NDArray[np.uint8]
IDEAL_TOLERANCE = 1e-6
"""Images of a rig that deviates from the ideal one by less than this [rad, m], a thousandth of a pixel, are
not resampled."""

MAX_FIELD_RAD = np.deg2rad(70.0)
"""Half the field of view of the rectified image of a fisheye; what lies beyond it is cropped."""
ALIASING = 1.25
"""Where the rectified image is coarser than the original by more than this factor, it is smoothed first."""
BLUR_PER_SCALE = 0.5
"""Sigma of that smoothing [px] for each unit of sqrt(factor^2 - 1): the blur of the coarser pixel."""


MAX_SLOPE = 100.0
"""Of a ray of the rectified image against its axis."""


FOLDED = (
    "the stereo rig: the distortion folds the border of the image over itself; correct "
    "distortion_coefficients and intrinsics in cam0/sensor.yaml and cam1/sensor.yaml"
)


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
    sizes_px: tuple[tuple[int, int], tuple[int, int]]
    """Width and height of the original images"""
    surroundings: bool = False
    """Whether dim surroundings are left out of the masks (frontend/segmentation.py)"""
    blur_px: tuple[float, float] = (0.0, 0.0)
    """Sigma of the smoothing of each camera's images before they are resampled to a coarser one [px]"""
    found: FoundMasks | None = None
    """Masks that were found before a background that is not dark (frontend/background)"""

    @cached_property
    def seen(self) -> tuple[Bools, Bools]:
        """(H, W) what each camera shows of its rectified image."""
        if self.maps is None:
            whole = np.ones((self.rig.height_px, self.rig.width_px), dtype=bool)
            return whole, whole
        left, right = (
            (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
            for (u, v), (width, height) in zip(self.maps, self.sizes_px, strict=True)
        )
        return left, right

    @cached_property
    def borders(self) -> tuple[Bools, Bools]:
        """(H, W) along the border of what each camera shows."""
        left, right = self.seen
        return border_of(left), border_of(right)

    def __call__(self, image: Image, side: int, interpolation: int = cv2.INTER_CUBIC) -> Image:
        """Rectify one grey image or mask (H, W); side 0 left, 1 right."""
        if self.maps is None:
            return image
        map_u, map_v = self.maps[side]
        if self.blur_px[side] and interpolation != cv2.INTER_NEAREST:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.blur_px[side]), dtype=np.uint8)
        return np.asarray(cv2.remap(image, map_u, map_v, interpolation), dtype=np.uint8)


def make_rectifier(calibration: StereoCalibration) -> Rectifier:
    """The rectifier of a calibrated rig. Raises InputError when the cameras have no common field of view."""
    sizes = calibration.size_px(0), calibration.size_px(1)
    X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1  # D: right camera as calibrated
    if _is_rectified(calibration, X_CD):
        K0, baseline_m = calibration.K0, float(X_CD[0, 3])
        focal_px, cx_px, cy_px = float(K0[0, 0]), float(K0[0, 2]), float(K0[1, 2])
        offset_px = float(K0[0, 2] - calibration.K1[0, 2])
        rig = RectifiedRig(focal_px, cx_px, cy_px, baseline_m, *sizes[0], offset_px)
        return Rectifier(rig, np.eye(4), None, sizes)
    R_CR = _rectified_axes(X_CD)
    R_DR = X_CD[:3, :3].T @ R_CR
    lenses = [Lens.of(calibration, camera) for camera in (0, 1)]
    focal = float(np.mean([lens.K[i, i] for lens in lenses for i in (0, 1)]))
    boxes = [_image_bounds(lens, R, focal) for lens, R in zip(lenses, (R_CR, R_DR), strict=True)]
    largest = np.max([lens.size_px for lens in lenses], axis=0)
    top, bottom = min(box[0, 1] for box in boxes), max(box[1, 1] for box in boxes)
    spans = max(float(box[1, 0] - box[0, 0]) for box in boxes), float(bottom) - float(top)
    # one size for both cameras, each image centred along x
    # largest ratio of the rectified to the original image size; what lies beyond it is cropped
    width, height = (
        int(min(np.ceil(span) + 1, 1.6 * int(size))) for span, size in zip(spans, largest, strict=True)
    )
    cx = [(width - 1) / 2 - float(box[:, 0].mean()) for box in boxes]
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
        _pixel_map(lenses[0], R_CR, rig.K, (width, height)),
        _pixel_map(lenses[1], R_DR, rig.K - (cx[0] - cx[1]) * np.eye(3, k=2), (width, height)),
    )
    coarser = [float(np.mean(lens.K[[0, 1], [0, 1]])) / focal for lens in lenses]
    blurs = [BLUR_PER_SCALE * float(np.sqrt(k**2 - 1.0)) if k > ALIASING else 0.0 for k in coarser]
    return Rectifier(rig, make_pose(R_CR, np.zeros(3)), maps, sizes, blur_px=(blurs[0], blurs[1]))


@dataclass(frozen=True)
class Lens:
    """One camera without its pose."""

    K: Array
    dist: Array
    fisheye: bool
    size_px: tuple[int, int]

    @classmethod
    def of(cls, calibration: StereoCalibration, camera: int) -> "Lens":
        if camera == 0:
            return cls(calibration.K0, calibration.dist0, calibration.fisheye0, calibration.size_px(0))
        return cls(calibration.K1, calibration.dist1, calibration.fisheye1, calibration.size_px(1))

    def project(self, rays: Array) -> Array:
        """Pixels (n, 2), distorted, of rays (n, 3) in this camera; NaN beyond what a fisheye shows."""
        if self.fisheye:
            return fisheye.project(rays, self.K, self.dist)
        uv, _ = cv2.projectPoints(np.ascontiguousarray(rays), np.zeros(3), np.zeros(3), self.K, self.dist)
        return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


@dataclass(frozen=True)
class MeasuredDisparity:
    """Measured ranges of a frame, as disparities to the virtual right camera; NaN where there are none."""

    disparity_px: NDArray[np.float32]
    """(H, W) in the rectified left image"""
    sigma_px: NDArray[np.float32]
    """(H, W) of single pixels, whose errors are independent"""


@dataclass(frozen=True)
class RectifiedPair:
    """One rectified stereo pair with the target's mask in each image: the input of every feature method."""

    left: Image
    """(H, W) grey, 8 bits"""
    right: Image
    """(H, W); empty, as its mask, where disparities are measured"""
    mask_left: Bools
    """(H, W) true on the target"""
    mask_right: Bools
    """(H, W)"""
    measured: MeasuredDisparity | None = None
    """None: there are two images to measure them in"""


def rectified_pair(sequence: StereoSequence, rectifier: Rectifier, k: int) -> RectifiedPair:
    """Read, rectify and mask pair k; where the mask was found, the background is black."""
    if not sequence.has_ranges:
        return rectified_images(sequence.read_pair(k), rectifier, k)
    left, mask = rectified_left(sequence, rectifier, k)
    ranges = frame_disparity(sequence, rectifier, k)
    return RectifiedPair(left, np.zeros_like(left), mask, np.zeros_like(mask), ranges)


def rectified_images(raw: StereoImages, rectifier: Rectifier, k: int = 0) -> RectifiedPair:
    """Rectify and mask one pair of images; ``k``: its number, by which masks that were found are taken."""
    left, mask_left = _rectified(rectifier, k, 0, raw.left, raw.mask_left)
    right, mask_right = _rectified(rectifier, k, 1, raw.right, raw.mask_right)
    return RectifiedPair(left, right, mask_left, mask_right)


def frame_disparity(sequence: StereoSequence, rectifier: Rectifier, k: int) -> MeasuredDisparity:
    """The ranges of frame k of a sequence with range images, in the rectified left image."""
    return measured_disparity(sequence.read_range(k), sequence.range_model, rectifier)


def measured_disparity(
    range_m: NDArray[np.float32], model: RangeModel | None, rectifier: Rectifier
) -> MeasuredDisparity:
    """Ranges (H, W) [m] of the left image's pixels as recorded, in the rectified left image.

    They are interpolated as inverse ranges, in which planes are linear, and never across a jump or a pixel
    that is not measured: there the nearest pixel is taken.
    """
    assert model is not None
    rig, inverse = rectifier.rig, (1.0 / range_m).astype(np.float32)
    if rectifier.maps is not None:
        # difference between neighbours that noise explains [1/m]
        recorded = range_m.astype(np.float64)
        # neighbouring ranges that differ by more are not interpolated: another surface may begin there
        step = np.asarray(6.0 * model.sigma_at(recorded) / recorded**2, dtype=np.float32)
        inverse = _resampled(inverse, *rectifier.maps[0], step)
    ranges = 1.0 / inverse.astype(np.float64)
    sigma_m, depth_m = model.sigma_at(ranges), ranges
    if model.along_ray:
        v, u = np.mgrid[: rig.height_px, : rig.width_px]
        x, y = (u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px
        cosine = 1.0 / np.sqrt(1.0 + x**2 + y**2)
        sigma_m, depth_m = sigma_m * cosine, ranges * cosine
    scale = rig.focal_px * rig.baseline_m
    return MeasuredDisparity(
        (scale / depth_m + rig.disparity_offset_px).astype(np.float32),
        (scale / depth_m**2 * sigma_m).astype(np.float32),
    )


def _resampled(
    inverse: NDArray[np.float32],
    map_u: NDArray[np.float32],
    map_v: NDArray[np.float32],
    step: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Values (H, W) at the places of the maps: bilinear where the four around it agree within ``step``."""
    height, width = inverse.shape
    u0, v0 = np.floor(map_u).astype(np.int64), np.floor(map_v).astype(np.int64)
    s, t = map_u - u0, map_v - v0

    def at(u: NDArray[np.int64], v: NDArray[np.int64], image: NDArray[np.float32]) -> NDArray[np.float32]:
        seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        value = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
        return np.where(seen, value, np.float32(np.nan))

    corners = np.stack([at(u0 + i, v0 + j, inverse) for j in (0, 1) for i in (0, 1)])
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    near = (np.round(map_u).astype(np.int64), np.round(map_v).astype(np.int64))
    # NaN among the corners makes this false
    alike = corners.max(axis=0) - corners.min(axis=0) < at(*near, step)
    return np.asarray(np.where(alike, np.sum(weights * corners, axis=0), nearest), dtype=np.float32)


def rectified_left(sequence: StereoSequence, rectifier: Rectifier, k: int) -> tuple[Image, Bools]:
    """Left image of pair k and its mask, likewise."""
    return _rectified(rectifier, k, 0, *sequence.read_left(k))


def _rectified(
    rectifier: Rectifier, k: int, side: int, raw: Image, given: Bools | None
) -> tuple[Image, Bools]:
    """A rectified image and the target's mask in it, from the given mask where there is one."""
    image, mask = rectifier(raw, side), None
    if given is not None:
        mask = rectifier((given * np.uint8(255)).astype(np.uint8), side, cv2.INTER_NEAREST) > 127
    elif rectifier.found is not None and (mask := rectifier.found.mask(k, side)) is not None:
        # Everything after this expects the target before a dark sky.
        return np.where(mask, image, np.uint8(0)), mask
    border = rectifier.borders[side] if rectifier.surroundings else None
    return image, target_mask(image, mask, border)


def _is_rectified(calibration: StereoCalibration, X_CD: Array) -> bool:
    """True for an ideal pair, which must not be resampled: interpolation costs sharpness."""
    parallel = np.allclose(X_CD[:3, :3], np.eye(3), atol=IDEAL_TOLERANCE)
    along_x = X_CD[0, 3] > 0 and np.allclose(X_CD[1:3, 3], 0.0, atol=IDEAL_TOLERANCE)
    undistorted = not np.any(calibration.dist0) and not np.any(calibration.dist1)
    pinholes = not (calibration.fisheye0 or calibration.fisheye1)
    K0, K1 = calibration.K0, calibration.K1
    square = np.isclose(K0[0, 0], K0[1, 1], rtol=1e-9)
    same = np.isclose(K0[0, 0], K1[0, 0], rtol=1e-9) and np.allclose(K0[1], K1[1], rtol=1e-9)
    one_size = calibration.right_size_px is None
    return bool(parallel and along_x and pinholes and undistorted and square and same and one_size)


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


def _image_bounds(lens: Lens, R: Array, focal: float) -> Array:
    """Bounds (2, 2) [px] (low, high) of the image's border in rectified coordinates before centring."""
    width, height = lens.size_px
    u, v = np.linspace(0, width - 1, 24), np.linspace(0, height - 1, 24)
    border = np.concatenate(
        [np.stack([u, np.full_like(u, row)], 1) for row in (0, height - 1)]
        + [np.stack([np.full_like(v, column), v], 1) for column in (0, width - 1)]
    )
    if lens.fisheye:
        rays = _fisheye_slopes(border, lens, R)
    else:
        source = np.ascontiguousarray(border[:, None, :], dtype=np.float64)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-10)
        axes = np.ascontiguousarray(R.T)
        seen = cv2.undistortPoints(source, lens.K, lens.dist, R=axes, P=np.eye(3), criteria=criteria)
        rays = np.asarray(seen, dtype=np.float64)[:, 0, :]
        _require_invertible(border, rays, lens.K, lens.dist, R)
    rectified = focal * rays
    return np.stack([rectified.min(axis=0), rectified.max(axis=0)])


def _fisheye_slopes(border: Array, lens: Lens, R: Array) -> Array:
    """Pixels (n, 2) of a fisheye -> x / z and y / z (n, 2) along axes rotated by R, within MAX_FIELD_RAD.

    Raises InputError when the distortion folds the inner part of the image.
    """
    reach = float(fisheye.radius(np.array(fisheye.widest_angle_rad(lens.dist)), lens.dist))
    focal = lens.K[[0, 1], [0, 1]]
    # smallest radius, over the smaller side of the image, to which a fisheye's distortion must be invertible:
    # nearly the circle that touches two sides
    if not reach * focal.min() >= 0.45 * min(lens.size_px):
        raise InputError(FOLDED)
    flat = (border - lens.K[:2, 2]) / focal
    # the corners of a wide image may lie outside of the circle that the lens shows
    inside = np.minimum(1.0, (1.0 - 1e-9) * reach / np.maximum(np.linalg.norm(flat, axis=1), 1e-12))
    rays = fisheye.rays(flat * inside[:, None] * focal + lens.K[:2, 2], lens.K, lens.dist) @ R
    across = np.linalg.norm(rays[:, :2], axis=1)
    angle = np.minimum(np.arctan2(across, rays[:, 2]), MAX_FIELD_RAD)
    return np.asarray(rays[:, :2] * (np.tan(angle) / np.maximum(across, 1e-12))[:, None])


def _require_invertible(pixels: Array, rays: Array, K: Array, dist: Array, R: Array) -> None:
    """Raise InputError unless the ``rays`` (n, 2) of the image's border project to its ``pixels`` (n, 2)."""
    off = np.full(len(rays), np.inf)
    sound = abs(rays).max(axis=1) < MAX_SLOPE
    if sound.any():
        points = np.column_stack([rays[sound], np.ones(int(sound.sum()))]) @ R.T
        back, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, dist)
        off[sound] = np.linalg.norm(np.asarray(back)[:, 0, :] - pixels[sound], axis=1)
    # error of the inverse of the distortion at the border, over the size of the image; a usable model has a
    # thousandth of a pixel
    if not off.max() < 0.1 * abs(pixels).max():
        raise InputError(FOLDED)


def _pixel_map(
    lens: Lens, R: Array, K_new: Array, size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if lens.fisheye:
        v, u = np.mgrid[: size[1], : size[0]].astype(np.float64)
        x, y = (u - K_new[0, 2]) / K_new[0, 0], (v - K_new[1, 2]) / K_new[1, 1]
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ R.T
        # beyond what the lens shows: outside of the image
        uv = np.nan_to_num(fisheye.project(rays, lens.K, lens.dist), nan=-1e4).reshape(*x.shape, 2)
        return uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
    rotation = np.ascontiguousarray(R.T)
    maps = cv2.initUndistortRectifyMap(lens.K, lens.dist, rotation, K_new, size, cv2.CV_32FC1)
    return np.asarray(maps[0], dtype=np.float32), np.asarray(maps[1], dtype=np.float32)
