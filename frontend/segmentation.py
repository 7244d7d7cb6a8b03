"""The target's mask in an image: what is brighter than the sky, with or without dim surroundings.

A laboratory is not as black as space: the cloth under an object is brighter than what is behind it, and would
belong to the target. It is left out of a sequence in which it shows as surroundings throughout: it reaches
the border of every image, the target in none, and the target is several times as bright. A spacecraft that
leaves the image, or has dark panels, does not do so in every image.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Bools

Image = NDArray[np.uint8]
_STEPS = 31
"""Of an octave, in a histogram of 256 bins."""
OUTLINE_PX = 3
"""Distance to which blur and smoothing carry a target's brightness beyond its edge."""


def target_mask(image: Image, given: Bools | None = None, border: Bools | None = None) -> Bools:
    """Mask (H, W) of the target: the given one, or the pixels brighter than the sky, closed over shadows.

    border (H, W): pixels along the border of what the camera sees, to leave out dim surroundings that reach
    it; None: there are none.
    """
    if given is not None:
        return given
    smooth = _smooth(image)
    lit = _lit_parts(smooth, sky_level(smooth))
    if border is None:
        return lit
    classes = _classes(smooth, lit, border)
    return lit if classes is None or not classes.distinct else classes.target


def has_surroundings(images: Iterable[Image], border: Bools) -> bool:
    """Whether each of several images of a sequence (H, W) shows dim surroundings, which reach its border."""
    any_image = False
    for image in images:
        any_image = True
        smooth = _smooth(image)
        classes = _classes(smooth, _lit_parts(smooth, sky_level(smooth)), border)
        if classes is None or not classes.distinct:
            return False
    return any_image


def lit_border(image: Image, border: Bools) -> float:
    """Share of an image's border (H, W) along which what is taken for the target reaches it."""
    return float(target_mask(image)[border].mean())


