"""How the surface leans at a feature: planes through the dense disparity around it.

A plane in space is a plane in disparity, so a weighted least-squares fit over a window is exact on facets.
Pixels beyond a jump of depth belong to another surface and are left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.lie import Array

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class SurfacePlanes:
    """Local planes of the disparity at n places."""

    plane: Array
    """(n, 3) disparity at the place [px], its slopes along u and v; NaN where too little is known"""
    support: Array
    """(n,) share of the window's weight that lies on the plane"""
    scatter_px: Array
    """(n,) weighted rms distance of the supporting disparities from the plane [px]"""


def local_planes(
    disparity: Floats, uv_px: Array, radius_px: int = 12, jump_px: float = 1.5, min_support: float = 0.15
) -> SurfacePlanes:
    """Planes at places uv (n, 2) of a disparity map (H, W), NaN where unknown.

    The first plane is the window's own median level with tolerance for slant; two rounds then keep what is
    within ``jump_px`` of the plane before.
    """
    n = len(uv_px)
    r = radius_px
    # Every second pixel tells as much: neighbours' disparities come from windows that overlap.
    y, x = (a.ravel() for a in np.mgrid[-r : r + 1 : 2, -r : r + 1 : 2])
    centre = np.round(uv_px).astype(np.int64)
    rows, columns = centre[:, 1:] + y, centre[:, :1] + x
    h, w = disparity.shape
    inside = (rows >= 0) & (rows < h) & (columns >= 0) & (columns < w)
    d = disparity[np.clip(rows, 0, h - 1), np.clip(columns, 0, w - 1)].astype(np.float64)
    known = inside & np.isfinite(d)
    du, dv = columns - uv_px[:, :1], rows - uv_px[:, 1:]
    window = np.exp(-(du**2 + dv**2) / (2.0 * (0.6 * r) ** 2))
    weight = np.where(known, window, 0.0)
    filled = np.where(known, d, 0.0)
    reference = _level(filled, known, du**2 + dv**2)
    # A slope of 0.35 px a px is a surface seen very aslant: the first gate opens away from the middle.
    gate = jump_px + 0.35 * np.hypot(du, dv)
    keep = np.abs(filled - reference[:, None]) < gate
    solution = np.zeros((n, 3))
    for _ in range(3):
        used = weight * keep
        solution = _fit(du, dv, filled, used, reference)
        predicted = solution[:, :1] + solution[:, 1:2] * du + solution[:, 2:] * dv
        keep = np.abs(filled - predicted) < jump_px
    used = weight * keep
    total = used.sum(axis=1)
    scatter = np.sqrt((used * (filled - predicted) ** 2).sum(axis=1) / np.maximum(total, 1e-9))
    support = total / window.sum(axis=1)
    enough = (support >= min_support) & np.isfinite(reference)
    return SurfacePlanes(np.where(enough[:, None], solution, np.nan), support, scatter)


def _level(d: Array, known: NDArray[np.bool_], distance2: Array) -> Array:
    """Median (n,) of the nearest known disparities of each window; NaN where there are none."""
    nearest = np.argsort(np.where(known, distance2, np.inf), axis=1, kind="stable")[:, :9]
    values = np.where(
        np.take_along_axis(known, nearest, axis=1), np.take_along_axis(d, nearest, axis=1), np.nan
    )
    some = np.isfinite(values).any(axis=1)
    level = np.full(len(d), np.nan)
    if some.any():
        level[some] = np.nanmedian(values[some], axis=1)
    return level


def _fit(du: Array, dv: Array, d: Array, weight: Array, reference: Array) -> Array:
    """Weighted planes (n, 3); a weak window keeps its reference level and no slope."""
    A = np.stack([np.ones_like(du), du, dv], axis=-1)
    Aw = A * weight[..., None]
    normal = np.swapaxes(Aw, 1, 2) @ A + np.diag([1e-6, 1e-1, 1e-1])
    level = np.where(np.isfinite(reference), reference, 0.0)[:, None]
    step = np.linalg.solve(normal, np.swapaxes(Aw, 1, 2) @ (d - level)[..., None])[..., 0]
    return np.asarray(step + np.column_stack([level, np.zeros((len(d), 2))]))
