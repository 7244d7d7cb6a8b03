"""Stereo features: key points matched from left to right on epipolar lines, with sub-pixel disparity.

The disparity of a match is refined by least squares over a window of the left image. Gain, offset and an
affine disparity (a slanted surface) are estimated too; the columns of the key points themselves scatter
several times more. Lucas and Kanade 1981; Gruen, "Adaptive least squares correlation", 1985.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from polhode.camera import RectifiedRig
from polhode.config.frontend_settings import Frontend
from polhode.frontend.disparity.measured import disparity_at
from polhode.frontend.features.keypoints import Descriptors, KeyPoints, detect, no_key_points
from polhode.frontend.features.row_offsets import RowOffsets, row_offsets
from polhode.frontend.rectification import Image, MeasuredDisparity, RectifiedPair, target_crop
from polhode.lie import Array
from polhode.records import Bools, Ints

ROW_GATE_PX = 0.8
"""Largest difference of rows between left and right key points of the finest scale."""
MAX_SHIFT_SHARE = 0.7
"""Largest distance of the two columns of a match, as a share of the image's width: at the depth that it
means, the rest of the width is what both cameras see. Of converging cameras this is not the disparity beyond
that of infinity, which may exceed the width."""
RATIO = 0.95
"""Largest ratio of best to second best descriptor distance among the candidates on the line."""
WINDOW_PX = 13
"""Side of the window of the disparity's least-squares refinement, odd."""
MIN_CORRELATION = 0.85
"""Smallest normalised correlation of the refined windows."""
SIGMA_UV_PX = 0.30
"""Scatter of a key point between views of the target, before the back end estimates it [px]."""
MIN_SIGMA_DISPARITY_PX = 0.10
"""Floor of a refined disparity's sigma, since the noise is not the only error [px]."""

MIN_NOISE_LEVELS = 1.0
"""Floor of the noise of an image [8-bit levels]: rounding, and what the model of its texture lacks."""


@dataclass(frozen=True)
class ImageCrop:
    """A part of a rectified left image."""

    image: Image
    """(H, W)"""
    corner_px: tuple[int, int]
    """(u, v) of the part's first pixel in the whole image"""


@dataclass(frozen=True)
class StereoFeatures:
    """Stereo measurements of one frame with their descriptors."""

    uvd_px: Array
    """(n, 3) u and v in the left image, and disparity, in the rectified pair"""
    sigma_px: Array
    """(n, 3)"""
    p_R: Array
    """(n, 3) [m] in the rectified left camera"""
    scale_px: Array
    """(n,)"""
    descriptors: Descriptors
    """(n, d) of the left image, unit length"""
    angle_rad: Array | None = None
    """(n,) orientation in the left image, where the method has one"""
    picture: ImageCrop | None = None
    """The left image of the target, if the matcher reads images"""
    R_RS: Array | None = None
    """(n, 3, 3) axes of the surface at the feature: z is its normal, x a direction given by its texture"""
    metres_per_px: Array | None = None
    """(n, 2) displacement of the point for one pixel in the image, and for one pixel of disparity [m/px]"""
    sigma_ls_px: Array | None = None
    """(n,) standard deviation of the disparity according to the least squares alone"""
    rows: RowOffsets | None = None
    """Matches that ignore the epipolar constraint; None: the method detects in the left image alone"""

    def __len__(self) -> int:
        return len(self.uvd_px)

    @property
    def on_surface(self) -> Bools:
        """(n,) whether the axes of the surface are known"""
        if self.R_RS is None:
            return np.zeros(len(self), dtype=np.bool_)
        return np.asarray(np.isfinite(self.R_RS[:, 0, 0]), dtype=np.bool_)


