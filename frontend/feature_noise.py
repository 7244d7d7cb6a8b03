"""How certain a surface feature's measurement is: the standard deviations of u, v and disparity."""

import numpy as np

from frontend.stereo import MIN_SIGMA_DISPARITY_PX, SIGMA_UV_PX
from polhode.lie import Array


def feature_sigma(scale_px: Array, sigma_disparity_px: Array, correlation: Array) -> Array:
    """Standard deviations (n, 3) [px] of u, v and disparity between views of the target."""
    uv = np.full(len(scale_px), SIGMA_UV_PX)
    return np.column_stack([uv, uv, np.maximum(sigma_disparity_px, MIN_SIGMA_DISPARITY_PX)])
