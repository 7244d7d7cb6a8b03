"""Two layers in one image with ranges: the background, and what is measured before it.

Ranges separate the two by themselves. The background is the plane of most ranges along the border, or, where
the border has hardly any, what returns nothing: sky, Earth, a wall beyond the reach of the sensor. The target
is what is nearer by more than the noise, closed over the dropouts along its edges.
"""

import cv2
import numpy as np

from polhode.frontend.background.far_plane import FarPlane, border_ring, plane_of_most
from polhode.frontend.background.near_layer import NearLayer, filled, large_parts
from polhode.frontend.found_masks import MaskQuality
from polhode.frontend.rectification import MeasuredDisparity
from polhode.geometry.lie import Bools

MIN_RETURNS = 0.2
"""Share of the border's pixels with a range, below which the background returns nothing."""
SIGMAS = 5.0
"""Deviation of a range from the background's plane, in standard deviations, that noise does not reach,"""
INLIER_SIGMAS = 3.0
"""and that belongs to the plane while it is fitted;"""
UNEVEN_PX = 0.3
"""part of the disparity by which a real wall is not a plane [px]."""
MIN_INLIERS = 0.5
POINTS = 4000


def range_plane(measured: MeasuredDisparity, offset_px: float) -> FarPlane | None:
    """The background's plane by the ranges along the border (H, W); None: they lie in no plane.

    offset_px: disparity at infinity, where a background is that returns nothing.
    """
    ring = border_ring(np.ones(measured.disparity_px.shape, dtype=np.bool_))
    v, u = np.nonzero(ring & np.isfinite(measured.disparity_px))
    if len(u) < MIN_RETURNS * ring.sum():
        return FarPlane(0.0, 0.0, offset_px)
    some = np.linspace(0, len(u) - 1, min(len(u), POINTS)).astype(np.int64)
    v, u = v[some], u[some]
    A = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64)
    d, sigma = (image[v, u].astype(np.float64) for image in (measured.disparity_px, measured.sigma_px))
    allowed = np.hypot(INLIER_SIGMAS * sigma, UNEVEN_PX)
    nowhere = np.array([0.0, 0.0, -1e9])
    inlier = np.abs(A @ plane_of_most(A, d, allowed, nowhere) - d) < allowed
    if inlier.mean() < MIN_INLIERS:
        return None
    for _ in range(3):
        weight = 1.0 / sigma[inlier]
        plane = np.linalg.lstsq(A[inlier] * weight[:, None], d[inlier] * weight)[0]
        inlier = np.abs(A @ plane - d) < allowed
    return FarPlane(float(plane[0]), float(plane[1]), float(plane[2]))


def near_range_layer(measured: MeasuredDisparity, plane: FarPlane) -> NearLayer:
    """What is measured before the background's plane (H, W); the mask of a right image is empty."""
    height, width = measured.disparity_px.shape
    known = np.isfinite(measured.disparity_px)
    beyond = np.where(known, measured.disparity_px - plane.at(width, height), 0.0)
    margin = np.hypot(SIGMAS * np.nan_to_num(measured.sigma_px), UNEVEN_PX)
    near, far = known & (beyond > margin), known & (beyond <= margin)
    size = 2 * 3 + 1  # dropouts along edges are closed over 3 px
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    closed = cv2.morphologyEx(near.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0
    evidence = np.where(far, np.float32(-np.inf), np.float32(0.0))
    target = large_parts(filled((closed & ~far) | near, evidence))
    ring = border_ring(np.ones((height, width), dtype=np.bool_))
    border = ring & known
    quality = MaskQuality(
        area=float(target.mean()),
        agreement=_share(target & near, near),
        contradicted=float((known & (beyond < -margin)).sum() / target.sum())
        if target.any()
        else float("nan"),
        far_share=1.0 if border.sum() < MIN_RETURNS * ring.sum() else _share(far & border, border),
    )
    return NearLayer(target, np.zeros_like(target), quality)


def _share(part: Bools, whole: Bools) -> float:
    """Pixels of a part over those of the whole, in which it lies; nan: there are none."""
    return float(part.sum() / whole.sum()) if whole.any() else float("nan")
