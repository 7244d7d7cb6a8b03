"""Dense depth of the target from one rectified pair.

Semi-global matching gives a first disparity. Either least squares refine it and local planes and facets
smooth it (method sgbm), or a network refines it and says how certain it is (method network). Rims and jumps,
where near and far mix, are cut away.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.camera import RectifiedRig
from polhode.config.depth import Depth
from polhode.frontend.disparity.crop import Crop, cut_crop
from polhode.frontend.disparity.learned import learned_disparity
from polhode.frontend.disparity.sgbm import match_checked
from polhode.frontend.disparity.smoothed import smoothed_disparity
from polhode.records import Bools, DepthMap

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]


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
    disparity, sigma = dense_disparity(left, right, mask, rig, config, disparity_range_px)
    certain = np.isfinite(disparity) & (sigma < config.largest_sigma_px)
    kept = certain & ~_rims(np.where(certain, disparity, np.float32(np.nan)), mask, config)
    with np.errstate(invalid="ignore", divide="ignore"):
        d = disparity - np.float32(rig.disparity_offset_px)
        depth = np.where(kept & (d > 0), rig.focal_px * rig.baseline_m / d, np.nan)
        spread = depth**2 / (rig.focal_px * rig.baseline_m) * sigma
    return DepthMap(
        depth_m=depth.astype(np.float32), sigma_m=spread.astype(np.float32), intensity=left, target=mask
    )


def dense_disparity(
    left: Image,
    right: Image,
    mask: Bools,
    rig: RectifiedRig,
    config: Depth,
    disparity_range_px: tuple[float, float] | None = None,
) -> tuple[Floats, Floats]:
    """Disparity and its standard deviation (H, W) [px]; NaN where there is none.

    Arguments as ``compute_depth``. Nothing is cut away for being uncertain or near a rim.
    """
    disparity = np.full(left.shape, np.nan, dtype=np.float32)
    sigma = np.full(left.shape, np.nan, dtype=np.float32)
    if not mask.any():
        return disparity, sigma
    if disparity_range_px is None:
        disparity_range_px = find_disparity_range(left, right, mask, config, rig.disparity_offset_px)
        if disparity_range_px is None:
            return disparity, sigma
    crop = cut_crop(left, right, mask, disparity_range_px, config)
    found = disparity_of(crop, config)
    disparity[crop.inner], sigma[crop.inner] = found[0] + np.float32(crop.shift_px), found[1]
    return disparity, sigma


def disparity_of(crop: Crop, config: Depth) -> tuple[Floats, Floats]:
    """Disparity of a crop and its standard deviation (h, w) [px], by the method of the configuration."""
    return learned_disparity(crop, config) if config.method == "network" else smoothed_disparity(crop, config)


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
    coarse = cut_crop(small[0], small[1], inside, (far, far + share), config)
    disparity = match_checked(coarse, config)
    found = disparity[np.isfinite(disparity) & coarse.lit] + coarse.shift_px
    if len(found) < 20:
        return None
    low, high = np.percentile(found, [2.0, 98.0]) * scale
    margin = scale + 0.25 * (high - low)
    return float(max(low - margin, offset_px)), float(high + margin)


def _rims(disparity: Floats, target: Bools, config: Depth) -> Bools:
    """Pixels along the silhouette and along jumps of disparity, where windows mix near and far."""
    if config.rim_width_px == 0:
        return np.zeros(target.shape, dtype=bool)
    size = 2 * config.rim_width_px + 1
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
