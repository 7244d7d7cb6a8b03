"""Segmentation of the target: by its brightness against the black sky, or by a given mask."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.records import Bools

Image = NDArray[np.uint8]


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