def border_of(seen: Bools) -> Bools:
    """The pixels along the border of what a camera sees (H, W)."""
    framed = cv2.copyMakeBorder(seen.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    size = 2 * 3 + 1  # the border is 3 px wide
    inner = cv2.erode(framed, np.ones((size, size), dtype=np.uint8), borderValue=0)[1:-1, 1:-1]
    return np.asarray(seen & (inner == 0))


def sky_level(smooth: Image) -> float:
    """Intensity above which a smoothed pixel is not sky: the darkest level plus four times its scatter."""
    count = np.bincount(smooth.ravel(), minlength=256)
    level, below = np.arange(256), np.cumsum(count)
    dark = level <= _quantile(below, 0.1)  # share of the pixels, the darkest ones, that show the sky's level
    number = int(below[dark][-1])
    mean = float(np.sum((count * level)[dark])) / number
    scatter = float(np.sqrt(np.sum((count * (level - mean) ** 2)[dark]) / number))
    return _quantile(below[dark], 0.5) + 4.0 * max(1.0, scatter)


def _quantile(below: NDArray[np.int64], share: float) -> float:
    """Of intensities, ``below`` of which do not exceed 0, 1, ...; between neighbours it is interpolated."""
    place = share * (int(below[-1]) - 1)
    first = int(place)
    lower, upper = (int(np.searchsorted(below, each, side="right")) for each in (first, first + 1))
    upper = min(upper, len(below) - 1)
    return lower + (place - first) * (upper - lower)


@dataclass(frozen=True)
class _Classes:
    """What is brighter than the sky, in two classes of brightness."""

    target: Bools
    """(H, W) the brighter one"""
    octaves: float
    """Between the means of the classes"""
    contact: float
    """Share of the border that is brighter than the sky"""
    of_target: float
    """Share of that contact that is the target's"""

    @property
    def distinct(self) -> bool:
        """Whether the dimmer class is surroundings rather than a part of the target."""
        # smallest part of the border along which surroundings are brighter than the sky
        # largest part of that contact that the target may have itself
        # smallest ratio of brightness between target and surroundings, as a power of two
        return (
            self.contact > 0.05 and self.of_target <= 0.1 and self.octaves > 2.0 and bool(self.target.any())
        )


def _classes(smooth: Image, lit: Bools, border: Bools) -> _Classes | None:
    """Two classes of the lit pixels by the logarithm of their intensity; None: there are no two.

    They part at the rarest intensity between the most frequent one of the brighter class and the threshold of
    Otsu, "A threshold selection method from gray-level histograms", IEEE Trans. SMC 9(1), 1979.
    """
    octaves = np.log2(np.maximum(smooth[lit], 1).astype(np.float32))
    if len(octaves) == 0 or octaves.min() == octaves.max():
        return None
    steps = np.round(octaves * _STEPS).astype(np.uint8).reshape(-1, 1)
    otsu = int(cv2.threshold(steps, 0, 255, cv2.THRESH_OTSU)[0])
    counts = np.bincount(steps[:, 0], minlength=256).astype(np.float32)[:, None]
    sigma = 0.15 * _STEPS  # of the smoothing, 0.15 octaves
    histogram = cv2.GaussianBlur(counts, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)[:, 0]
    mode = otsu + int(np.argmax(histogram[otsu:]))
    level = (otsu + int(np.argmin(histogram[otsu : mode + 1]))) / _STEPS
    bright = octaves > level
    if bright.all() or not bright.any():
        return None
    target = _up_to_edge(smooth, _lit_parts(smooth, float(2.0**level)) & lit)
    contact = int((lit & border).sum())
    return _Classes(
        target,
        float(octaves[bright].mean() - octaves[~bright].mean()),
        contact / max(int(border.sum()), 1),
        float((target & border).sum() / max(contact, 1)),
    )


def _up_to_edge(smooth: Image, target: Bools) -> Bools:
    """The target (H, W) up to the edges that blur hides: halfway from its brightness to that beside it.

    The level that parts two classes is near the darker one, so that what is above it reaches beyond the edge,
    and stereo would see the surroundings there as a rim of the target. Parts too thin to have a brightness
    away from their edges stay as they are.
    """
    whole = target.astype(np.uint8)
    core = _eroded(whole, OUTLINE_PX)
    size, means = (4 * OUTLINE_PX + 1, 4 * OUTLINE_PX + 1), []
    for where in (core, 1 - whole):
        share = cv2.blur(where.astype(np.float32), size)
        total = cv2.blur((smooth * where).astype(np.float32), size)
        means.append(np.where(share > 1e-6, total / np.maximum(share, np.float32(1e-6)), np.nan))
    brightness, beside = (mean.astype(np.float32) for mean in means)
    # a comparison with NaN is false
    beyond = (_eroded(whole, 2 * OUTLINE_PX) == 0) & (smooth < 0.5 * (brightness + beside))
    return np.asarray(target & ~beyond)


def _eroded(mask: Image, reach_px: int) -> Image:
    """A mask (H, W) of 0 and 1 without what lies within a distance of its outline."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1, 2 * reach_px + 1))
    return np.asarray(cv2.erode(mask, kernel), dtype=np.uint8)


def _smooth(image: Image) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5), dtype=np.uint8)


def _lit_parts(smooth: Image, level: float) -> Bools:
    """Mask (H, W) of the large parts that are brighter than a level, closed over shadows."""
    bright = (smooth > level).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    if count <= 1:
        return np.zeros(smooth.shape, dtype=bool)
    area = np.asarray(stats)[1:, cv2.CC_STAT_AREA].astype(np.int64)
    largest = int(area.max())
    # Shadow can separate parts of one spacecraft; stars and hot pixels are tiny.
    kept = np.concatenate([[False], area >= max(25, 0.02 * largest)])
    lit = kept.astype(np.uint8)[labels]
    reach = max(3, int(0.04 * np.sqrt(largest)) | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    return np.asarray(cv2.morphologyEx(lit, cv2.MORPH_CLOSE, kernel), dtype=bool)
