"""Planes through facets without texture, held by what lies along their edges.

Inside an evenly lit, painted panel no window tells the disparity, but its outline, and marks on it, do: a
flat facet is a plane in disparity. Each even patch of the image gets the plane that its surroundings agree
on (iteratively reweighted least squares), and the plane's covariance says how far it may be carried.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from polhode.records import Bools

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
_LEAST_AREA_PX = 40
_EVEN_RANGE = 0.15
"""Spread of the intensity over a facet, as a share of the intensity."""
_EDGE_PX = 4
"""What lies this far around an even patch still belongs to its facet."""
_EVEN_SLOPE = 0.025
"""Slope of the intensity that still counts as even, as a share of the intensity [1/px]."""
_NOISE_SLOPE = 2.0
"""Largest slope that is put down to noise [8-bit levels/px]."""
_SCALES_PX = (2.0, 1.0, 0.5, 0.3)
"""Scale of the robust kernel, round by round."""
_LEAST_AGREEMENT = 0.6
"""Share of the information around a patch that must agree with its plane."""
_AGREEMENT_PX = 0.3
"""Windows along an edge mix two facets: they may differ by this beside their own noise."""
_MODEL_PX = 0.12
"""What a facet may differ from a plane."""


@dataclass(frozen=True)
class _Plane:
    """d = value + a (u - u0) + b (v - v0), with the covariance of (value, a, b)."""

    theta: Doubles
    covariance: Doubles
    centre: tuple[float, float]

    def at(self, u: Doubles, v: Doubles) -> tuple[Doubles, Doubles]:
        """Disparity and sigma (n,) [px] at pixels."""
        basis = np.stack([np.ones_like(u), u - self.centre[0], v - self.centre[1]], axis=1)
        variance = np.einsum("ni,ij,nj->n", basis, self.covariance, basis)
        return basis @ self.theta, np.sqrt(variance + _MODEL_PX**2)


def even_patches(image: NDArray[np.uint8], inside: Bools) -> tuple[NDArray[np.int32], int]:
    """Labels (h, w) of connected patches of hardly changing intensity, 0 elsewhere; and their number."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    slope_u = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3) / 8.0
    slope_v = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3) / 8.0
    slope = np.hypot(slope_u, slope_v)
    # Even pixels show the sensor's noise; where texture is everywhere, the lowest slopes are still texture.
    noise = float(np.percentile(slope[inside], 20)) if inside.any() else 0.0
    even = inside & (slope < np.maximum(min(2.5 * noise, _NOISE_SLOPE), _EVEN_SLOPE * smooth))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(even.astype(np.uint8), connectivity=4)
    small = np.flatnonzero(np.asarray(stats)[:, cv2.CC_STAT_AREA] < _LEAST_AREA_PX)
    labels = np.asarray(labels, dtype=np.int32)
    labels[np.isin(labels, small)] = 0
    return labels, count


def fit_facets(
    image: NDArray[np.uint8],
    inside: Bools,
    disparity: Floats,
    sigma: Floats,
    correlated_px2: float,
    darkest: float,
) -> tuple[Floats, Floats]:
    """Disparity and sigma (h, w) [px] on even patches of the image that are planes; NaN elsewhere.

    inside (h, w): lit pixels of the target; disparity, sigma (h, w): of every pixel by its own window, NaN
    where none; darkest: darker facets are left out; correlated_px2: area over which neighbours err alike.
    """
    labels, count = even_patches(image, inside)
    value = np.full(disparity.shape, np.nan, dtype=np.float32)
    spread = np.full(disparity.shape, np.nan, dtype=np.float32)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1))
    known = np.isfinite(disparity) & np.isfinite(sigma)
    for label, place in enumerate(find_objects(labels, max_label=count - 1), start=1):
        if place is None:
            continue
        rows, columns = np.nonzero(labels[place] == label)
        rows, columns = rows + place[0].start, columns + place[1].start
        box = (
            slice(max(rows.min() - _EDGE_PX, 0), rows.max() + _EDGE_PX + 1),
            slice(max(columns.min() - _EDGE_PX, 0), columns.max() + _EDGE_PX + 1),
        )
        if not _evenly_lit(image[rows, columns], darkest):
            continue
        patch = cv2.dilate((labels[box] == label).astype(np.uint8), kernel) > 0
        v, u = np.nonzero(patch & known[box])
        v, u = v + box[0].start, u + box[1].start
        plane = _fit(u, v, disparity[v, u], sigma[v, u], correlated_px2)
        if plane is not None:
            at = plane.at(columns.astype(np.float64), rows.astype(np.float64))
            value[rows, columns], spread[rows, columns] = at
    return value, spread


def _evenly_lit(intensity: NDArray[np.uint8], darkest: float) -> bool:
    """A flat facet in sunlight has one brightness; a curved one shades; what is dark may be anything."""
    low, middle, high = np.percentile(intensity, [5.0, 50.0, 95.0])
    return bool(middle > darkest and high - low < _EVEN_RANGE * middle + 4.0)


def _fit(
    u: NDArray[np.int64], v: NDArray[np.int64], d: Floats, sigma: Floats, correlated_px2: float
) -> _Plane | None:
    """The plane that most of the information agrees on, or None."""
    if len(u) < _LEAST_AREA_PX:
        return None
    centre = (float(u.mean()), float(v.mean()))
    basis = np.stack([np.ones(len(u)), u - centre[0], v - centre[1]], axis=1).astype(np.float64)
    information = 1.0 / (sigma.astype(np.float64) ** 2 + 0.05**2)
    weight = information
    values = d.astype(np.float64)
    for scale in _SCALES_PX:
        normal = (basis * weight[:, None]).T @ basis + 1e-9 * np.eye(3)
        theta = np.asarray(np.linalg.solve(normal, basis.T @ (weight * values)), dtype=np.float64)
        residual = values - basis @ theta
        weight = information / (1.0 + (residual / scale) ** 2) ** 2
    agrees = np.abs(residual) < 2.5 * np.hypot(sigma, _AGREEMENT_PX)
    if information[agrees].sum() < _LEAST_AGREEMENT * information.sum():
        return None
    normal = (basis * weight[:, None]).T @ basis + 1e-9 * np.eye(3)
    scatter = float(np.sum(weight * residual**2) / max(len(u) - 3, 1))
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64) * correlated_px2 * max(1.0, scatter)
    return _Plane(theta, covariance, centre)
