"""Stereo features: key points matched from left to right on epipolar lines, with sub-pixel disparity.

The disparity of a match is refined by least squares over a window of the left image. Gain, offset and an
affine disparity (a slanted surface) are estimated too; the columns of the key points themselves scatter
several times more. Lucas and Kanade 1981; Gruen, "Adaptive least squares correlation", 1985.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from polhode.config.frontend_settings import Frontend
from polhode.frontend.disparity.measured import disparity_at
from polhode.frontend.features.epipolar_search import (
    MAX_SHIFT_SHARE,
    RowOffsets,
    mutual_nearest,
    row_offsets,
)
from polhode.frontend.features.keypoints import Descriptors, KeyPoints, detect, no_key_points
from polhode.frontend.features.local_planes import local_planes
from polhode.frontend.features.patches import rotate_affines, surface_frames, surface_normals
from polhode.frontend.features.window_fit import MAX_SLOPE, WINDOW_PX, fit_windows
from polhode.frontend.rectification import Image, MeasuredDisparity, RectifiedPair, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints

ROW_GATE_PX = 0.8
"""Largest difference of rows between left and right key points of the finest scale."""
RATIO = 0.95
"""Largest ratio of best to second best descriptor distance among the candidates on the line."""
MIN_DISPARITY_PX = 0.5
"""Smallest disparity beyond that of infinity: smaller ones are of no known distance."""
MIN_CORRELATION = 0.85
"""Smallest normalised correlation of the refined windows."""
SIGMA_UV_PX = 0.30
"""Scatter of a key point between views of the target, before the back end estimates it [px]."""
MIN_SIGMA_DISPARITY_PX = 0.10
"""Floor of a refined disparity's sigma, since the noise is not the only error [px]."""

LARGEST_COORDINATE = 0.5
"""Of a descriptor, where it is rounded to 8 bits: larger ones count as this one."""
COARSE_ROWS = 128
"""Descriptors are filled up to multiples of so many for comparisons."""
MIN_NOISE_LEVELS = 1.0
"""Floor of the noise of an image [8-bit levels]: rounding, and what the model of its texture lacks."""


@dataclass(frozen=True)
class CoarseDescriptors:
    """Descriptors as whole numbers, filled up to one of a few sizes, for which products are prepared once."""

    whole: NDArray[np.int8]
    """(n, d)"""
    square: NDArray[np.float32]
    """(n,) of their lengths; infinite where a row is filled up"""

    @classmethod
    def of(cls, descriptors: Descriptors) -> "CoarseDescriptors":
        """Rounded: a coordinate of ``LARGEST_COORDINATE`` becomes 127."""
        whole = np.round(descriptors * np.float32(127.0 / LARGEST_COORDINATE))
        np.clip(whole, -127.0, 127.0, out=whole)
        return cls(whole.astype(np.int8), np.sum(whole * whole, axis=1)).some(np.arange(len(whole)))

    def some(self, rows: Ints) -> "CoarseDescriptors":
        """Those of some features, filled up."""
        more = -len(rows) % COARSE_ROWS
        return CoarseDescriptors(
            np.concatenate([self.whole[rows], np.zeros((more, self.whole.shape[1]), np.int8)]),
            np.concatenate([self.square[rows], np.full(more, np.inf, np.float32)]),
        )


@dataclass(frozen=True)
class StereoFeatures:
    """Stereo measurements of one frame with their descriptors: n of them."""

    uvd_px: Array
    """(n, 3) u and v in the rectified left image, (0, 0) at the centre of the first pixel, and disparity,
    u of the left minus u of the right image [px]"""
    sigma_px: Array
    """(n, 3) standard deviations of uvd [px]"""
    p_R: Array
    """(n, 3) the point in the rectified left camera: x to the right, y down, z forwards [m]"""
    scale_px: Array
    """(n,) scale of the key point in the left image [px]"""
    descriptors: Descriptors
    """(n, d) of the left image, unit length; d = 128 for RootSIFT"""
    angle_rad: Array | None = None
    """(n,) orientation in the left image [rad], from u to v, where the method has one"""
    R_RS: Array | None = None
    """(n, 3, 3) axes of the surface at the feature, as columns in the left camera: z is its normal, x a
    direction given by its texture; NaN where unknown"""
    rough_R_RS: Array | None = None
    """(n, 3, 3) the same by the few pixels that the disparity is from, and the orientation of the key point:
    near enough to propose motions, too rough to cut patches"""
    metres_per_px: Array | None = None
    """(n, 2) displacement of the point for one pixel in the image, and for one pixel of disparity [m/px]"""
    sigma_ls_px: Array | None = None
    """(n,) standard deviation of the disparity according to the least squares alone [px]"""
    place_sigma_px: Array | None = None
    """(n,) standard deviation of the place, each axis, according to the network that found it [px]"""
    rows: RowOffsets | None = None
    """Matches that ignore the epipolar constraint; None: the method detects in the left image alone"""

    def __len__(self) -> int:
        """Number of features, n."""
        return len(self.uvd_px)

    @cached_property
    def coarse_descriptors(self) -> "CoarseDescriptors":
        """The descriptors for comparisons of all with all"""
        return CoarseDescriptors.of(self.descriptors)

    @property
    def proposing_R_RS(self) -> Array | None:
        """Axes (n, 3, 3) by which a match proposes a motion: ``R_RS``, or else the rough ones"""
        return self.rough_R_RS if self.R_RS is None else self.R_RS

    @property
    def on_surface(self) -> Bools:
        """(n,) whether the axes of the surface are known"""
        if self.R_RS is None:
            return np.zeros(len(self), dtype=np.bool_)
        return np.asarray(np.isfinite(self.R_RS[:, 0, 0]), dtype=np.bool_)


