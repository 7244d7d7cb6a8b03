"""The classical method: least squares refine semi-global disparities, planes and facets smooth them."""

import numpy as np
from numpy.typing import NDArray

from polhode.config.depth import Depth
from polhode.frontend.disparity.crop import Crop
from polhode.frontend.disparity.facets import fit_facets
from polhode.frontend.disparity.planes import fit_planes
from polhode.frontend.disparity.refinement import refine_dense
from polhode.frontend.disparity.sgbm import match_checked

Floats = NDArray[np.float32]
FLOOR_PX = 0.05
"""What the model of the noise leaves out: slant, shine, interpolation."""
_FEWEST = 50


def smoothed_disparity(crop: Crop, config: Depth) -> tuple[Floats, Floats]:
    """Refined disparities and their standard deviations (h, w) [px], NaN where none."""
    disparity = match_checked(crop, config)
    if np.isfinite(disparity).sum() < _FEWEST:
        return np.full_like(disparity, np.nan), np.full_like(disparity, np.nan)
    return smooth(crop, disparity, config)


def smooth(crop: Crop, disparity: Floats, config: Depth) -> tuple[Floats, Floats]:
    """The same from a given start (h, w) [px], NaN where none."""
    sigma = np.full_like(disparity, 0.3)
    by_window, sigma_window = disparity, sigma
    correlated_px2 = float(config.window_px**2)
    for _ in range(config.refinements):
        by_window, sigma_window = refine_dense(
            crop.left, crop.right, disparity, crop.search_px, config.window_px
        )
        disparity, sigma = fit_planes(by_window, sigma_window, config.plane_radius_px, correlated_px2)
    if config.facets:
        darkest = crop.sky + 2.0 * config.min_intensity
        facet, sigma_facet = fit_facets(
            crop.image, crop.lit, by_window, sigma_window, correlated_px2, darkest
        )
        flat = sigma_facet < np.where(np.isfinite(sigma), sigma, np.inf)
        disparity, sigma = np.where(flat, facet, disparity), np.where(flat, sigma_facet, sigma)
    return disparity.astype(np.float32), np.hypot(sigma, FLOOR_PX).astype(np.float32)
