"""Planes through a disparity map around points, compiled: they give the normals of the surface there."""

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array
from polhode.geometry.small_systems import solve_symmetric
from polhode.runtime.compiled import compiled_fused_ieee

PLANE_RADIUS_PX = 12
"""Half side of the windows whose disparities give the normal of the surface [px]."""
STRIDE_PX = 2
"""Every second pixel is enough: disparities of neighbours come from overlapping windows."""
JUMP_PX = 1.5
"""Pixels whose disparity differs from a local plane by more belong to another surface."""
STEEPEST = 0.35
"""Slope of a very inclined surface [px/px], by which the gate around the level opens away from the centre."""
MIN_SUPPORT = 0.15
"""Smallest share of the window's weight that lies on a plane."""
NEAREST = 9
"""Known disparities next to a point, whose median is its level."""
ROUNDS = 3
REGULARISATION = (1e-6, 1e-1, 1e-1)
"""A window with little weight keeps its level without slope."""
_SIDE = 2 * PLANE_RADIUS_PX // STRIDE_PX + 1
_SPREAD = 2.0 * (0.6 * PLANE_RADIUS_PX) ** 2


def local_planes(disparity: NDArray[np.float32], uv_px: Array) -> Array:
    """Planes (n, 3) of a disparity map (H, W) at points uv (n, 2): value [px] and slopes along u and v.

    NaN where too little is known. The first plane is the median level of the window with a tolerance for
    slant; each further round uses the pixels within ``JUMP_PX`` of the previous plane.
    """
    return _planes(np.ascontiguousarray(disparity), np.ascontiguousarray(uv_px, dtype=np.float64))


@compiled_fused_ieee
def _planes(disparity: NDArray[np.float32], uv_px: Array) -> Array:
    planes = np.full((len(uv_px), 3), np.nan)
    height, width = disparity.shape
    d, du, dv, weight = np.empty(_SIDE**2), np.empty(_SIDE**2), np.empty(_SIDE**2), np.empty(_SIDE**2)
    A, b, L, plane = np.empty((3, 3)), np.empty(3), np.zeros((3, 3)), np.empty(3)
    far, value = np.empty(NEAREST), np.empty(NEAREST)
    for k in range(len(uv_px)):
        u, v = uv_px[k]
        u0, v0 = int(np.rint(u)), int(np.rint(v))
        total, known, near = 0.0, 0, 0
        for y in range(_SIDE):
            row = v0 - PLANE_RADIUS_PX + STRIDE_PX * y
            for x in range(_SIDE):
                column = u0 - PLANE_RADIUS_PX + STRIDE_PX * x
                away_u, away_v = column - u, row - v
                square = away_u**2 + away_v**2
                share = np.exp(-square / _SPREAD)
                total += share
                if row < 0 or row >= height or column < 0 or column >= width:
                    continue
                here = float(disparity[row, column])
                if not np.isfinite(here):
                    continue
                d[known], du[known], dv[known], weight[known] = here, away_u, away_v, share
                known += 1
                if near == NEAREST and square >= far[near - 1]:
                    continue
                near = min(near + 1, NEAREST)
                at = near - 1
                while at > 0 and far[at - 1] > square:
                    far[at], value[at] = far[at - 1], value[at - 1]
                    at -= 1
                far[at], value[at] = square, here
        if known == 0:
            continue
        level = _median(value, near)
        for a in range(3):
            plane[a] = 0.0
        support = 0.0
        # the last round only counts the support of the plane
        for i in range(ROUNDS + 1):
            for a in range(3):
                b[a] = 0.0
                for c in range(3):
                    A[a, c] = 0.0
            support = 0.0
            for m in range(known):
                away = d[m] - level
                if i == 0:
                    near_plane = abs(away) < JUMP_PX + STEEPEST * np.sqrt(du[m] ** 2 + dv[m] ** 2)
                else:
                    near_plane = abs(away - plane[0] - plane[1] * du[m] - plane[2] * dv[m]) < JUMP_PX
                if not near_plane:
                    continue
                w = weight[m]
                support += w
                A[0, 0] += w
                A[1, 0] += w * du[m]
                A[2, 0] += w * dv[m]
                A[1, 1] += w * du[m] ** 2
                A[2, 1] += w * du[m] * dv[m]
                A[2, 2] += w * dv[m] ** 2
                b[0] += w * away
                b[1] += w * du[m] * away
                b[2] += w * dv[m] * away
            if i == ROUNDS:
                break
            for a in range(3):
                A[a, a] += REGULARISATION[a]
            solve_symmetric(A, b, L, plane)
        if support >= MIN_SUPPORT * total:
            planes[k, 0], planes[k, 1], planes[k, 2] = plane[0] + level, plane[1], plane[2]
    return planes


@compiled_fused_ieee
def _median(value: Array, count: int) -> float:
    """Of the first ``count`` values, which are put in order."""
    for i in range(1, count):
        moved, at = value[i], i
        while at > 0 and value[at - 1] > moved:
            value[at] = value[at - 1]
            at -= 1
        value[at] = moved
    lower, upper = value[(count - 1) // 2], value[count // 2]
    return 0.5 * (float(lower) + float(upper))
