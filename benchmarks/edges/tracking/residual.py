"""Does the image support a pose: what C^-1 cannot tell, which stays small after convergence to a wrong one.

Each control point is supported when the image has an edge within a pixel of it that runs the same way. What
counts is how much length of the model is supported, in whole edges, beyond what edges displaced by some
pixels find by chance in the same image, and whether the body ends at its limbs.
"""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.edges.tracking.edge_search import Levels, as_levels, gradients, levels, search
from benchmarks.edges.tracking.tracker import TrackerOptions, TrackingResult, polarity
from polhode.lie import Array
from polhode.records import Bools

CLOSE_PX = 1.0
"""An edge of the image that is nearer supports the model's."""
ALIGNED = 0.9
"""Cosine between the gradient and the model's normal from which they run the same way: 26 degrees."""
DISPLACED_PX = (-9.0, -6.5, 6.5, 9.0)
"""Where chance is measured, along the normals."""
WHOLE = 0.7
"""An edge counts as seen from this share of its length."""
SKY_PX = 5.0
"""How far outside a limb the sky is looked at."""


@dataclass(frozen=True)
class EdgeSupport:
    """How an image supports a pose: shares of the expected length of edge, 0 to 1, but for the last two."""

    found: float
    """with an edge within the tracker's last range: the binary metric"""
    close: float
    """with an edge within a pixel"""
    supported: float
    """with an edge within a pixel that runs the same way"""
    whole: float
    """in edges that are supported over most of their length"""
    limb: float
    """of what lies against the sky: supported, and dark outside; 1 without any"""
    chance: float
    """what edges displaced by some pixels find supported"""
    sigma_px: float
    """of the residuals, robustly weighted; inf where there are too few"""

    @property
    def beyond_chance(self) -> float:
        """Supported length beyond chance, 1 when all is supported."""
        return (self.supported - self.chance) / max(1.0 - self.chance, 1e-9)

    @property
    def as_features(self) -> Array:
        """(6,) for `score`."""
        found, close, supported, whole, limb, *_ = astuple(self)
        return np.array([found, close, supported, whole, limb, self.beyond_chance])


def support(tracked: TrackingResult, image: ArrayLike, wanted: TrackerOptions | None = None) -> EdgeSupport:
    """Support of a tracked pose by the image (H, W) that it was tracked in, or by another."""
    wanted = wanted or TrackerOptions()
    points = tracked.points
    length = points.weight
    if len(points) == 0:
        return EdgeSupport(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf)
    grey = as_levels(image)
    sign = polarity(tracked.beside)
    close, along = _near(tracked, grey, 0.0, wanted)
    chance = [_share(_near(tracked, grey, by, wanted)[1], length) for by in DISPLACED_PX]
    feature = points.feature
    per_edge = np.bincount(feature, length * along) / np.maximum(np.bincount(feature, length), 1e-12)
    limb = sign != 0
    outside = levels(grey, points.uv_px - SKY_PX * sign[:, None] * points.normal_px)
    inside = levels(grey, points.uv_px + 0.5 * SKY_PX * sign[:, None] * points.normal_px)
    dark = outside < 0.5 * inside
    return EdgeSupport(
        tracked.found_share,
        _share(close, length),
        _share(along, length),
        _share(per_edge[feature] >= WHOLE, length),
        _share((along & dark)[limb], length[limb]) if limb.any() else 1.0,
        float(np.mean(chance)),
        tracked.sigma_px,
    )


def _near(tracked: TrackingResult, grey: Levels, by_px: float, wanted: TrackerOptions) -> tuple[Bools, Bools]:
    """(m,) whether an edge lies within CLOSE_PX of points displaced by so much; and runs the same way."""
    points = tracked.points
    uv = points.uv_px + by_px * points.normal_px
    either = np.zeros(len(points), dtype=np.int64)
    found = search(grey, uv, points.normal_px, either, CLOSE_PX, wanted.min_contrast)
    close: Bools = np.any(np.isfinite(found.offset_px), axis=1)
    which = np.argmax(np.abs(found.contrast), axis=1)
    offset = np.nan_to_num(found.offset_px[np.arange(len(points)), which])
    slope = gradients(grey, uv + offset[:, None] * points.normal_px)
    across = np.abs(np.einsum("mk,mk->m", slope, points.normal_px))
    along = across >= ALIGNED * np.linalg.norm(slope, axis=1)
    return close, close & along


def _share(which: Bools, length: Array) -> float:
    return float(length[which].sum() / max(length.sum(), 1e-12))


FEATURES = ("found", "close", "supported", "whole", "limb", "beyond chance")
WEIGHTS = (-26.7, 7.1, 6.6, 3.2, 6.0, 4.9, 2.9)
"""Constant and weights of a logistic regression on half of the bodies of benchmarks.observability, on images
whose rays were not scattered yet; it prints what it would learn now, and tests on the other half."""
TRUSTED = 0.9
"""Probability from which a pose is kept"""


def probability(features: Array) -> Array:
    """(n,) that poses with features (n, 6) are right, where half of all are."""
    constant, *weights = WEIGHTS
    return np.asarray(1.0 / (1.0 + np.exp(-(constant + features @ np.array(weights)))))
