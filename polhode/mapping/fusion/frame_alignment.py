"""Alignment of one frame's depth to the surface that the other frames show: a more accurate pose.

For every point of the depth map the field gives the signed distance from the surface, interpolated between
the voxels (Bylow et al., "Real-time camera tracking and 3D reconstruction using signed distance functions",
2013). Gauss-Newton minimizes the distances, with the frame's pose covariance as the prior, so that what the
surface does not determine (the rotation of a ball, a translation along a wall) stays as it was.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import (
    Array,
    Ints,
    exp_so3,
    inverse_pose,
    make_pose,
    right_jacobian_so3,
    transform_points,
)
from polhode.mapping.fusion.block_grid import (
    DISTANCE,
    EDGE,
    FREE,
    HALF,
    SQUARE,
    VIEWS,
    VOXELS,
    WEIGHT,
    BlockGrid,
)
from polhode.mapping.fusion.depth_frame import FrameTensors
from polhode.runtime.compiled import compiled_fused_ieee

_BITS = HALF.bit_length()


@dataclass(frozen=True)
class FieldSamples:
    """The field at points (n, 3) in G; NaN where it is not known."""

    distance_m: Array
    """(n,) signed, positive in front of the surface"""
    gradient_G: Array
    """(n, 3) of the distance, about a unit vector"""
    variance_m2: Array
    """(n,) of the distance"""


@dataclass(frozen=True)
class FieldLookup:
    """A field in its frame F, evaluated at points of G."""

    values: NDArray[np.float32]
    """(n, 512, 8)"""
    keys: Ints
    """(n,) sorted"""
    order: Ints
    """(n,) the blocks of these keys"""
    voxel_m: float
    front_m: float
    carved_share: float
    """Maximum share of the weight from frames that look through a known voxel"""
    X_FG: Array
    """(4, 4)"""

    @staticmethod
    def of(grid: BlockGrid, X_FG: Array, carved_share: float) -> "FieldLookup":
        """A view of the present field."""
        keys = grid.keys.numpy()
        order = np.argsort(keys)
        values = grid.values.numpy()
        return FieldLookup(values, keys[order], order, grid.voxel_m, grid.front_m, carved_share, X_FG)

    def __call__(self, points_G: Array) -> FieldSamples:
        """points_G (n, 3) [m]; finite."""
        points = np.ascontiguousarray(transform_points(self.X_FG, points_G) / self.voxel_m)
        out = np.full((len(points), 5), np.nan)
        limits = np.array([self.front_m, self.carved_share, self.voxel_m])
        if len(self.keys):
            interpolate(self.values, self.keys, self.order, limits, points, out)
        return FieldSamples(out[:, 0], out[:, 1:4] @ self.X_FG[:3, :3], out[:, 4])


@compiled_fused_ieee
def interpolate(
    values: NDArray[np.float32], keys: Ints, order: Ints, limits: Array, points: Array, out: Array
) -> None:
    """Fill ``out`` (n, 5): distance [m], gradient (3), variance [m^2], at ``points`` (n, 3) [voxels].

    Rows whose eight voxels are not all known are unchanged. limits: front [m], maximum share of free weight,
    voxel [m].
    """
    front, carved, voxel_m = limits
    cells = values.reshape(-1, values.shape[-1])
    distance, variance = np.empty(8), np.empty(8)
    last_key, last_block = np.int64(-1), np.int64(0)
    for n in range(len(points)):
        low = np.floor(points[n])
        if not np.all(np.abs(low) < EDGE * (HALF - 2)):
            continue
        share, known = points[n] - low, True
        for corner in range(8):
            i = int(low[0]) + (corner >> 2)
            j = int(low[1]) + ((corner >> 1) & 1)
            k = int(low[2]) + (corner & 1)
            # shifted to be positive, so that integer division rounds down
            a, b, c = i + EDGE * HALF, j + EDGE * HALF, k + EDGE * HALF
            key = ((a // EDGE) << (2 * _BITS)) | ((b // EDGE) << _BITS) | (c // EDGE)
            if key != last_key:
                at = np.searchsorted(keys, key)
                if at >= len(keys) or keys[at] != key:
                    known = False
                    break
                last_key, last_block = np.int64(key), order[at]
            cell = cells[last_block * VOXELS + ((a % EDGE) * EDGE + b % EDGE) * EDGE + c % EDGE]
            weight = float(cell[WEIGHT]) + float(cell[FREE])
            # voxels seen by a single frame are not used
            if cell[WEIGHT] <= 0.0 or cell[VIEWS] < 2 or cell[FREE] > carved * weight:
                known = False
                break
            mean = (cell[DISTANCE] + front * cell[FREE]) / weight
            scatter = (cell[SQUARE] + front * front * cell[FREE]) / weight - mean * mean
            distance[corner] = mean
            # the larger of the variance by the weights and that by the scatter over the frames
            variance[corner] = max(1.0 / weight, scatter / cell[VIEWS])
        if not known:
            continue
        out[n] = 0.0
        for corner in range(8):
            x = share[0] if corner & 4 else 1.0 - share[0]
            y = share[1] if corner & 2 else 1.0 - share[1]
            z = share[2] if corner & 1 else 1.0 - share[2]
            out[n, 0] += x * y * z * distance[corner]
            out[n, 1] += (1.0 if corner & 4 else -1.0) * y * z * distance[corner] / voxel_m
            out[n, 2] += (1.0 if corner & 2 else -1.0) * x * z * distance[corner] / voxel_m
            out[n, 3] += (1.0 if corner & 1 else -1.0) * x * y * distance[corner] / voxel_m
            out[n, 4] += x * y * z * variance[corner]


_STILL = 0.05
"""Converged when a step is less than this, in standard deviations."""
_IMPLAUSIBLE = float(chdtri(6, 2.0 * 3.167e-5))
"""Squared length of a correction of six numbers with the probability of four sigma in one."""


@dataclass(frozen=True)
class DepthPoints:
    """Points of one depth map in G, at the pose as given; n of them."""

    p_G: Array
    """(n, 3) [m]"""
    variance_m2: Array
    """(n,) of the distance from the surface, without the pose's part"""
    independent: float
    """Number of independent measurements among these over n, at most 1"""


