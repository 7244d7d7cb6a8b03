"""Dense depth of the target from one rectified pair.

Semi-global matching gives whole-pixel disparities (Hirschmueller, "Stereo processing by semiglobal
matching", 2008, by OpenCV), checked left against right; least squares refines them to a few hundredths of a
pixel and tells how certain each is; local planes smooth what is left; rims and jumps are cut away.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.disparity_facets import fit_facets
from frontend.disparity_planes import fit_planes
from frontend.disparity_refinement import refine_dense
from polhode.camera import RectifiedRig
from polhode.config.depth import Depth
from polhode.records import Bools, DepthMap

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]
_FLOOR_PX = 0.05
"""What the model of the noise leaves out: slant, shine, interpolation."""


@dataclass(frozen=True)
class _Crop:
    """Images around the target; the right one is shifted by ``shift_px``, so disparities start at 0."""

    left: Image
    right: Image
    lit: Bools
    target: Bools
    v0: int
    u0: int
    shift_px: int
    search_px: int
    sky: float
    """Intensity of the sky."""

    @property
    def image(self) -> Image:
        """(h, w) the left image without the margins of the search."""
        return self.left[:, self.search_px : self.search_px + self.lit.shape[1]]


def compute_depth(
    left: Image,
    right: Image,
    mask: Bools,
    rig: RectifiedRig,
    config: Depth,
    disparity_range_px: tuple[float, float] | None = None,
) -> DepthMap:
    """Depth map in the rectified left camera.

    left, right (H, W) rectified; mask (H, W) true on the target in the left image; disparity_range_px the
    least and the largest disparity of the target where sparse features tell (a margin is added), else found.
    Depth and sigma are NaN where the target is unlit, hidden from one camera or not certain.
    """
    shape = left.shape
    depth_m = np.full(shape, np.nan, dtype=np.float32)
    sigma_m = np.full(shape, np.nan, dtype=np.float32)
    empty = DepthMap(depth_m=depth_m, sigma_m=sigma_m, intensity=left, target=mask)
    if not mask.any():
        return empty
    if disparity_range_px is None:
        disparity_range_px = find_disparity_range(left, right, mask, config, rig.disparity_offset_px)
        if disparity_range_px is None:
            return empty
    crop = _crop(left, right, mask, disparity_range_px, config)
    disparity, sigma = _disparity(crop, config)
    d = disparity + np.float32(crop.shift_px - rig.disparity_offset_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.where(d > 0, rig.focal_px * rig.baseline_m / d, np.nan)
        spread = depth**2 / (rig.focal_px * rig.baseline_m) * sigma
    h, w = crop.target.shape
    inner = (slice(crop.v0, crop.v0 + h), slice(crop.u0, crop.u0 + w))
    depth_m[inner], sigma_m[inner] = depth, np.where(np.isfinite(depth), spread, np.nan)
    return empty


def find_disparity_range(
    left: Image, right: Image, mask: Bools, config: Depth, offset_px: float = 0.0
) -> tuple[float, float] | None:
    """Least and largest disparity of the target [px], from images of a quarter of the size, or None.

    offset_px: disparity of what is infinitely far, cx_left - cx_right.
    """
    scale = 4 if min(left.shape) >= 200 else 2
    size = (left.shape[1] // scale, left.shape[0] // scale)
    small = [
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        for image in (left, right)
    ]
    inside = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    share = config.max_disparity_share * left.shape[1] / scale
    far = offset_px / scale
    coarse = _crop(small[0], small[1], inside, (far, far + share), config)
    disparity = _matched(coarse, config)
    found = disparity[np.isfinite(disparity) & coarse.lit] + coarse.shift_px
    if len(found) < 20:
        return None
    low, high = np.percentile(found, [2.0, 98.0]) * scale
    margin = scale + 0.25 * (high - low)
    return float(max(low - margin, offset_px)), float(high + margin)


def _crop(left: Image, right: Image, mask: Bools, range_px: tuple[float, float], config: Depth) -> _Crop:
    """Cut out the target; outside the image the border is repeated."""
    margin = max(config.block_px, config.window_px) + 2
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    height, width = mask.shape
    v0, v1 = max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, height)
    u0, u1 = max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, width)
    shift = int(np.floor(range_px[0])) - 3
    search = int(np.ceil((range_px[1] + 3 - shift) / 16.0)) * 16
    search = max(search, 16)
    cut_left = _columns(left[v0:v1], u0 - search, u1 + search)
    cut_right = _columns(right[v0:v1], u0 - search - shift, u1 + search - shift)
    target = mask[v0:v1, u0:u1]
    smooth = cv2.blur(left[v0:v1, u0:u1].astype(np.float32), (config.block_px, config.block_px))
    sky = float(np.percentile(left, 5))
    lit = target & (smooth > sky + config.min_intensity)
    return _Crop(cut_left, cut_right, lit, target, v0, u0, shift, search, sky)


def _columns(image: Image, start: int, stop: int) -> Image:
    """Columns start..stop of an image; those outside it repeat its border."""
    inside = image[:, max(start, 0) : max(min(stop, image.shape[1]), 1)]
    before, after = max(-start, 0), max(stop - image.shape[1], 0)
    padded = cv2.copyMakeBorder(inside, 0, 0, before, after, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(padded[:, : stop - start])


def _matched(crop: _Crop, config: Depth) -> Floats:
    """Semi-global disparities of the target (h, w) [px] after the left-right check, NaN where none."""
    n = crop.search_px
    block = config.block_px
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=n,
        blockSize=block,
        P1=8 * block * block,
        P2=40 * block * block,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=4,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    left = matcher.compute(crop.left, crop.right).astype(np.float32) / 16.0
    # The right image's disparities come from the mirrored pair.
    mirrored = matcher.compute(crop.right[:, ::-1].copy(), crop.left[:, ::-1].copy())
    right = mirrored[:, ::-1].astype(np.float32) / 16.0
    w = crop.target.shape[1]
    left = left[:, n : n + w]
    columns = np.clip(np.arange(w)[None, :] + n - np.round(left).astype(np.int64), 0, right.shape[1] - 1)
    back = np.take_along_axis(right, columns, axis=1)
    good = (left > 0) & (back > 0) & (np.abs(left - back) <= config.consistency_px) & crop.lit
    disparity = np.where(good, left, -1.0).astype(np.float32)
    speckled = np.round(disparity * 16).astype(np.int16)
    cv2.filterSpeckles(speckled, -16, config.speckle_px, 16)
    return np.where(speckled > 0, disparity, np.nan).astype(np.float32)


def _disparity(crop: _Crop, config: Depth) -> tuple[Floats, Floats]:
    """Refined disparities and their standard deviations (h, w) [px], NaN where none."""
    disparity = _matched(crop, config)
    known = np.isfinite(disparity)
    if known.sum() < 50:
        return np.full_like(disparity, np.nan), np.full_like(disparity, np.nan)
    sigma = np.full_like(disparity, 0.3)
    correlated_px2 = float(config.window_px**2)
    for _ in range(config.refinements):
        by_window, sigma_window = refine_dense(
            crop.left, crop.right, disparity, crop.search_px, config.window_px
        )
        disparity, sigma = fit_planes(by_window, sigma_window, config.plane_radius_px, correlated_px2)
    if config.facets:
        darkest = crop.sky + 2.0 * config.min_intensity
        facet, sigma_facet = fit_facets(
            crop.image, crop.lit, by_window, sigma_window, correlated_px2, darkest
        )
        flat = sigma_facet < np.where(np.isfinite(sigma), sigma, np.inf)
        disparity, sigma = np.where(flat, facet, disparity), np.where(flat, sigma_facet, sigma)
    certain = np.isfinite(disparity) & (sigma < config.max_sigma_px)
    keep = certain & ~_rims(np.where(certain, disparity, np.nan), crop.target, config)
    spread = np.hypot(sigma, _FLOOR_PX)
    return (
        np.where(keep, disparity, np.nan).astype(np.float32),
        np.where(keep, spread, np.nan).astype(np.float32),
    )


def _rims(disparity: Floats, target: Bools, config: Depth) -> Bools:
    """Pixels along the silhouette and along jumps of disparity, where windows mix near and far."""
    if config.rim_px == 0:
        return np.zeros(target.shape, dtype=bool)
    size = 2 * config.rim_px + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    framed = cv2.copyMakeBorder(target.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    outside = cv2.erode(framed, kernel)[1:-1, 1:-1] == 0
    largest = cv2.dilate(
        np.where(np.isfinite(disparity), disparity, -1e9).astype(np.float32), np.ones((3, 3))
    )
    least = cv2.erode(np.where(np.isfinite(disparity), disparity, 1e9).astype(np.float32), np.ones((3, 3)))
    jump = (largest - least > config.jump_px) & np.isfinite(disparity)
    near_jump = cv2.dilate(jump.astype(np.uint8), kernel) > 0
    return np.asarray(outside | near_jump)