class RootSift:
    """``FeatureMethod``: RootSIFT key points in both images, matched along the rows; the classical method."""

    def __init__(self, config: Frontend) -> None:
        self._config = config

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair; none when the target is out of view."""
        left = self._key_points(pair.left, pair.mask_left)
        if pair.measured is not None:
            return with_ranges(pair.measured, left, rig)
        right = self._key_points(pair.right, pair.mask_right)
        return match_stereo(pair.left, pair.right, left, right, rig)

    def _key_points(self, image: Image, mask: Bools) -> KeyPoints:
        crop = target_crop(mask)
        return no_key_points() if crop is None else detect(image, mask, crop, self._config.features)


def match_stereo(
    left: Image,
    right: Image,
    points_left: KeyPoints,
    points_right: KeyPoints,
    rig: RectifiedRig,
) -> StereoFeatures:
    """Stereo measurements of one rectified pair."""
    index_left, disparity = _match_on_lines(points_left, points_right, rig)
    uv = points_left.uv_px[index_left]
    refined, sigma_d, correlation = refine_disparity(left, right, uv, disparity)
    depth_positive = refined - rig.disparity_offset_px > 0.5
    near_start = np.abs(refined - disparity) < 1.5
    good = (correlation > MIN_CORRELATION) & near_start & depth_positive
    uvd = np.column_stack([uv[good], refined[good]])
    sigma_uv = np.full(len(uvd), SIGMA_UV_PX)
    return StereoFeatures(
        uvd,
        np.column_stack([sigma_uv, sigma_uv, np.maximum(sigma_d[good], MIN_SIGMA_DISPARITY_PX)]),
        rig.triangulate(uvd),
        points_left.scale_px[index_left][good],
        points_left.descriptors[index_left][good],
        points_left.angle_rad[index_left][good],
        rows=row_offsets(points_left, points_right, rig.width_px),
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
    half = WINDOW_PX // 2
    y, x = (a.ravel() for a in np.mgrid[-half : half + 1, -half : half + 1])
    weight = np.exp(-(x**2 + y**2) / (2 * (0.6 * half) ** 2))
    centre = np.round(uv_px).astype(np.int64)
    columns, rows = centre[:, :1] + x, np.clip(centre[:, 1:] + y, 0, image.shape[0] - 1)
    target = image[rows, np.clip(columns, 0, image.shape[1] - 1)].astype(np.float64)
    spline = spline_filter1d(image.astype(np.float64), order=3, axis=1, mode="mirror")
    A, _ = _linearise(spline, rows, columns, np.zeros((len(uv_px), 3)), x, y, target)
    normal, _ = _normal_equations(A, target, weight)
    arm = np.column_stack([np.ones(len(uv_px)), uv_px - centre])
    variance = 2.0 * _noise_levels(image) ** 2
    along_row = np.einsum("na,nab,nb->n", arm, np.linalg.inv(normal)[:, :3, :3], arm)
    return np.asarray(np.sqrt(variance * along_row))


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


def _match_on_lines(left: KeyPoints, right: KeyPoints, rig: RectifiedRig) -> tuple[NDArray[np.intp], Array]:
    """Mutually best descriptors among the candidates on the epipolar line: left index (m,), disparity
    (m,)."""
    if len(left) == 0 or len(right) == 0:
        return np.zeros(0, dtype=np.intp), np.zeros(0)
    allowed = _candidates(left, right, rig)
    similarity = np.where(allowed, left.descriptors @ right.descriptors.T, -1.0)
    best = similarity.argmax(axis=1)
    rows = np.arange(len(left))
    mutual = similarity.argmax(axis=0)[best] == rows
    top = similarity[rows, best]
    similarity[rows, best] = -1.0
    distance = np.sqrt(np.maximum(2.0 - 2.0 * top, 0.0))
    second = np.sqrt(np.maximum(2.0 - 2.0 * similarity.max(axis=1), 0.0))
    keep = np.flatnonzero(mutual & (top > 0.0) & (distance < RATIO * second))
    return keep, left.uv_px[keep, 0] - right.uv_px[best[keep], 0]


def _candidates(left: KeyPoints, right: KeyPoints, rig: RectifiedRig) -> Bools:
    """(n_left, n_right): close rows, positive depth, similar scale and orientation."""
    row = np.abs(left.uv_px[:, None, 1] - right.uv_px[None, :, 1])
    gate = ROW_GATE_PX * np.maximum(1.0, 0.4 * left.scale_px)[:, None]
    shift = left.uv_px[:, None, 0] - right.uv_px[None, :, 0]
    octave = np.abs(np.log2(left.scale_px[:, None] / right.scale_px[None, :]))
    turn = np.abs((left.angle_rad[:, None] - right.angle_rad[None, :] + np.pi) % (2 * np.pi) - np.pi)
    in_range = (shift - rig.disparity_offset_px > 0.5) & (np.abs(shift) < MAX_SHIFT_SHARE * rig.width_px)
    return np.asarray((row < gate) & in_range & (octave < 0.6) & (turn < np.deg2rad(35.0)))


def refine_disparity(
    left: Image,
    right: Image,
    uv_px: Array,
    disparity_px: Array,
    iterations: int = 8,
    slope: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Least-squares disparity at points uv (n, 2) from initial values (n,), and slopes (n, 2) if known.

    Model: left(u + x, v + y) = gain * right(u + x - d - a x - b y, v + y) + offset over a square window.
    Returns disparity (n,) [px], its sigma from the residuals (n,) [px], normalised correlation (n,).
    """
    n = len(uv_px)
    if n == 0:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    half = WINDOW_PX // 2
    y, x = (a.ravel() for a in np.mgrid[-half : half + 1, -half : half + 1])
    weight = np.exp(-(x**2 + y**2) / (2 * (0.6 * half) ** 2))
    # Windows are centred on whole pixels, so that the left image is not interpolated, and the right one only
    # along its rows.
    centre = np.round(uv_px).astype(np.int64)
    columns, rows = centre[:, :1] + x, np.clip(centre[:, 1:] + y, 0, left.shape[0] - 1)
    target = left[rows, np.clip(columns, 0, left.shape[1] - 1)].astype(np.float64)
    spline = spline_filter1d(right.astype(np.float64), order=3, axis=1, mode="mirror")
    warp = np.column_stack([disparity_px, np.zeros(n), np.zeros(n)])
    if slope is not None:
        warp[:, 0] += np.sum(slope * (centre - uv_px), axis=1)
        warp[:, 1:] = np.clip(slope, -0.8, 0.8)
    for _ in range(iterations):
        A, _ = _linearise(spline, rows, columns, warp, x, y, target)
        step = np.linalg.solve(*_normal_equations(A, target, weight))[..., 0]
        step[:, 0] = np.clip(step[:, 0], -1.0, 1.0)
        step[:, 1:3] = np.clip(step[:, 1:3], -0.2, 0.2)
        warp = warp + step[:, :3]
        warp[:, 1:] = np.clip(warp[:, 1:], -0.8, 0.8)
        if np.max(np.abs(step[:, 0])) < 1e-3:
            break
    A, source = _linearise(spline, rows, columns, warp, x, y, target)
    normal, rhs = _normal_equations(A, target, weight)
    residual = target - (A @ np.linalg.solve(normal, rhs))[..., 0]
    variance = np.sum(weight * residual**2, axis=1) / max(np.sum(weight) - 5.0, 1.0)
    covariance = np.linalg.inv(normal)
    # The whole-pixel centre is up to half a pixel from the key point: extrapolate along the slope.
    arm = np.column_stack([np.ones(n), uv_px - centre])
    sigma = np.sqrt(variance * np.einsum("na,nab,nb->n", arm, covariance[:, :3, :3], arm))
    return np.sum(warp * arm, axis=1), sigma, _correlation(target, source, weight)