@dataclass(frozen=True)
class FrameAlignment:
    """Correction of a frame's pose X_RG: p_R = X_RG (Exp(rotation) p_G + translation)."""

    correction: Array
    """(6,) translation [m], rotation [rad] along G; 0 where it is refused"""
    covariance_G: Array
    """(6, 6) of the corrected pose, in the same convention about that pose; the prior's where refused"""
    refused: str | None
    """Why the pose is left unchanged; None: it was aligned"""

    def apply(self, X_RG: Array) -> Array:
        """The corrected pose (4, 4)."""
        return np.asarray(X_RG @ make_pose(exp_so3(self.correction[3:]), self.correction[:3]))


def distances(
    correction: Array, p_G: Array, lookup: Callable[[Array], FieldSamples]
) -> tuple[Array, Array, Array]:
    """Distances (n,) of points (n, 3) from the surface after ``correction`` (6,) of the pose, derivatives
    (n, 6) and variances (n,) by that of the surface; NaN where it is not known."""
    translation, rotation = correction[:3], correction[3:]
    R, moved = exp_so3(-rotation), p_G - translation
    at = lookup(moved @ R.T)
    along = at.gradient_G @ R
    # Exp(-(t + d)) q = Exp(-t) (q + hat(q) Jr(-t) d)
    by_rotation = np.cross(along, moved) @ right_jacobian_so3(-rotation)
    return at.distance_m, np.hstack([-along, by_rotation]), at.variance_m2


