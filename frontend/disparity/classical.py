"""The classical method: least squares refine semi-global disparities, planes and facets smooth them.

Refinement is windowed least squares (Lucas and Kanade 1981) along the epipolar line: in a window,
left = gain * right(u - d - delta) + offset. The right image is warped with every pixel's own disparity, so
slanted surfaces do not bias delta. The information of the normal equations gives sigma.
"""

import cv2
import numpy as np

from polhode.config.frontend import Depth
from polhode.frontend.disparity.crop import Floats, StereoCrop
from polhode.frontend.disparity.planes import fit_facets, fit_planes
from polhode.frontend.disparity.sgbm import match_checked
from polhode.frontend.rectification.target import Image

REFINEMENTS = 3
"""Rounds of sub-pixel refinement and smoothing."""
PLANE_RADIUS_PX = 6
"""Half side of the windows in which the disparity is taken as a plane."""
SIGMA_FLOOR_PX = 0.05
"""Errors that the noise model omits: slant, specular reflection, interpolation."""
MIN_MATCHED_PIXELS = 50
"""With fewer matched pixels there is no disparity."""
_MAX_STEP_PX = 0.5


def classical_disparity(crop: StereoCrop, config: Depth) -> tuple[Floats, Floats]:
    """Disparities and their standard deviations (h, w) [px], NaN where there are none."""
    disparity = match_checked(crop, config)
    if np.isfinite(disparity).sum() < MIN_MATCHED_PIXELS:
        return np.full_like(disparity, np.nan), np.full_like(disparity, np.nan)
    sigma = np.full_like(disparity, 0.3)
    by_window, sigma_window = disparity, sigma
    correlated_px2 = float(config.window_px**2)
    for _ in range(REFINEMENTS):
        by_window, sigma_window = refine_dense(
            crop.left, crop.right, disparity, crop.search_px, config.window_px
        )
        disparity, sigma = fit_planes(by_window, sigma_window, PLANE_RADIUS_PX, correlated_px2)
    if config.facets:
        darkest = crop.sky + 2.0 * config.min_intensity
        facet, sigma_facet = fit_facets(
            crop.image, crop.lit, by_window, sigma_window, correlated_px2, darkest
        )
        flat = sigma_facet < np.where(np.isfinite(sigma), sigma, np.inf)
        disparity, sigma = np.where(flat, facet, disparity), np.where(flat, sigma_facet, sigma)
    return disparity.astype(np.float32), np.hypot(sigma, SIGMA_FLOOR_PX).astype(np.float32)


def refine_dense(
    left: Image | Floats, right: Image | Floats, disparity: Floats, margin_px: int, window_px: int
) -> tuple[Floats, Floats]:
    """One least-squares step for every pixel.

    left, right (h, w + 2 margin): the target is in columns margin..margin + w; disparity (h, w) [px]. Returns
    disparity and sigma (h, w) [px]; NaN where the input is NaN.
    """
    known = np.isfinite(disparity)
    h, w = disparity.shape
    reference = left[:, margin_px : margin_px + w].astype(np.float32)
    filled = np.where(known, disparity, 0.0).astype(np.float32)
    u = np.arange(w, dtype=np.float32)[None, :] + margin_px - filled
    v = np.broadcast_to(np.arange(h, dtype=np.float32)[:, None], (h, w)).copy()
    other = right.astype(np.float32)
    warped = _sample(other, u, v, cv2.INTER_CUBIC)
    slope = _slope(other)
    slope_right = _sample(slope, u, v, cv2.INTER_LINEAR)
    slope_left = _slope(left.astype(np.float32))[:, margin_px : margin_px + w]
    gradient = 0.5 * (slope_left + slope_right)

    weight = known.astype(np.float32)
    count = _mean(weight, window_px)
    safe = np.maximum(count, 1e-6)

    def mean(image: Floats) -> Floats:
        return np.asarray(_mean(weight * image, window_px) / safe, dtype=np.float32)

    m_left, m_warped, m_gradient = mean(reference), mean(warped), mean(gradient)
    var_left = mean(reference * reference) - m_left * m_left
    var_warped = mean(warped * warped) - m_warped * m_warped
    covariance = mean(reference * warped) - m_left * m_warped
    gain = np.clip(covariance / np.maximum(var_warped, 1.0), 0.6, 1.6)
    # The noise of the two images is independent: in the product of their slopes it does not look like
    # texture.
    gg = np.maximum(mean(slope_left * slope_right) - mean(slope_left) * mean(slope_right), 1e-3)
    error_gradient = (
        mean(reference * gradient)
        - m_left * m_gradient
        - gain * (mean(warped * gradient) - m_warped * m_gradient)
    )
    information = gain * gain * gg
    delta = -gain * error_gradient / information
    residual = var_left - 2 * gain * covariance + gain * gain * var_warped - delta * delta * information
    noise = np.maximum(residual, 1.0)
    samples = np.maximum(count * window_px**2, 1.0)
    sigma = np.sqrt(noise / (information * samples))
    delta = np.clip(delta, -_MAX_STEP_PX, _MAX_STEP_PX)
    # An uncertain step is shortened.
    delta *= 0.3**2 / (0.3**2 + np.minimum(sigma, 10.0) ** 2)
    return (
        np.where(known, disparity + delta, np.nan).astype(np.float32),
        np.where(known, sigma, np.nan).astype(np.float32),
    )


def _sample(image: Floats, u: Floats, v: Floats, interpolation: int) -> Floats:
    """Values at sub-pixel positions."""
    sampled = cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32)


def _slope(image: Floats) -> Floats:
    """Derivative along the row [1/px]: central differences."""
    kernel = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
    return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel), dtype=np.float32)


def _mean(image: Floats, window_px: int) -> Floats:
    """Mean over a square window; pixels outside the image count as 0."""
    blurred = cv2.blur(image, (window_px, window_px), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