class RootSift:
    """``FeatureMethod``: RootSIFT key points in both images, matched along the rows; the classical method.

    The slopes of the disparity and the orientations of the key points give rough axes of the surface."""

    def __init__(self, config: Frontend) -> None:
        self._config = config

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair; none when the target is out of view."""
        left = self._key_points(pair.left, pair.mask_left)
        if pair.measured is not None:
            found = with_ranges(pair.measured, left, rig)
            planes = local_planes(pair.measured.disparity_px, found.uvd_px[:, :2])
            return with_rough_axes(found, np.nan_to_num(planes[:, 1:]), rig)
        right = self._key_points(pair.right, pair.mask_right)
        found, slopes = match_stereo(pair.left, pair.right, left, right, rig)
        return with_rough_axes(found, slopes, rig)

    def _key_points(self, image: Image, mask: Bools) -> KeyPoints:
        crop = target_crop(mask)
        return no_key_points() if crop is None else detect(image, mask, crop, self._config.features)


def match_stereo(
    left: Image, right: Image, points_left: KeyPoints, points_right: KeyPoints, rig: RectifiedRig
) -> tuple[StereoFeatures, Array]:
    """Stereo measurements of one rectified pair, and the slopes (n, 2) of their disparities along u and v."""
    index_left, disparity = match_on_lines(points_left, points_right, rig)
    uv = points_left.uv_px[index_left]
    refined, sigma_d, correlation, slopes = refine_disparity(left, right, uv, disparity)
    depth_positive = refined - rig.disparity_offset_px > MIN_DISPARITY_PX
    near_start = np.abs(refined - disparity) < 1.5
    good = (correlation > MIN_CORRELATION) & near_start & depth_positive
    uvd = np.column_stack([uv[good], refined[good]])
    sigma_uv = np.full(len(uvd), SIGMA_UV_PX)
    features = StereoFeatures(
        uvd,
        np.column_stack([sigma_uv, sigma_uv, np.maximum(sigma_d[good], MIN_SIGMA_DISPARITY_PX)]),
        rig.triangulate(uvd),
        points_left.scale_px[index_left][good],
        points_left.descriptors[index_left][good],
        points_left.angle_rad[index_left][good],
        rows=row_offsets(points_left, points_right, rig.width_px),
    )
    return features, slopes[good]


def with_rough_axes(features: StereoFeatures, slopes: Array, rig: RectifiedRig) -> StereoFeatures:
    """Features with orientation, and their rough axes by slopes (n, 2) of the disparity along u and v."""
    # a method of which this is asked knows the orientations
    assert features.angle_rad is not None
    planes = np.column_stack([features.uvd_px[:, 2], slopes])
    normals = surface_normals(features.uvd_px[:, :2], planes, rig)
    upright = np.broadcast_to(np.eye(2), (len(features), 2, 2))
    affine = rotate_affines(upright, features.angle_rad)
    return replace(
        features,
        rough_R_RS=surface_frames(features.p_R, normals, affine, rig),
        metres_per_px=rig.metres_per_px(features.p_R[:, 2]),
    )


def with_ranges(measured: MeasuredDisparity, points: KeyPoints, rig: RectifiedRig) -> StereoFeatures:
    """Measurements of the key points of the left image whose range is known."""
    disparity, sigma_d = disparity_at(measured, points.uv_px)
    good = np.isfinite(disparity) & (disparity > rig.disparity_offset_px)
    uvd = np.column_stack([points.uv_px, disparity])[good]
    sigma_uv = np.full(len(uvd), SIGMA_UV_PX)
    return StereoFeatures(
        uvd,
        np.column_stack([sigma_uv, sigma_uv, sigma_d[good]]),
        rig.triangulate(uvd),
        points.scale_px[good],
        points.descriptors[good],
        points.angle_rad[good],
    )


def texture_sigma(image: Image, uv_px: Array) -> Array:
    """The sigma (n,) [px] that ``refine_disparity`` would have at points uv (n, 2), by one image alone.

    That is, with a second image of the same texture and noise: it states how well the texture around a point
    fixes its position, where no second image does.
    """
    if len(uv_px) == 0:
        return np.zeros(0)
    centre, spline, row = _row_spline(image, uv_px)
    still, arm, at = np.zeros((len(uv_px), 3)), uv_px - centre, centre - np.array([0, row])
    spread, _, _ = fit_windows(image[row:][: len(spline)], spline, at, arm, still, 0)
    return np.asarray(np.sqrt(2.0) * _noise_levels(image) * spread)


def _noise_levels(image: Image) -> float:
    """Standard deviation of the noise where the image is brightest and smoothest [8-bit levels].

    Immerkaer, "Fast noise variance estimation", 1996, but by the quietest fifth of the lit windows, which
    have least texture.
    """
    mask = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0])
    response = np.abs(cv2.filter2D(image.astype(np.float32), cv2.CV_32F, mask))
    around = cv2.blur(response, (WINDOW_PX, WINDOW_PX))
    lit = cv2.blur(image, (WINDOW_PX, WINDOW_PX)) > 0.3 * float(np.percentile(image, 99.0))
    quiet = float(np.percentile(around[lit], 20)) if lit.any() else 0.0
    return max(float(np.sqrt(np.pi / 2.0)) * quiet / 6.0, MIN_NOISE_LEVELS)


def match_on_lines(left: KeyPoints, right: KeyPoints, rig: RectifiedRig) -> tuple[Ints, Array]:
    """Mutually best descriptors among the candidates on the epipolar line: left index (m,), disparity
    (m,)."""
    gate_px = ROW_GATE_PX * np.maximum(1.0, 0.4 * left.scale_px)
    widest = MAX_SHIFT_SHARE * rig.width_px
    shifts_px = max(rig.disparity_offset_px + MIN_DISPARITY_PX, -widest), widest
    kept, matched = mutual_nearest(left, right, gate_px, shifts_px, RATIO)
    return kept, left.uv_px[kept, 0] - right.uv_px[matched, 0]


def refine_disparity(
    left: Image,
    right: Image,
    uv_px: Array,
    disparity_px: Array,
    iterations: int = 8,
    slope: Array | None = None,
) -> tuple[Array, Array, Array, Array]:
    """Least-squares disparity at points uv (n, 2) from initial values (n,), and slopes (n, 2) if known.

    Model: left(u + x, v + y) = gain * right(u + x - d - a x - b y, v + y) + offset over a square window.
    Returns disparity (n,) [px], its sigma from the residuals (n,) [px], normalised correlation (n,), and the
    refined slopes (n, 2).
    """
    if len(uv_px) == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2))
    centre, spline, row = _row_spline(right, uv_px)
    warp = np.column_stack([disparity_px, np.zeros((len(uv_px), 2))])
    if slope is not None:
        warp[:, 0] += np.sum(slope * (centre - uv_px), axis=1)
        warp[:, 1:] = np.clip(slope, -MAX_SLOPE, MAX_SLOPE)
    arm = uv_px - centre
    at = centre - np.array([0, row])
    spread, scatter, correlation = fit_windows(left[row:][: len(spline)], spline, at, arm, warp, iterations)
    # The whole-pixel centre is up to half a pixel from the key point: extrapolate along the slope.
    return warp[:, 0] + np.sum(warp[:, 1:] * arm, axis=1), scatter * spread, correlation, warp[:, 1:]


def _row_spline(image: Image, uv_px: Array) -> tuple[Ints, Array, int]:
    """The whole pixels (n, 2) nearest to points, and the B-spline coefficients of the rows of an image that
    windows around them take up, with the first of these rows."""
    centre = np.round(uv_px).astype(np.int64)
    half = WINDOW_PX // 2
    first = min(max(0, int(centre[:, 1].min()) - half), image.shape[0] - 1)
    rows = image[first : max(int(centre[:, 1].max()) + half, first) + 1]
    return centre, spline_filter1d(rows.astype(np.float64), order=3, axis=1, mode="mirror"), first
