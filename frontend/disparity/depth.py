"""Dense depth of the target from one rectified pair.

Semi-global matching gives a first disparity. Either least squares refine it and local planes and facets
smooth it (method sgbm), or a network refines it and estimates its uncertainty (method network). Pixels along
the silhouette and along depth discontinuities, where windows mix near and far surfaces, are removed.
"""

import cv2
import numpy as np

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.classical import classical_disparity
from polhode.frontend.disparity.learned import network_disparity
from polhode.frontend.disparity.sgbm import Floats, StereoCrop, cut_crop, match_checked
from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools
from polhode.records.surface import DepthMap

DisparityRange = tuple[float, float] | None
"""Smallest and largest disparity of the target [px]; None: not known."""
RANGE_PERCENTILES = (1.0, 99.0)
"""Of the disparities of the features, without wrong ones."""
RANGE_MARGIN_PX, RANGE_MARGIN_SHARE = 4.0, 0.25
"""That the surface without features may reach beyond them; a share of their range."""
MAX_SHIFT_SHARE = 0.4
"""Largest distance of the columns of a match that is searched for when the range is not known, as a share of
the image's width."""
RIM_PX = {"sgbm": 2, "network": 1}
"""Width that is removed along the silhouette and along jumps of depth, by method."""


def compute_depth(
    left: Image,
    right: Image,
    mask: Bools,
    rig: RectifiedRig,
    config: Depth,
    disparity_range_px: DisparityRange = None,
) -> DepthMap:
    """Depth map in the rectified left camera.

    left, right (H, W): rectified images; mask (H, W): the target in the left image; disparity_range_px:
    smallest and largest disparity of the target, if known from sparse features (a margin is added); otherwise
    it is searched for. Depth and sigma are NaN where the target is unlit, hidden from one camera or too
    uncertain.
    """
    disparity, sigma = dense_disparity(left, right, mask, rig, config, disparity_range_px)
    certain = np.isfinite(disparity) & (sigma < config.largest_sigma_px)
    known = np.where(certain, disparity, np.float32(np.nan))
    # a difference of 1.5 px between neighbours counts as a jump
    kept = certain & ~discontinuities(known, mask, RIM_PX[config.method], 1.5)
    return depth_of_disparity(disparity, sigma, kept, left, mask, rig)


def depth_of_disparity(
    disparity: Floats, sigma: Floats, kept: Bools, left: Image, mask: Bools, rig: RectifiedRig
) -> DepthMap:
    """The depth map of disparities and their sigmas (H, W) [px], where they are ``kept`` (H, W)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        d = disparity - np.float32(rig.disparity_offset_px)
        depth = np.where(kept & (d > 0), rig.focal_px * rig.baseline_m / d, np.nan)
        sigma_m = depth**2 / (rig.focal_px * rig.baseline_m) * sigma
    return DepthMap(
        depth_m=depth.astype(np.float32), sigma_m=sigma_m.astype(np.float32), intensity=left, target=mask
    )


def dense_disparity(
    left: Image,
    right: Image,
    mask: Bools,
    rig: RectifiedRig,
    config: Depth,
    disparity_range_px: DisparityRange = None,
) -> tuple[Floats, Floats]:
    """Disparity and its standard deviation (H, W) [px]; NaN where there is none.

    Arguments as for ``compute_depth``. Uncertain pixels and those near discontinuities are kept.
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
    in_crop, sigma[crop.inner] = crop_disparity(crop, config)
    disparity[crop.inner] = in_crop + np.float32(crop.shift_px)
    return disparity, sigma


def crop_disparity(crop: StereoCrop, config: Depth) -> tuple[Floats, Floats]:
    """Disparity of a crop and its standard deviation (h, w) [px], by the configured method."""
    return (
        network_disparity(crop, config) if config.method == "network" else classical_disparity(crop, config)
    )


def range_of_features(disparity_px: Array) -> DisparityRange:
    """The range of the target's disparities by those (n,) of the pair's own features; None: too few.

    It depends on this pair only, so that its depth does not wait for the motion.
    """
    # with fewer, the range of the disparities is not taken from the features of the pair
    if len(disparity_px) < 20:
        return None
    low, high = np.percentile(disparity_px, RANGE_PERCENTILES)
    margin = RANGE_MARGIN_PX + RANGE_MARGIN_SHARE * (high - low)
    return float(low - margin), float(high + margin)


def find_disparity_range(
    left: Image, right: Image, mask: Bools, config: Depth, offset_px: float = 0.0
) -> DisparityRange:
    """Smallest and largest disparity of the target [px], from images of a quarter of the size, or None.

    offset_px: disparity of a point at infinity, cx_left - cx_right.
    """
    scale = 4 if min(left.shape) >= 200 else 2
    size = (left.shape[1] // scale, left.shape[0] // scale)
    small = [
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        for image in (left, right)
    ]
    inside = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    reach = MAX_SHIFT_SHARE * left.shape[1] / scale
    # Converging cameras see near points at columns that differ little, and infinity, perhaps, not at all.
    far = max(offset_px / scale, -reach)
    coarse = cut_crop(small[0], small[1], inside, (far, max(far, 0.0) + reach), config)
    disparity = match_checked(coarse, config)
    found = disparity[np.isfinite(disparity) & coarse.lit] + coarse.shift_px
    if len(found) < 20:
        return None
    low, high = np.percentile(found, [2.0, 98.0]) * scale
    margin = scale + 0.25 * (high - low)
    return float(max(low - margin, offset_px)), float(high + margin)


def discontinuities(disparity: Floats, target: Bools, rim_px: int, jump_px: float | Floats) -> Bools:
    """Pixels (H, W) along the silhouette and along jumps of disparity, where near and far surfaces mix.

    rim_px: width that is removed; jump_px: difference between neighbours that counts as a jump.
    """
    size = 2 * rim_px + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    framed = cv2.copyMakeBorder(target.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    outside = cv2.erode(framed, kernel)[1:-1, 1:-1] == 0
    largest = cv2.dilate(
        np.where(np.isfinite(disparity), disparity, -1e9).astype(np.float32), np.ones((3, 3))
    )
    smallest = cv2.erode(np.where(np.isfinite(disparity), disparity, 1e9).astype(np.float32), np.ones((3, 3)))
    jump = (largest - smallest > jump_px) & np.isfinite(disparity)
    near_jump = cv2.dilate(jump.astype(np.uint8), kernel) > 0
    return np.asarray(outside | near_jump)