def align(
    points: DepthPoints, covariance_G: Array, lookup: Callable[[Array], FieldSamples], min_share: float
) -> FrameAlignment:
    """Align a frame to the surface; covariance_G (6, 6) of its pose, finite, may be singular.

    ``min_share`` of the points must lie where the surface is known.
    """
    stays = FrameAlignment(np.zeros(6), covariance_G, None)
    n, step, excess, posterior = len(points.p_G), np.inf, 1.0, covariance_G
    x = _start(points, covariance_G, lookup, min_share)
    for _ in range(20):
        distance, J, variance = distances(x, points.p_G, lookup)
        known = np.isfinite(distance)
        if known.sum() < max(50, min_share * n):
            return replace(stays, refused="too little of it lies near known surface")
        J, distance = J[known], distance[known]
        weight, excess = _weights(distance, points.variance_m2[known] + variance[known])
        A = J.T @ (weight[:, None] * J)
        gain = points.independent / excess
        # (C^-1 + A) without inverting C, which may be singular
        half = 0.5 * np.linalg.solve(np.eye(6) + gain * covariance_G @ A, covariance_G)
        posterior = np.asarray(half + half.T)
        target = posterior @ (gain * (A @ x - J.T @ (weight * distance)))
        moved = target - x
        step = max(float(moved @ np.linalg.pinv(posterior, hermitian=True) @ moved), 0.0) ** 0.5
        x = target
        if step < _STILL:
            break
    if step >= _STILL:
        return replace(stays, refused="it does not converge")
    # Ratio of the squared distances to their variances above which a frame does not fit the surface
    if excess > 4.0:
        return replace(stays, refused="it does not fit the surface")
    if x @ np.linalg.pinv(covariance_G, hermitian=True) @ x > _IMPLAUSIBLE:
        return replace(stays, refused="it contradicts the motion")
    return FrameAlignment(x, _about(x, posterior), None)


def depth_points(frame: FrameTensors, X_RG: Array, rig: RectifiedRig) -> DepthPoints:
    """Evenly spaced pixels; ``frame`` keeps its sigma; X_RG (4, 4) the pose as given."""
    depth = frame.depth_m.numpy().astype(np.float64)
    pixel = np.flatnonzero(frame.weight.numpy() > 0)
    count = min(len(pixel), 3000)
    some = pixel[np.linspace(0, len(pixel) - 1, count).astype(int)]
    v, u = np.divmod(some, depth.shape[1])
    z = depth[v, u]
    x, y = ((u + frame.u0 - rig.cx_px) / rig.focal_px, (v + frame.v0 - rig.cy_px) / rig.focal_px)
    p_R = np.column_stack([x * z, y * z, z])
    # Errors of the depth are correlated over squares of this width: disparities come from windows of 7 px,
    # and effects of light and slant extend farther (docs/mapping.md has the figures)
    return DepthPoints(
        p_G=transform_points(inverse_pose(X_RG), p_R),
        variance_m2=frame.own_sigma_m.numpy().astype(np.float64)[v, u] ** 2,
        independent=min(1.0, len(pixel) / (12**2 * max(count, 1))),
    )


def _start(
    points: DepthPoints, covariance: Array, lookup: Callable[[Array], FieldSamples], min_share: float
) -> Array:
    """No correction (6,); if that is outside the truncation band, a probable one that is not."""
    variances, axes = np.linalg.eigh(covariance)
    # distance of other starts in standard deviations
    spread = 1.5 * np.sqrt(np.maximum(variances, 0.0))[:, None] * axes.T
    best, most = np.zeros(6), -1
    for x in (best, *spread, *-spread):
        known = int(np.isfinite(distances(x, points.p_G, lookup)[0]).sum())
        if known > most:
            best, most = x, known
        if not best.any() and most >= min_share * len(points.p_G):
            break
    return best


def _weights(distance: Array, variance: Array) -> tuple[Array, float]:
    """Information (n,) of each distance (Geman and McClure's kernel), and the excess of their squares."""
    size = distance**2 / variance
    # 0.455: the median of the square of a standard normal number
    excess = max(float(np.median(size)) / 0.455, 1.0)
    # width of the robust kernel, over the residuals' own scale
    return 1.0 / (1.0 + size / (2.5**2 * excess)) ** 2 / variance, excess


def _about(x: Array, covariance: Array) -> Array:
    """The covariance (6, 6) of the corrected pose, from that of the correction x."""
    T = np.zeros((6, 6))
    T[:3, :3], T[3:, 3:] = exp_so3(-x[3:]), right_jacobian_so3(x[3:])
    return np.asarray(T @ covariance @ T.T)
