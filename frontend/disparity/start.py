"""The classical disparity that the network starts from, without holes, and its rivals.

Every pixel gets six hypotheses: the checked and refined disparity, its holes filled from their rims; the
farthest and the nearest disparity around (a rim belongs to one of the two); what semi-global matching says
there unchecked; the plane of an even facet; and what matching says on images of half the size, where weak
texture weighs more.
"""

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config.depth import Depth
from polhode.frontend.disparity.crop import Crop
from polhode.frontend.disparity.facets import fit_facets
from polhode.frontend.disparity.refinement import refine_dense
from polhode.frontend.disparity.sgbm import match_both_ways, match_coarse
from polhode.records import Bools

Floats = NDArray[np.float32]
REACH_PX = 5
"""How far away a disparity is still a rival."""
FEWEST = 50
"""Fewer matched pixels are no start."""
_WINDOW_PX = 9
_TRUST_PX = 0.3
_LEAST_CONTRAST = 4.0
"""Added to the standard deviation of a window [8-bit levels]: noise does not become texture."""


@dataclass(frozen=True)
class Start:
    """What the network is given, on the crop (h, w); images (h, w + 2 margin)."""

    left: Floats
    """(h, w) grey levels over the sky"""
    right: Floats
    """(h, w + 2 margin) grey levels over the sky"""
    even_left: Floats
    """(h, w) the local mean taken out, divided by the local contrast"""
    even_right: Floats
    """(h, w + 2 margin)"""
    filled: Floats
    """(h, w) [px] finite everywhere"""
    far: Floats
    near: Floats
    unchecked: Floats
    facet: Floats
    coarse: Floats
    facet_trust: Floats
    """(h, w) 1 on a facet whose plane is certain, 0 on none"""
    sigma: Floats
    """(h, w) of ``filled`` [px] by the least squares; NaN where it was filled in"""
    lit: Bools
    target: Bools
    margin_px: int

    def part(self, rows: slice, columns: slice) -> "Start":
        """A rectangle of it, given by rows and columns of the crop, with the right image's margins."""
        wide = slice(columns.start, columns.stop + 2 * self.margin_px)
        cut = {
            f.name: getattr(self, f.name)[rows, wide if "right" in f.name else columns]
            for f in fields(self)
            if f.name != "margin_px"
        }
        return Start(**cut, margin_px=self.margin_px)


def classical_start(crop: Crop, config: Depth) -> Start | None:
    """Match, refine once, fill; None when almost nothing matches."""
    matched = match_both_ways(crop, config)
    if np.isfinite(matched.checked).sum() < FEWEST:
        return None
    refined, sigma = refine_dense(crop.left, crop.right, matched.checked, crop.search_px, config.window_px)
    filled = fill_holes(refined)
    facet, sigma_facet = fit_facets(
        crop.image,
        crop.lit,
        refined,
        sigma,
        float(config.window_px**2),
        crop.sky + 2.0 * config.min_intensity,
    )
    flat = np.isfinite(facet)
    known = np.isfinite(refined)
    kernel = np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), dtype=np.uint8)
    near = np.asarray(cv2.dilate(np.where(known, refined, -1e9).astype(np.float32), kernel))
    far = np.asarray(cv2.erode(np.where(known, refined, 1e9).astype(np.float32), kernel))
    n, w = crop.search_px, crop.target.shape[1]
    levels = [image.astype(np.float32) - np.float32(crop.sky) for image in (crop.left, crop.right)]
    even = [evened(image) for image in levels]
    return Start(
        left=levels[0][:, n : n + w],
        right=levels[1],
        even_left=even[0][:, n : n + w],
        even_right=even[1],
        filled=filled,
        far=np.where(far < 1e8, far, filled),
        near=np.where(near > -1e8, near, filled),
        unchecked=np.where(np.isfinite(matched.unchecked), matched.unchecked, filled),
        facet=np.where(flat, facet, filled),
        coarse=fill_holes(match_coarse(crop, config)),
        facet_trust=np.where(flat, np.exp(-sigma_facet / _TRUST_PX), 0.0).astype(np.float32),
        sigma=sigma,
        lit=crop.lit,
        target=crop.target,
        margin_px=n,
    )


def evened(image: Floats) -> Floats:
    """Grey levels without the local mean, in units of the local contrast."""
    size = (_WINDOW_PX, _WINDOW_PX)
    mean = cv2.blur(image, size)
    variance = np.maximum(cv2.blur(image * image, size) - mean * mean, 0.0)
    return np.asarray((image - mean) / (np.sqrt(variance) + _LEAST_CONTRAST), dtype=np.float32)


def fill_holes(disparity: Floats) -> Floats:
    """NaN replaced by a smooth surface through what is known: means of ever coarser images."""
    known = np.isfinite(disparity)
    value, weight = np.where(known, disparity, 0.0).astype(np.float32), known.astype(np.float32)
    if known.all() or not known.any():
        return value
    h, w = disparity.shape
    if max(h, w) == 1:
        return value
    half = ((w + 1) // 2, (h + 1) // 2)
    weight_half = cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    value_half = cv2.resize(value * weight, half, interpolation=cv2.INTER_AREA)
    seen = weight_half > 1e-6
    coarse = np.where(seen, value_half / np.where(seen, weight_half, 1.0), np.nan).astype(np.float32)
    below = cv2.resize(fill_holes(coarse), (w, h), interpolation=cv2.INTER_LINEAR)
    return np.where(known, value, below).astype(np.float32)
