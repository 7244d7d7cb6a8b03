"""Smoothing of disparities by local planes: a flat facet of the target is a plane in disparity, exactly.

Around every pixel the plane is fitted in several windows, centred and shifted; the one with the least
scatter is used (Kuwahara's idea), so edges between facets are not rounded. Where even that plane leaves more
than the noise, the surface is rough at this size and windows of half the size are used.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
_LEAST_SHARE = 0.3
_OUTLIER = 3.0
_ROUGH = 2.0
"""Mean squared distance from the plane, in variances: above it the surface is no plane at this size."""


def fit_planes(
    disparity: Floats, sigma: Floats, radius_px: int, correlated_px2: float
) -> tuple[Floats, Floats]:
    """Smoothed disparity and its sigma (h, w) [px] from noisy ones; NaN stays NaN.

    correlated_px2: area over which the errors of neighbours are the same, so that averaging gains nothing.
    """
    known = np.isfinite(disparity) & np.isfinite(sigma)
    d = np.where(known, disparity, 0.0).astype(np.float64)
    weight = np.where(known, 1.0 / (np.square(np.where(known, sigma, 1.0), dtype=np.float64) + 0.05**2), 0.0)
    plane, _, _ = _best_plane(d, weight, radius_px, correlated_px2)
    scatter = np.abs(d - plane)
    limit = _OUTLIER * np.hypot(np.where(known, sigma, 1.0), 0.1)
    robust = np.where(scatter < limit, weight, 0.01 * weight)
    plane, variance, good = _best_plane(d, robust, radius_px, correlated_px2)
    rough = cv2.blur(np.square(d - plane) * weight, (5, 5)) > _ROUGH
    if rough.any():
        near, near_variance, near_good = _best_plane(d, robust, max(radius_px // 2, 1), correlated_px2)
        rough &= near_good
        plane, variance = np.where(rough, near, plane), np.where(rough, near_variance, variance)
        good |= rough
    out = known & good
    return (
        np.where(out, plane, np.nan).astype(np.float32),
        np.where(out, np.sqrt(variance), np.nan).astype(np.float32),
    )


def _best_plane(
    d: Doubles, weight: Doubles, radius_px: int, correlated_px2: float
) -> tuple[Doubles, Doubles, NDArray[np.bool_]]:
    """Value of the best window's plane at each pixel, its variance, and whether there is one."""
    h, w = d.shape
    v, u = np.mgrid[:h, :w].astype(np.float64)
    a, b, value, scatter, variance, share = _plane_per_window(d, weight, u, v, radius_px, correlated_px2)
    usable = share > _LEAST_SHARE
    score = np.where(usable, scatter, np.inf)
    best, best_value, best_variance = score.copy(), value.copy(), variance.copy()
    r = max(1, round(0.7 * radius_px))
    for dv in (-r, 0, r):
        for du in (-r, 0, r):
            if du == dv == 0:
                continue
            # The window centred at (u + du, v + dv) extrapolates its plane to (u, v).
            shifted_score = 1.15 * _shift(score, du, dv, np.inf)
            shifted = _shift(value, du, dv, 0.0) - du * _shift(a, du, dv, 0.0) - dv * _shift(b, du, dv, 0.0)
            better = shifted_score < best
            best = np.where(better, shifted_score, best)
            best_value = np.where(better, shifted, best_value)
            best_variance = np.where(better, 3.0 * _shift(variance, du, dv, 0.0), best_variance)
    return best_value, best_variance, np.isfinite(best)


def _plane_per_window(
    d: Doubles, weight: Doubles, u: Doubles, v: Doubles, radius_px: int, correlated_px2: float
) -> tuple[Doubles, Doubles, Doubles, Doubles, Doubles, Doubles]:
    """Slopes a, b, value at the centre, mean squared scatter, the value's variance, filled share; (h, w)."""
    size = 2 * radius_px + 1

    def total(image: Doubles) -> Doubles:
        return np.asarray(cv2.boxFilter(image, cv2.CV_64F, (size, size), normalize=False, borderType=0))

    s, su, sv = total(weight), total(weight * u), total(weight * v)
    safe = np.maximum(s, 1e-9)
    mu, mv, md = su / safe, sv / safe, total(weight * d) / safe
    uu = total(weight * u * u) / safe - mu * mu + 1e-3
    vv = total(weight * v * v) / safe - mv * mv + 1e-3
    uv = total(weight * u * v) / safe - mu * mv
    ud = total(weight * u * d) / safe - mu * md
    vd = total(weight * v * d) / safe - mv * md
    dd = total(weight * d * d) / safe - md * md
    determinant = np.maximum(uu * vv - uv * uv, 1e-6)
    a = (ud * vv - vd * uv) / determinant
    b = (vd * uu - ud * uv) / determinant
    value = md + a * (u - mu) + b * (v - mv)
    scatter = np.maximum(dd - a * ud - b * vd, 0.0) + 1e-4
    count = total((weight > 0).astype(np.float64))
    # Neighbouring disparities share a window of pixels: far fewer are independent.
    independent = np.maximum(count / correlated_px2, 1.0)
    variance = np.maximum(scatter, 0.0) / independent + correlated_px2 / np.maximum(s, 1e-9)
    return a, b, value, scatter, variance, count / size**2


def _shift(image: Doubles, du: int, dv: int, outside: float) -> Doubles:
    """out[v, u] = image[v + dv, u + du]; ``outside`` where that is not in the image."""
    out = np.full_like(image, outside)
    h, w = image.shape
    rows, columns = slice(max(0, -dv), min(h, h - dv)), slice(max(0, -du), min(w, w - du))
    source = (slice(max(0, dv), min(h, h + dv)), slice(max(0, du), min(w, w + du)))
    out[rows, columns] = image[source]
    return out
