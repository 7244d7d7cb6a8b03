"""Disparity from range images: of single points with its sigma, and the dense depth of the target.

A range sensor measures each pixel on its own, with independent noise; what is near an edge mixes two surfaces
or is missing. A point's disparity is that of a plane through the pixels around it (a plane in space is a
plane in disparity), by iteratively reweighted least squares, so that pixels of another surface, and mixed
ones, do not count. Where few pixels agree with the plane, as at jumps of depth, there is none.
"""

import numpy as np

from polhode.frontend.disparity.classical import fit_planes
from polhode.frontend.disparity.depth import depth_of_disparity, discontinuities
from polhode.frontend.rectification import MeasuredDisparity, RectifiedPair
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array
from polhode.records.surface import DepthMap

JUMP_SIGMAS = 5.0
"""A first distance from the level that belongs to another surface;"""
MAX_SLOPE = 0.35
"""and what a very inclined surface adds to it [px of disparity per px]."""
OUTLIER_SIGMAS = 3.0
MIN_SUPPORT = 0.4
"""Smallest share of the window's weight that agrees with the plane."""
SHARED_ERROR = 0.05
"""Share of a pixel's sigma that averaging does not reduce: calibration, and what pixels have in common."""


def disparity_at(measured: MeasuredDisparity, uv_px: Array) -> tuple[Array, Array]:
    """Disparity (n,) and its sigma (n,) [px] at points uv (n, 2); NaN where it is not known."""
    # half side of the window of a point's plane: a compromise between noise and the curvature of surfaces
    n, r = len(uv_px), 5
    if n == 0:
        return np.zeros(0), np.zeros(0)
    y, x = (a.ravel() for a in np.mgrid[-r : r + 1, -r : r + 1])
    centre = np.round(uv_px).astype(np.int64)
    rows, columns = centre[:, 1:] + y, centre[:, :1] + x
    height, width = measured.disparity_px.shape
    at = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    d, sigma = (image[at].astype(np.float64) for image in (measured.disparity_px, measured.sigma_px))
    known = inside & np.isfinite(d)
    d, sigma = np.where(known, d, 0.0), np.where(known, sigma, 1.0)
    du, dv = columns - uv_px[:, :1], rows - uv_px[:, 1:]
    far2 = du**2 + dv**2
    window = np.exp(-far2 / (2.0 * (0.6 * r) ** 2))  # standard deviation of its weight, over the half side
    weight = np.where(known, window, 0.0)
    # the first level is the median of the measured pixels nearest to a point
    # measured pixels around the point whose median is the first level
    nearest = np.argsort(np.where(known, far2, np.inf), axis=1, kind="stable")[:, :9]
    measured_there, value = (np.take_along_axis(each, nearest, axis=1) for each in (known, d))
    values = np.where(measured_there, value, np.nan)
    level, some = np.full(n, np.nan), known.any(axis=1)
    level[some] = np.nanmedian(values[some], axis=1)
    keep = np.abs(d - level[:, None]) < JUMP_SIGMAS * sigma + MAX_SLOPE * np.sqrt(far2)
    A = np.stack([np.ones_like(du), du, dv], axis=-1)
    for _ in range(4):
        information = np.where(keep, weight / sigma**2, 0.0)
        Aw = A * information[..., None]
        # the regularisation keeps windows with too few pixels solvable; they are rejected afterwards
        inverse = np.linalg.inv(np.swapaxes(Aw, 1, 2) @ A + np.diag([1e-9, 1e-6, 1e-6]))
        plane = (inverse @ (np.swapaxes(Aw, 1, 2) @ d[..., None]))[..., 0]
        # the weights are not the inverse variances: those fall with the distance
        scatter = A * (np.where(keep, weight / sigma, 0.0))[..., None]
        covariance = inverse @ (np.swapaxes(scatter, 1, 2) @ scatter) @ inverse
        residual = (d - np.einsum("nka,na->nk", A, plane)) / sigma
        keep = known & (np.abs(residual) < OUTLIER_SIGMAS)
    support = (weight * keep).sum(axis=1) / window.sum(axis=1)
    agreeing = np.maximum((weight * keep).sum(axis=1), 1e-12)
    chi2 = (weight * keep * residual**2).sum(axis=1) / agreeing
    usual = np.sqrt((weight * keep * sigma**2).sum(axis=1) / agreeing)
    spread = np.sqrt(np.maximum(covariance[:, 0, 0], 0.0) * np.maximum(chi2, 1.0))
    # mean squared distance from the plane, in variances, above which the surface is none
    good = (support >= MIN_SUPPORT) & (chi2 < 4.0) & np.isfinite(level)
    return np.where(good, plane[:, 0], np.nan), np.where(good, np.hypot(spread, SHARED_ERROR * usual), np.nan)


def measured_depth(pair: RectifiedPair, rig: RectifiedRig, max_sigma_px: float) -> DepthMap:
    """Depth map of the target in the rectified left camera, by its ranges; local planes reduce their noise.

    max_sigma_px: largest standard deviation of a disparity that is kept.
    """
    measured = pair.measured
    assert measured is not None
    # pixels that mix two surfaces differ from both: they go with the jump before planes could spread them
    on_target = np.where(pair.mask_left, measured.disparity_px, np.float32(np.nan))
    # what noise and slope do not explain among a pixel's neighbours
    jump_px = np.sqrt(2.0) * JUMP_SIGMAS * np.nan_to_num(measured.sigma_px) + 2.0 * MAX_SLOPE
    # width that is removed along the silhouette and along jumps of depth
    jumps = discontinuities(on_target, pair.mask_left, 1, jump_px.astype(np.float32))
    clean = np.where(jumps, np.float32(np.nan), on_target)
    # half side of the windows in which the dense depth is taken as a plane
    disparity, sigma = fit_planes(clean, measured.sigma_px, 3, 1.0)
    sigma = np.hypot(sigma, np.float32(SHARED_ERROR) * measured.sigma_px)
    kept = np.isfinite(disparity) & (sigma < max_sigma_px)
    return depth_of_disparity(disparity, sigma, kept, pair.left, pair.mask_left, rig)
