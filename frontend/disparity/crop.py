"""The part of a rectified pair that shows the target, shifted so that disparities start at zero."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.frontend import Depth
from polhode.frontend.rectification.target import Image
from polhode.records import Bools

Floats = NDArray[np.float32]


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
    return StereoCrop(cut_left, cut_right, lit, target, v0, u0, shift, search, sky)


def _columns(image: Image, start: int, stop: int) -> Image:
    """Columns start..stop of an image; those beyond it repeat its border."""
    inside = image[:, max(start, 0) : max(min(stop, image.shape[1]), 1)]
    before, after = max(-start, 0), max(stop - image.shape[1], 0)
    padded = cv2.copyMakeBorder(inside, 0, 0, before, after, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(padded[:, : stop - start])
