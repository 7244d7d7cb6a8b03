"""From relative poses between pairs of frames to one pose per frame: consensus of links, robust averaging.

One link in ten is wrong at 30 degrees between frames, and a wrong link looks like a correct one. Frames are
therefore joined to connected components, and these to larger ones, always by the largest group of links that
agree with each other: two agreeing links of seven inliers are worth more than one of fifteen. Then all poses
are averaged robustly.
"""

import numpy as np

from polhode.backend.initialization.link_consensus import (
    closed_triangles,
    smooth_links,
    update_link_consensus,
)
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.records import Bools, Ints, RelativePoses

MIN_INLIERS = 5
AGREEING = 100.0
"""Weight of a link that agrees with another one, in inliers."""
MIN_SCORE = 2.5
"""A single link needs this many inliers times the share of its triangles that close (without any: 1/2)."""
MIN_AVERAGED_FRAMES = 4
"""Components of this size are averaged when they are joined."""
REJECT_RAD = np.deg2rad(10.0)
REJECT_SHIFT = 0.1
"""Largest error of a translation, as a share of the distance to the target."""


def connect(relative: RelativePoses, time_s: Array, R_NR: Array) -> tuple[Array, Bools, Bools]:
    """Poses X_RG (F, 4, 4) of the largest consistent component, frames in it (F,), accepted edges (E,).

    time_s (F,) [s] and R_NR (F, 3, 3) of the camera: links between near frames that agree on a rate of
    rotation are joined first. G is the camera frame of one of the component's frames until the caller moves
    it.
    """
    n_frames = len(time_s)
    usable = relative.inliers >= MIN_INLIERS
    support = triangle_support(relative, usable, n_frames)
    X, component = np.tile(np.eye(4), (n_frames, 1, 1)), np.arange(n_frames)
    for links in (smooth_links(relative, usable, time_s, R_NR), usable):
        join_components(relative, links, support, X, component)
    connected = component == np.argmax(np.bincount(component))
    if connected.sum() < 2:
        return X, np.zeros(n_frames, bool), np.zeros(len(usable), bool)
    inside = usable & connected[relative.i] & connected[relative.j]
    accepted = inside & (edge_errors(X, relative) < 2.0)
    X = average_poses(X, connected, relative, accepted)
    return X, connected, inside & (edge_errors(X, relative) < 1.0)


def relative_error(X_a: Array, X_b: Array) -> Array:
    """Disagreement of two relative poses (..., 4, 4) in units of the rejection thresholds."""
    # angle by the trace of R_a^T R_b: accuracy at small angles is not needed here
    trace = np.sum(X_a[..., :3, :3] * X_b[..., :3, :3], axis=(-2, -1))
    turn = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    distance = np.maximum(np.sqrt(np.sum(X_b[..., :3, 3] ** 2, axis=-1)), 1e-9)
    shift = np.sqrt(np.sum((X_a[..., :3, 3] - X_b[..., :3, 3]) ** 2, axis=-1))
    return np.asarray(
        np.maximum(
            turn / REJECT_RAD, shift / np.maximum(distance, 0.3 * np.median(distance)) / REJECT_SHIFT / 2
        )
    )


def edge_errors(X: Array, relative: RelativePoses) -> Array:
    """Disagreement (E,) of each edge with the poses (F, 4, 4), in units of the thresholds."""
    return relative_error(X[relative.i] @ inverse_pose(X[relative.j]), relative.X_RiRj)


def triangle_support(relative: RelativePoses, usable: Bools, n_frames: int) -> Array:
    """Share of closed triangles that agree, per edge (E,), with one good and one bad triangle as prior."""
    i, j, X_ij = relative.i[usable], relative.j[usable], relative.X_RiRj[usable]
    linked = np.zeros((n_frames, n_frames), bool)
    linked[i, j] = linked[j, i] = True
    X = np.tile(np.eye(4), (n_frames, n_frames, 1, 1))
    # of two links between the same frames, the one with more inliers is a side of other triangles
    weakest_first = np.argsort(relative.inliers[usable], kind="stable")
    a, b, X_ab = i[weakest_first], j[weakest_first], X_ij[weakest_first]
    X[a, b], X[b, a] = X_ab, inverse_pose(X_ab)
    agree, seen = closed_triangles(
        i, j, np.ascontiguousarray(X_ij), linked, X, 1.5 * REJECT_RAD, 1.5 * 2.0 * REJECT_SHIFT
    )
    support = np.zeros(len(relative.i))
    support[usable] = (agree + 1.0) / (seen + 2.0)
    return support


