"""From relative poses between pairs of frames to one pose per frame: consensus of links, robust averaging.

One link in ten is wrong at 30 degrees between frames, and a wrong link looks like a correct one. Frames are
therefore joined to connected components, and these to larger ones, always by the largest group of links that
agree with each other: two agreeing links of seven inliers are worth more than one of fifteen. Then all poses
are averaged robustly.

Sides of a body that look alike (a truss after a half-turn, a drum after any rotation) give links that are
wrong by that symmetry, many of them, and they close triangles among themselves. But no body jumps to another
side and back: of the links between near frames those are right that agree on one rate of rotation.
"""

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints, exp_so3, inverse_pose, log_so3, make_pose
from polhode.records.tracks import RelativePoses
from polhode.runtime.compiled import compiled

MAX_LINKS = 16
"""Number of links between two components that are compared, those of the largest weight."""
MAX_TRIANGLES = 40
NEAR = 3
"""Largest number of frames between the ends of a link that shows the rate; beyond it nutation changes the
rate."""
AROUND = 2.5
"""Largest distance [frames] of the middles of links that should show the same rate."""
SAME_TURN_RAD = np.deg2rad(20.0)
"""Links whose rotations differ by less continue each other; symmetries of bodies are larger."""
MIN_SHARE = 0.6
"""Share of the inliers around a link that are in links that agree with it."""
MIN_LINKS = 2
"""Number of links that agree with it."""
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


@compiled
def update_link_consensus(
    a: int, order: Ints, i: Ints, j: Ints, X_ij: Array, inliers: Ints, weight: Array, X: Array,
    component: Ints, bound_rad: float, bound_shift: float, agreeing: float, score: Array, T: Array,
) -> None:  # fmt: skip
    """Largest group of agreeing links between component a and every other one b, in place.

    order (E,) of the links i, j, X_ij (E, 4, 4) by falling weight; X (F, 4, 4), component (F,). Written above
    the diagonal, at (min(a, b), max(a, b)): score (F, F), ``agreeing`` plus its inliers for each link of the
    group, the weight of a single link, -inf without links; T (F, F, 4, 4) with p_Gmin = T p_Gmax.
    """
    n = len(score)
    count, member = np.zeros(n, dtype=np.int64), np.empty((n, MAX_LINKS), dtype=np.int64)
    for e in order:
        p, q = component[i[e]], component[j[e]]
        if (p == a) != (q == a):
            other = q if p == a else p
            if count[other] < MAX_LINKS:
                member[other, count[other]] = e
                count[other] += 1
    R, t = np.empty((MAX_LINKS, 3, 3)), np.empty((MAX_LINKS, 3))
    centre, distance = np.empty((MAX_LINKS, 3)), np.empty(MAX_LINKS)
    for other in range(n):
        low, high, size = min(a, other), max(a, other), count[other]
        if size == 0:
            if other != a:
                score[low, high] = -np.inf
            continue
        for m in range(size):
            e = member[other, m]
            ahead = component[i[e]] == low
            A, B = (X[i[e]], X[j[e]]) if ahead else (X[j[e]], X[i[e]])
            distance[m] = _between(A, X_ij[e], B, ahead, R[m], t[m], centre[m])
        scale = 0.3 * _median(distance, size)
        best, most, links = 0, -1.0, 0
        for s in range(size):
            total, agree = 0.0, 0
            for m in range(size):
                allowed = 2.0 * bound_shift * max(distance[m], scale)
                if s == m or _agree(R[s], t[s], R[m], t[m], centre[m], bound_rad, allowed):
                    total += agreeing + inliers[member[other, m]]
                    agree += 1
            if total > most:
                best, most, links = s, total, agree
        if links == 1:
            best = 0
        score[low, high] = weight[member[other, 0]] if links == 1 else most
        _put_pose(R[best], t[best], T[low, high])


@compiled
def _put_pose(R: Array, t: Array, T: Array) -> None:
    """R (3, 3) and t (3,) into T (4, 4); element by element, since slices take seconds to compile."""
    for r in range(3):
        for c in range(3):
            T[r, c] = R[r, c]
        T[r, 3], T[3, r] = t[r], 0.0
    T[3, 3] = 1.0


