"""Sub-pixel disparities by windowed least squares (Lucas and Kanade 1981, along the epipolar line).

In a window, left = gain * right(u - d - delta) + offset; the right image is warped with every pixel's own
disparity, so slanted surfaces do not bias delta. The normal equation's information gives sigma.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]
_LARGEST_STEP_PX = 0.5


def refine_dense(
    left: Image | Floats, right: Image | Floats, disparity: Floats, margin_px: int, window_px: int
) -> tuple[Floats, Floats]:
    """One step. left, right (h, w + 2 margin), target in columns margin..margin + w; disparity (h, w) [px].

    Returns disparity and sigma (h, w) [px]; NaN where the input is NaN.
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
    # The product of the two images' slopes: their noise is independent, so it does not pass for texture.
    gg = np.maximum(mean(slope_left * slope_right) - mean(slope_left) * mean(slope_right), 1e-3)
    error_gradient = (
        mean(reference * gradient)
        - m_left * m_gradient
        - gain * (mean(warped * gradient) - m_warped * m_gradient)
    )
    information = gain * gain * gg
    delta = -gain * error_gradient / information
    left_over = var_left - 2 * gain * covariance + gain * gain * var_warped - delta * delta * information
    noise = np.maximum(left_over, 1.0)
    samples = np.maximum(count * window_px**2, 1.0)
    sigma = np.sqrt(noise / (information * samples))
    delta = np.clip(delta, -_LARGEST_STEP_PX, _LARGEST_STEP_PX)
    # A weak window moves its pixel less than it asks for.
    delta *= 0.3**2 / (0.3**2 + np.minimum(sigma, 10.0) ** 2)
    return (
        np.where(known, disparity + delta, np.nan).astype(np.float32),
        np.where(known, sigma, np.nan).astype(np.float32),
    )


def _sample(image: Floats, u: Floats, v: Floats, interpolation: int) -> Floats:
    """Values at sub-pixel places."""
    sampled = cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32)


def _slope(image: Floats) -> Floats:
    """Derivative along the row [1/px]: central differences."""
    kernel = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
    return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel), dtype=np.float32)


def _mean(image: Floats, window_px: int) -> Floats:
    """Mean over a square window; what is outside counts as 0."""
    blurred = cv2.blur(image, (window_px, window_px), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
