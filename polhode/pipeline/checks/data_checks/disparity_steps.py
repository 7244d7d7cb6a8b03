"""Steps of all disparities between frames: a camera that was knocked sideways.

The landmarks that two frames share have one shape. If all disparities of the second frame are too large by
some pixels, it looks nearer than its size in the image says: a rigid motion and this offset are fitted to the
pair together. A step in the calibration shows in every pair across it; a frame that is bad for itself does
not. No estimate of the motion is needed, whose outliers such a step would hide in.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, hat, transform_points
from polhode.geometry.rigid_fit import fit_rigid
from polhode.records.tracks import StereoTracks

MAX_PAIRS, MAX_SPAN = 6, 40
"""Pairs across each place, the nearest ones, and the largest number of frames between the two of a pair."""
OUTLIER_SIGMAS = 3.0
"""Where the weight of a landmark has fallen to one half."""


def disparity_steps(tracks: StereoTracks, sigma_px: tuple[float, float]) -> tuple[Array, Array]:
    """By how much all disparities grow from each frame to the next [px], and the sigma of that (F - 1,) each.

    sigma_px: of image coordinates and of disparities. NaN where neighbouring frames share too little. The
    median of all pairs across the place, weighted; the sigma includes the scatter of all pairs.
    """
    rows = [np.flatnonzero(tracks.frame == k) for k in range(tracks.n_frames)]
    sigma3_px, pairs = np.asarray(sigma_px)[[0, 0, 1]], []
    for i, j in _pairs(tracks):
        _, a, b = np.intersect1d(tracks.landmark[rows[i]], tracks.landmark[rows[j]], return_indices=True)
        uvd = tracks.uvd_px[rows[i][a]], tracks.uvd_px[rows[j][b]]
        if (offset := disparity_change(tracks.rig, *uvd, sigma3_px)) is not None:
            pairs.append((i, j, *offset))
    first, last, change, sigma = np.array(pairs, dtype=np.float64).reshape(-1, 4).T
    steps = np.full((2, max(tracks.n_frames - 1, 0)), np.nan)
    if len(change) == 0:
        return steps[0], steps[1]
    sigma = np.hypot(sigma, 1.4826 * float(np.median(np.abs(change))))
    for k in range(tracks.n_frames - 1):
        across = (first <= k) & (last > k)
        found = []
        for part in (across, across & (first < k), across & (last > k + 1)):
            if part.sum() >= 2:
                weight = float(np.sum(1.0 / sigma[part] ** 2))
                median = weighted_median(change[part], sigma[part])
                found.append((median, float(np.sqrt(min(part.sum(), 3) / weight))))
        if found:
            least = min(found, key=lambda each: abs(each[0]))
            # a frame that is bad for itself is no step: without it nothing is left
            steps[:, k] = least if abs(least[0]) < 0.5 * abs(found[0][0]) else found[0]
    return steps[0], steps[1]


def weighted_median(values: Array, sigma: Array) -> float:
    """Of values (n,), each weighted by its sigma (n,)."""
    order = np.argsort(values)
    weight = np.cumsum(1.0 / sigma[order] ** 2)
    return float(values[order][np.searchsorted(weight, 0.5 * weight[-1])])


def _pairs(tracks: StereoTracks) -> list[tuple[int, int]]:
    """Pairs of frames that share enough: across each place, those whose frames are nearest to each other."""
    shape = tracks.n_frames, tracks.n_landmarks
    seen = csr_array((np.ones(len(tracks.frame)), (tracks.frame, tracks.landmark)), shape=shape)
    shared = (seen @ seen.T).tocoo()
    enough = (shared.data >= 12) & (shared.row < shared.col)
    enough &= shared.col - shared.row <= MAX_SPAN
    first, last = shared.row[enough], shared.col[enough]
    order = np.lexsort((first, last - first))
    first, last = first[order], last[order]
    chosen = [np.flatnonzero((first <= k) & (last > k))[:MAX_PAIRS] for k in range(tracks.n_frames - 1)]
    return [(int(first[n]), int(last[n])) for n in np.unique(np.concatenate([[], *chosen]).astype(np.int64))]


def disparity_change(
    rig: RectifiedRig, uvd_A_px: Array, uvd_B_px: Array, sigma_px: Array
) -> tuple[float, float] | None:
    """Offset of the disparities of view B relative to view A, and its sigma [px]; None: it is not determined.

    uvd (n, 3) of the same points, sigma_px (3,). Gauss-Newton over the rigid motion and the offset, with
    Cauchy weights; the noise of A counts as much as that of B.
    """
    p_A, p_B = rig.triangulate(uvd_A_px), rig.triangulate(uvd_B_px)
    weight = np.ones(len(p_A))
    for _ in range(5):
        # by the points alone, without the worst of them
        X_BA = fit_rigid(p_B, p_A, weight)
        distance = np.linalg.norm(p_B - transform_points(X_BA, p_A), axis=1)
        weight = 1.0 / (1.0 + (distance / max(1.5 * float(np.median(distance)), 1e-12)) ** 2)
    fitted = fit_view(rig, X_BA, p_A, uvd_B_px, np.sqrt(2.0) * sigma_px, with_offset=True)
    return None if fitted is None else (fitted.offset_px, float(np.sqrt(fitted.covariance[6, 6])))


class FittedView(NamedTuple):
    """Where points are in a view."""

    X_BA: Array
    """(4, 4)"""
    offset_px: float
    """Of the view's disparities"""
    covariance: Array
    """(6, 6) of translation [m] and rotation [rad] along the axes of B, about its origin; (7, 7) with the
    offset [px]"""


