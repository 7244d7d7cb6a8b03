"""The last hundredths of a pixel: what the network says, one step of least squares, and local planes.

The network judges which surface a pixel belongs to; a window of least squares measures better where there is
texture. They are weighed by their variances, and planes take the noise out, as in the classical method.
"""

import numpy as np
from numpy.typing import NDArray

from polhode.frontend.disparity.planes import fit_planes
from polhode.frontend.disparity.refinement import refine_dense
from polhode.frontend.disparity.start import Start

Floats = NDArray[np.float32]
WINDOW_PX = 7
RADIUS_PX = 6
_CORRELATED_PX2 = 25.0
_FLOOR_PX = 0.05


def polish(start: Start, disparity: Floats, sigma: Floats) -> Floats:
    """Disparity (h, w) [px] from the network's and its sigma; NaN stays NaN."""
    margin = ((0, 0), (start.margin_px, start.margin_px))
    left = np.pad(start.left, margin, mode="edge")
    measured, sigma_window = refine_dense(left, start.right, disparity, start.margin_px, WINDOW_PX)
    weight = sigma**2 / (sigma**2 + sigma_window**2 + _FLOOR_PX**2)
    joined = (disparity + weight * (measured - disparity)).astype(np.float32)
    spread = (sigma * np.sqrt(1.0 - weight)).astype(np.float32)
    plane, _ = fit_planes(joined, spread, RADIUS_PX, _CORRELATED_PX2)
    # Where no window holds enough of one surface, the pixel keeps its own value.
    return np.where(np.isfinite(plane), plane, joined).astype(np.float32)