def join_components(
    relative: RelativePoses, usable: Bools, support: Array, X: Array, component: Ints
) -> None:
    """Join components, the best group of links first, in place: X_RG (F, 4, 4) in their G; component (F,)."""
    n_frames = len(component)
    i, j = relative.i[usable], relative.j[usable]
    links = RelativePoses(i, j, np.ascontiguousarray(relative.X_RiRj[usable]), relative.inliers[usable])
    weight = links.inliers * support[usable]
    order = np.argsort(-weight, kind="stable")
    score, T = np.full((n_frames, n_frames), -np.inf), np.empty((n_frames, n_frames, 4, 4))

    def renew(a: int) -> None:
        facts = (order, i, j, links.X_RiRj, links.inliers, weight)
        update_link_consensus(a, *facts, X, component, REJECT_RAD, REJECT_SHIFT, AGREEING, score, T)

    for a in np.unique(component).tolist():
        renew(a)
    while True:
        # of equal scores the last one is taken
        a, b = divmod(score.size - 1 - int(np.argmax(score.ravel()[::-1])), n_frames)
        if score[a, b] < MIN_SCORE:
            break
        small = min(np.sum(component == a), np.sum(component == b))
        moved = component == b
        X[moved] = X[moved] @ inverse_pose(T[a, b])
        component[moved] = a
        if small >= MIN_AVERAGED_FRAMES:
            member = component == a
            within = member[links.i] & member[links.j] & (edge_errors(X, links) < 1.5)
            X[:] = average_poses(X, member, links, within)
        score[b], score[:, b] = -np.inf, -np.inf
        renew(a)


def average_poses(
    X: Array, connected: Bools, relative: RelativePoses, accepted: Bools, sweeps: int = 8
) -> Array:
    """Robust averaging (Geman-McClure) of all edges of the component: rotations, then translations."""
    index = np.flatnonzero(accepted & connected[relative.i] & connected[relative.j])
    if len(index) == 0:
        return X
    i, j, X_ij = relative.i[index], relative.j[index], relative.X_RiRj[index]
    R, p = X[:, :3, :3].copy(), X[:, :3, 3].copy()
    n = len(X)
    for sweep in range(sweeps):
        error = log_so3(np.swapaxes(R[i], 1, 2) @ X_ij[:, :3, :3] @ R[j])
        width = REJECT_RAD * max(0.5, 3.0 * 0.6**sweep)
        weight = relative.inliers[index] / (1.0 + np.sum(error**2, axis=1) / width**2) ** 2
        # R_i ~ X_ij R_j: with right perturbations (in G) the error falls by theta_i - theta_j
        theta = _laplacian_solve(i, j, weight, error, n, connected)
        R = R @ exp_so3(theta)
    shift = X_ij[:, :3, 3]
    for _ in range(sweeps):
        target = shift - (p[i] - np.einsum("eab,eb->ea", X_ij[:, :3, :3], p[j]))
        # solve in G, where the edges' rotations cancel: p = R q
        error = np.einsum("eba,eb->ea", R[i], target)
        width = REJECT_SHIFT * np.linalg.norm(p[i], axis=1).mean() + 1e-9
        weight = relative.inliers[index] / (1.0 + np.sum(error**2, axis=1) / width**2) ** 2
        q = _laplacian_solve(i, j, weight, error, n, connected)
        p = p + np.einsum("fab,fb->fa", R, q)
    return make_pose(R, p)


def _laplacian_solve(i: Ints, j: Ints, weight: Array, error: Array, n: int, connected: Bools) -> Array:
    """Least squares of x_i - x_j = error (E, 3), the mean weakly fixed."""
    A = np.zeros((n, n))
    np.add.at(A, (i, i), weight)
    np.add.at(A, (j, j), weight)
    np.add.at(A, (i, j), -weight)
    np.add.at(A, (j, i), -weight)
    b = np.zeros((n, 3))
    np.add.at(b, i, weight[:, None] * error)
    np.add.at(b, j, -weight[:, None] * error)
    A[np.diag_indices(n)] += 1e-9 * weight.max(initial=1.0)
    A[~connected, ~connected] += 1.0
    return np.asarray(np.linalg.solve(A, b))