def fit_view(
    rig: RectifiedRig, X_BA: Array, p_A: Array, uvd_B_px: Array, sigma_px: Array, with_offset: bool
) -> FittedView | None:
    """The pose that projects points (n, 3) onto uvd (n, 3), and the offset; else that is 0. sigma_px (3,).

    Gauss-Newton with Cauchy weights, from a first pose. None: it is not determined.
    """
    offset_px, inv_sigma, unknowns = 0.0, 1.0 / sigma_px, 7 if with_offset else 6
    for _ in range(12):
        residual = inv_sigma * offset_residual(rig, X_BA, offset_px, p_A, uvd_B_px)
        J = inv_sigma[:, None] * offset_jacobian(rig, X_BA, p_A)[:, :, :unknowns]
        weight = 1.0 / (1.0 + np.sum(residual**2, axis=1) / OUTLIER_SIGMAS**2)
        normal = np.einsum("n,nij,nik->jk", weight, J, J)
        if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e14:
            return None
        step = -np.linalg.solve(normal, np.einsum("n,nij,ni->j", weight, J, residual))
        X_BA = X_BA.copy()
        X_BA[:3, :3] = exp_so3(step[3:6]) @ X_BA[:3, :3]
        X_BA[:3, 3] = exp_so3(step[3:6]) @ X_BA[:3, 3] + step[:3]
        offset_px += float(step[6]) if with_offset else 0.0
        if float(np.abs(step).max()) < 1e-9:
            break
    return FittedView(X_BA, offset_px, np.linalg.inv(normal))


def offset_residual(rig: RectifiedRig, X_BA: Array, offset_px: float, p_A: Array, uvd_B_px: Array) -> Array:
    """Predicted minus measured (n, 3) [px]: points (n, 3) of view A in view B, disparities larger by an
    offset."""
    predicted = rig.project(transform_points(X_BA, p_A)) + np.array([0.0, 0.0, offset_px])
    return np.asarray(predicted - uvd_B_px)


def offset_jacobian(rig: RectifiedRig, X_BA: Array, p_A: Array) -> Array:
    """Its derivative (n, 3, 7) by a translation, a rotation about the origin of B, and the offset."""
    p_B = transform_points(X_BA, p_A)
    by_point = np.linalg.inv(rig.triangulation_jacobian(p_B))
    by_offset = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), (len(p_B), 3, 1))
    return np.concatenate([by_point, -by_point @ hat(p_B), by_offset], axis=2)