def _sample_rows(spline: Array, rows: Ints, u: Array) -> tuple[Array, Array]:
    """Value and slope along the row of a cubic B-spline (H, W) at integer rows and any columns (n, k)."""
    u = np.clip(u, 1.0, spline.shape[1] - 3.001)
    first = np.floor(u).astype(np.int64)
    t = u - first
    taps = [spline[rows, first + offset] for offset in (-1, 0, 1, 2)]
    weights = [(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]
    slopes = [-3 * (1 - t) ** 2, -12 * t + 9 * t**2, 3 + 6 * t - 9 * t**2, 3 * t**2]
    value = sum(w * tap for w, tap in zip(weights, taps, strict=True))
    slope = sum(w * tap for w, tap in zip(slopes, taps, strict=True))
    return np.asarray(value / 6.0), np.asarray(slope / 6.0)


def _linearise(
    spline: Array, rows: Ints, columns: Ints, warp: Array, x: Ints, y: Ints, target: Array
) -> tuple[Array, Array]:
    """Jacobian (n, k, 5) for steps of (d, a, b) and for gain and offset; the right window (n, k).

    Gain and offset are estimated directly and the warp as an increment, so the right-hand side is the target.
    """
    u = columns - warp[:, :1] - warp[:, 1:2] * x - warp[:, 2:3] * y
    source, slope = _sample_rows(spline, rows, u)
    gradient = -_gain(source, target) * slope
    return np.stack([gradient, gradient * x, gradient * y, source, np.ones_like(source)], axis=-1), source


def _gain(source: Array, target: Array) -> Array:
    """Exposure ratio (n, 1) between the two windows."""
    ds = source - source.mean(axis=1, keepdims=True)
    dt = target - target.mean(axis=1, keepdims=True)
    gain = np.sum(ds * dt, axis=1, keepdims=True) / np.maximum(np.sum(ds * ds, axis=1, keepdims=True), 1e-6)
    return np.asarray(np.clip(gain, 0.3, 3.0))


def _normal_equations(A: Array, b: Array, weight: Array) -> tuple[Array, Array]:
    Aw = A * weight[:, None]
    normal = np.swapaxes(Aw, 1, 2) @ A
    # A textureless window leaves the warp undetermined: the regularisation keeps the initial value.
    normal += np.diag([1e-2, 1e-1, 1e-1, 1e-6, 1e-6])
    return normal, np.swapaxes(Aw, 1, 2) @ b[..., None]


def _correlation(a: Array, b: Array, weight: Array) -> Array:
    w = weight / weight.sum()
    da, db = a - (a * w).sum(axis=1, keepdims=True), b - (b * w).sum(axis=1, keepdims=True)
    covariance = (w * da * db).sum(axis=1)
    spread = np.sqrt((w * da**2).sum(axis=1) * (w * db**2).sum(axis=1))
    return np.asarray(covariance / np.maximum(spread, 1e-9))