@compiled
def _median(values: Array, size: int) -> float:
    """Of the first ``size`` values, by insertion: NumPy's takes seconds to compile."""
    ordered = values[:size].copy()
    for k in range(1, size):
        value, at = ordered[k], k
        while at > 0 and ordered[at - 1] > value:
            ordered[at] = ordered[at - 1]
            at -= 1
        ordered[at] = value
    return float(0.5 * (ordered[(size - 1) // 2] + ordered[size // 2]))


@compiled
def _between(A: Array, X_ij: Array, B: Array, ahead: bool, R: Array, t: Array, centre: Array) -> float:
    """R, t = A^-1 L B, the link L = X_ij or its inverse; centre of B's camera in G. Returns L's distance."""
    L, p = np.empty((3, 3)), np.empty(3)
    for r in range(3):
        p[r] = 0.0
        for c in range(3):
            L[r, c] = X_ij[r, c] if ahead else X_ij[c, r]
            p[r] -= 0.0 if ahead else X_ij[c, r] * X_ij[c, 3]
        if ahead:
            p[r] = X_ij[r, 3]
    M, q = np.zeros((3, 3)), np.empty(3)
    for r in range(3):
        q[r] = p[r] - A[r, 3]
        for c in range(3):
            q[r] += L[r, c] * B[c, 3]
            for k in range(3):
                M[r, c] += L[r, k] * B[k, c]
    for r in range(3):
        t[r] = A[0, r] * q[0] + A[1, r] * q[1] + A[2, r] * q[2]
        centre[r] = -(B[0, r] * B[0, 3] + B[1, r] * B[1, 3] + B[2, r] * B[2, 3])
        for c in range(3):
            R[r, c] = A[0, r] * M[0, c] + A[1, r] * M[1, c] + A[2, r] * M[2, c]
    return float(max(np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2), 1e-9))


@compiled
def _agree(
    R_a: Array, t_a: Array, R_b: Array, t_b: Array, point: Array, bound_rad: float, bound_shift: float
) -> bool:
    """Whether two poses differ by less than an angle, and their images of a point by less than a distance."""
    trace = square = 0.0
    for r in range(3):
        shift = t_a[r] - t_b[r]
        for c in range(3):
            trace += R_a[r, c] * R_b[r, c]
            shift += (R_a[r, c] - R_b[r, c]) * point[c]
        square += shift**2
    turn = np.arccos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
    return bool(turn < bound_rad and np.sqrt(square) < bound_shift)


@compiled
def closed_triangles(
    i: Ints, j: Ints, X_ij: Array, linked: Array, X: Array, bound_rad: float, bound_shift: float
) -> tuple[Array, Array]:
    """The first ``MAX_TRIANGLES`` triangles on each link i, j (E,), X_ij (E, 4, 4); how many agree with it.

    linked (F, F) of frames, X (F, F, 4, 4) their relative poses, of two links one; bound_shift as a share of
    the distance.
    """
    agree, seen = np.zeros(len(i)), np.zeros(len(i))
    R, t, zero = np.empty((3, 3)), np.empty(3), np.zeros(3)
    direct, p = np.empty((3, 3)), np.empty(3)
    for e in range(len(i)):
        for r in range(3):
            p[r] = X_ij[e, r, 3]
            for c in range(3):
                direct[r, c] = X_ij[e, r, c]
        allowed = bound_shift * max(np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2), 1e-9)
        for third in range(len(linked)):
            if not (linked[i[e], third] and linked[j[e], third]):
                continue
            A, B = X[i[e], third], X[third, j[e]]
            for r in range(3):
                t[r] = A[r, 3]
                for c in range(3):
                    t[r] += A[r, c] * B[c, 3]
                    R[r, c] = A[r, 0] * B[0, c] + A[r, 1] * B[1, c] + A[r, 2] * B[2, c]
            seen[e] += 1.0
            if _agree(R, t, direct, p, zero, bound_rad, allowed):
                agree[e] += 1.0
            if seen[e] == MAX_TRIANGLES:
                break
    return agree, seen


def smooth_links(relative: RelativePoses, usable: Bools, time_s: Array, R_NR: Array) -> Bools:
    """Which links (E,) others continue; time_s (F,) [s], R_NR (F, 3, 3) attitudes of the camera."""
    near = np.flatnonzero(usable & (np.abs(relative.j - relative.i) <= NEAR))
    smooth = np.zeros(len(usable), dtype=np.bool_)
    if len(near) <= MIN_LINKS:
        return smooth
    i, j, inliers = relative.i[near], relative.j[near], relative.inliers[near].astype(np.float64)
    # the rotation of the target in N from frame j back to frame i
    turn = R_NR[i] @ relative.X_RiRj[near, :3, :3] @ np.swapaxes(R_NR[j], 1, 2)
    dt_s = time_s[j] - time_s[i]
    rate = log_so3(turn) / dt_s[:, None]
    middle = 0.5 * (i + j)
    for n, link in enumerate(near):
        others = np.flatnonzero(np.abs(middle - middle[n]) <= AROUND)
        others = others[others != n]
        expected = exp_so3(rate[n] * dt_s[others, None])
        off = np.linalg.norm(log_so3(np.swapaxes(expected, 1, 2) @ turn[others]), axis=1)
        agree = off < SAME_TURN_RAD
        share = np.sum(inliers[others][agree]) / max(np.sum(inliers[others]), 1.0)
        smooth[link] = agree.sum() >= MIN_LINKS and share >= MIN_SHARE
    return smooth


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
