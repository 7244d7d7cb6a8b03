"""Whole-pixel disparities by semi-global matching, checked left against right.

Hirschmueller, "Stereo processing by semiglobal matching and mutual information", 2008, by OpenCV.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.depth import Depth
from polhode.frontend.disparity.crop import Crop, Image
from polhode.records import Bools

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Matched:
    """Disparities of the left image (h, w) [px], of a crop."""

    checked: Floats
    """NaN where the right image disagrees, where the target is dark, and in specks"""
    unchecked: Floats
    """What the left image says alone; NaN where nothing"""


def match_checked(crop: Crop, config: Depth) -> Floats:
    """Semi-global disparities of the target (h, w) [px] after the left-right check, NaN where none."""
    return match_both_ways(crop, config).checked


def match_both_ways(crop: Crop, config: Depth) -> Matched:
    """Semi-global matching from left to right and back."""
    n = crop.search_px
    left = _match(crop.left, crop.right, n, config.block_px)
    # The right image's disparities come from the mirrored pair.
    right = _match(_mirrored(crop.right), _mirrored(crop.left), n, config.block_px)[:, ::-1]
    w = crop.target.shape[1]
    left = left[:, n : n + w]
    agrees = _agree(left, right, n, config.consistency_px)
    disparity = np.where(agrees & crop.lit, left, -1.0).astype(np.float32)
    speckled = np.round(disparity * 16).astype(np.int16)
    cv2.filterSpeckles(speckled, -16, config.speckle_px, 16)
    return Matched(
        np.where(speckled > 0, disparity, np.nan).astype(np.float32),
        np.where(left > 0, left, np.nan).astype(np.float32),
    )


def match_coarse(crop: Crop, config: Depth) -> Floats:
    """Disparities (h, w) [px] from images of half the size, unchecked; NaN where none."""
    n = crop.search_px
    height, width = crop.left.shape
    size = ((width + 1) // 2, (height + 1) // 2)
    left, right = (
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)) for image in (crop.left, crop.right)
    )
    least = 16 * -(-n // 32)
    # The matcher leaves the first columns out.
    left, right = (
        np.asarray(cv2.copyMakeBorder(image, 0, 0, least, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
        for image in (left, right)
    )
    found = _match(left, right, least, config.block_px + 2, 0)[:, least:]
    whole = cv2.resize(
        np.where(found > 0, 2.0 * found, np.nan), (width, height), interpolation=cv2.INTER_LINEAR
    )
    return np.asarray(whole[:, n : n + crop.target.shape[1]], dtype=np.float32)


def _match(image: Image, other: Image, disparities: int, block: int, uniqueness: int = 4) -> Floats:
    """Disparities of ``image`` (H, W) [px], below zero where none."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=disparities,
        blockSize=block,
        P1=8 * block * block,
        P2=40 * block * block,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=uniqueness,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    return np.asarray(matcher.compute(image, other), dtype=np.float32) / np.float32(16.0)


def _mirrored(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def _agree(left: Floats, right: Floats, margin_px: int, tolerance_px: float) -> Bools:
    """Where the disparity at the matched pixel of the right image (H, w + 2 margin) is the same."""
    w = left.shape[1]
    columns = np.arange(w)[None, :] + margin_px - np.round(left).astype(np.int64)
    back = np.take_along_axis(right, np.clip(columns, 0, right.shape[1] - 1), axis=1)
    return np.asarray((left > 0) & (back > 0) & (np.abs(left - back) <= tolerance_px))
