"""The target's crop of a rectified pair, and whole-pixel disparities in it by semi-global matching.

The crop is shifted so that disparities start at zero. Matches pass a left-right consistency check.
Hirschmueller, "Stereo processing by semiglobal matching and mutual information", 2008, by OpenCV.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.frontend_settings import Depth
from polhode.frontend.rectification import Image
from polhode.geometry.lie import Bools

Floats = NDArray[np.float32]
WINDOW_PX = 7
"""Side of the window of the sub-pixel refinement, odd."""
MIN_INTENSITY = 6.0
"""Pixels that exceed the sky's level by less are unlit: they have no depth."""


@dataclass(frozen=True)
class StereoCrop:
    """Images around the target; the right one is shifted by ``shift_px``, so that disparities start at 0."""

    left: Image
    """(h, w + 2 search) with a margin of the search range on both sides"""
    right: Image
    """(h, w + 2 search)"""
    lit: Bools
    """(h, w) pixels of the target that are brighter than the sky"""
    target: Bools
    """(h, w)"""
    v0: int
    """First row of the crop in the image."""
    u0: int
    """First column of ``lit`` and ``target`` in the image."""
    shift_px: int
    """Disparity in the image minus disparity in the crop."""
    search_px: int
    """Number of disparities; a multiple of 16."""
    sky: float
    """Intensity of the sky."""

    @property
    def image(self) -> Image:
        """(h, w) the left image without the margins."""
        return self.left[:, self.search_px : self.search_px + self.lit.shape[1]]

    @property
    def inner(self) -> tuple[slice, slice]:
        """Rows and columns of ``target`` in the whole image."""
        h, w = self.target.shape
        return slice(self.v0, self.v0 + h), slice(self.u0, self.u0 + w)


def cut_crop(
    left: Image, right: Image, mask: Bools, range_px: tuple[float, float], config: Depth
) -> StereoCrop:
    """Cut out the target, whose mask (H, W) is not empty; beyond the image its border is repeated.

    range_px: smallest and largest disparity of the target.
    """
    margin = max(config.block_px, WINDOW_PX) + 2
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
    lit = target & (smooth > sky + MIN_INTENSITY)
    return StereoCrop(cut_left, cut_right, lit, target, v0, u0, shift, search, sky)


def _columns(image: Image, start: int, stop: int) -> Image:
    """Columns start..stop of an image; those beyond it repeat its border."""
    inside = image[:, max(start, 0) : max(min(stop, image.shape[1]), 1)]
    before, after = max(-start, 0), max(stop - image.shape[1], 0)
    padded = cv2.copyMakeBorder(inside, 0, 0, before, after, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(padded[:, : stop - start])


def match_checked(crop: StereoCrop, config: Depth) -> Floats:
    """Semi-global disparities of the target (h, w) [px] after the left-right check, otherwise NaN."""
    return match_left_right(crop, config)[0]


def match_left_right(crop: StereoCrop, config: Depth) -> tuple[Floats, Floats]:
    """Semi-global disparities (h, w) [px] after and before the left-right check; NaN where there are none.

    Those after it are NaN also where the target is dark, and in speckles.
    """
    n = crop.search_px
    left = _match(crop.left, crop.right, n, config.block_px)
    # The right image's disparities come from the mirrored pair.
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in (crop.right, crop.left)]
    right = _match(mirrored[0], mirrored[1], n, config.block_px)[:, ::-1]
    w = crop.target.shape[1]
    left = left[:, n : n + w]
    columns = np.arange(w)[None, :] + n - np.round(left).astype(np.int64)
    back = np.take_along_axis(right, np.clip(columns, 0, right.shape[1] - 1), axis=1)
    # largest difference between the left and the right image's disparity
    agrees = (left > 0) & (back > 0) & (np.abs(left - back) <= 1.0)
    disparity = np.where(agrees & crop.lit, left, -1.0).astype(np.float32)
    speckled = np.round(disparity * 16).astype(np.int16)
    cv2.filterSpeckles(speckled, -16, 60, 16)  # patches of disparity with fewer pixels are removed
    return (
        np.where(speckled > 0, disparity, np.nan).astype(np.float32),
        np.where(left > 0, left, np.nan).astype(np.float32),
    )


def match_coarse(crop: StereoCrop, config: Depth) -> Floats:
    """Disparities (h, w) [px] from images of half the size, without the check; NaN where there are none."""
    n = crop.search_px
    height, width = crop.left.shape
    size = ((width + 1) // 2, (height + 1) // 2)
    left, right = (
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)) for image in (crop.left, crop.right)
    )
    search = 16 * -(-n // 32)
    # The matcher omits the first ``search`` columns.
    left, right = (
        np.asarray(cv2.copyMakeBorder(image, 0, 0, search, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)
        for image in (left, right)
    )
    found = _match(left, right, search, config.block_px + 2, 0)[:, search:]
    whole = cv2.resize(
        np.where(found > 0, 2.0 * found, np.nan), (width, height), interpolation=cv2.INTER_LINEAR
    )
    return np.asarray(whole[:, n : n + crop.target.shape[1]], dtype=np.float32)


def _match(image: Image, other: Image, disparities: int, block: int, uniqueness: int = 4) -> Floats:
    """Disparities of ``image`` (H, W) [px], below zero where there is no match."""
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
