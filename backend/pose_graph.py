"""From relative poses between pairs of frames to one pose per frame: spanning tree, robust averaging.

One link in ten fails at 30 degrees between frames, and a wrong link may be in the tree: edges are judged by
the triangles that they close before the tree is grown, and against the averaged poses afterwards.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.records import Bools, Ints, RelativePoses

MIN_INLIERS = 5
REJECT_RAD = np.deg2rad(10.0)
REJECT_SHIFT = 0.1
"""Largest error of a translation, as a share of the distance to the target."""


def connect(relative: RelativePoses, n_frames: int) -> tuple[Array, Bools, Bools]:
    """Poses X_RG (F, 4, 4) of the largest consistent piece, frames in it (F,), edges accepted (E,).

    G is the camera frame of the piece's root until the caller moves it.
    """
    usable = relative.inliers >= MIN_INLIERS
    accepted, X, connected = usable, np.tile(np.eye(4), (n_frames, 1, 1)), np.zeros(n_frames, bool)
    support = triangle_support(relative, usable, n_frames)
    for _ in range(3):
        X, connected = grow_tree(relative, accepted, support, n_frames)
        X = average_poses(X, connected, relative, accepted)
        consistent = usable & (edge_errors(X, relative) < 1.0) & connected[relative.i] & connected[relative.j]
        # edges outside the piece stay: they may join it to the rest in the next round
        outside = usable & ~(connected[relative.i] & connected[relative.j])
        if np.array_equal(consistent | outside, accepted):
            break
        accepted = consistent | outside
    X, connected = grow_tree(relative, accepted, support, n_frames)
    X = average_poses(X, connected, relative, accepted)
    inside = connected[relative.i] & connected[relative.j]
    return X, connected, accepted & inside


def relative_error(X_a: Array, X_b: Array) -> Array:
    """Disagreement of two relative poses (..., 4, 4) in units of the rejection thresholds."""
    turn = np.linalg.norm(log_so3(np.swapaxes(X_a[..., :3, :3], -1, -2) @ X_b[..., :3, :3]), axis=-1)
    distance = np.maximum(np.linalg.norm(X_b[..., :3, 3], axis=-1), 1e-9)
    shift = np.linalg.norm(X_a[..., :3, 3] - X_b[..., :3, 3], axis=-1)
    return np.asarray(
        np.maximum(
            turn / REJECT_RAD, shift / np.maximum(distance, 0.3 * np.median(distance)) / REJECT_SHIFT / 2
        )
    )


def edge_errors(X: Array, relative: RelativePoses) -> Array:
    """Disagreement (E,) of each edge with the poses (F, 4, 4), in units of the thresholds."""
    return relative_error(X[relative.i] @ inverse_pose(X[relative.j]), relative.X_RiRj)


def triangle_support(relative: RelativePoses, usable: Bools, n_frames: int) -> Array:
    """Share of closed triangles that agree, per edge (E,), with one good and one bad one assumed beforehand."""
    edge = np.full((n_frames, n_frames), -1, dtype=np.int64)
    index = np.flatnonzero(usable)
    edge[relative.i[index], relative.j[index]] = edge[relative.j[index], relative.i[index]] = index
    X = np.tile(np.eye(4), (n_frames, n_frames, 1, 1))
    X[relative.i[index], relative.j[index]] = relative.X_RiRj[index]
    X[relative.j[index], relative.i[index]] = inverse_pose(relative.X_RiRj[index])
    support = np.zeros(len(relative.i))
    for e in index:
        i, j = relative.i[e], relative.j[e]
        third = np.flatnonzero((edge[i] >= 0) & (edge[j] >= 0))[:40]
        agree = int(np.sum(relative_error(X[i, third] @ X[third, j], X[i, j]) < 1.5)) if len(third) else 0
        support[e] = (agree + 1.0) / (len(third) + 2.0)
    return support


def grow_tree(relative: RelativePoses, accepted: Bools, support: Array, n_frames: int) -> tuple[Array, Bools]:
    """Chain poses along the best spanning tree of the largest piece, from its best connected frame."""
    X, connected = np.tile(np.eye(4), (n_frames, 1, 1)), np.zeros(n_frames, bool)
    index = np.flatnonzero(accepted)
    if len(index) == 0:
        return X, connected
    i, j = relative.i[index], relative.j[index]
    quality = support[index] ** 2 * np.minimum(relative.inliers[index], 50)
    graph = coo_matrix((1.0 / (1e-6 + quality), (i, j)), shape=(n_frames, n_frames)).tocsr()
    _, label = connected_components(graph, directed=False)
    connected = label == np.argmax(np.bincount(label))
    degree = np.bincount(i, quality, n_frames) + np.bincount(j, quality, n_frames)
    root = int(np.argmax(np.where(connected, degree, -1.0)))
    edge = {(int(a), int(b)): int(e) for a, b, e in zip(i, j, index, strict=True)}
    order, parent = breadth_first_order(minimum_spanning_tree(graph), root, directed=False)
    for k in order[1:]:
        p = int(parent[k])
        if (p, int(k)) in edge:
            X[k] = inverse_pose(relative.X_RiRj[edge[p, int(k)]]) @ X[p]
        else:
            X[k] = relative.X_RiRj[edge[int(k), p]] @ X[p]
    return X, connected


def average_poses(
    X: Array, connected: Bools, relative: RelativePoses, accepted: Bools, sweeps: int = 8
) -> Array:
    """Robust averaging (Geman-McClure) of all edges of the piece: rotations, then translations."""
    index = np.flatnonzero(accepted & connected[relative.i] & connected[relative.j])
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
    """Least squares of x_i - x_j = error (E, 3), the largest piece's first frame held."""
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
