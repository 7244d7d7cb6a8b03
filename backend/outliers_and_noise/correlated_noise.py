"""Errors of observations that depend on one another, measured in the residuals of a solution.

The solvers take the errors of all observations as independent. Two kinds are not:

- The point that a feature marks slides over the surface as light and view change: the errors of one landmark
  are alike in frames between which the target has turned little (a process in the turn, not in time).
- Windows of neighbouring features overlap: their errors in one image are alike, above all of the disparity.

Both are measured here; ``uncertainty/covariance`` has what they do to the estimate. The variances of
the first kind are MINQUE's (Rao, "Estimation of variance and covariance components - MINQUE theory", J.
Multivariate Analysis 1, 1971), limited to nonnegative ones: the quadratic forms of the residuals are equated
to their expectations, so that the freedom that each landmark takes is accounted for.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.spatial import cKDTree

from polhode.backend.outliers_and_noise.noise_and_outliers import MAX_SHARE_OF_POSES, MIN_OBSERVATIONS
from polhode.backend.problem.motion_data import MotionData
from polhode.geometry.lie import Array, Ints

FORGETTING_TURNS_RAD = (0.3, 2.0, 6.0)
"""Turns over which the parts of the drift are forgotten; the last one is a random walk."""
KINDS = np.array([0, 0, 1])
"""u and v share their statistics."""
MAX_LANDMARKS, MAX_TRACK = 1500, 24
"""Landmarks, and observations of each, from which the drift is measured; both chosen evenly."""
CHUNK = 4_000_000
"""Elements of the largest array that is formed at once."""
MIN_TRACK = 3
"""A landmark seen less often has no residual left."""
NEIGHBOUR_EDGES_PX = np.array([0, 2, 4, 6, 8, 10, 12, 16, 20, 26, 32], dtype=np.float64)
"""Distances between which the products of neighbours' residuals are averaged."""
MAX_SHARED, LENGTHS_PX = 0.95, (1.0, 20.0)
FAR = 4.0
"""In these lengths: neighbours that are farther apart share nothing."""
MAX_FRAMES = 60
"""Frames whose neighbours are compared, chosen evenly."""
MIN_PAIRS = 30


@dataclass(frozen=True)
class CorrelatedNoise:
    """Covariance of the whitened errors of observations; row 0 for u and v, row 1 for the disparity."""

    independent: Array
    """(2,) variance of what is independent in each frame, between landmarks that are far apart"""
    drifting: Array
    """(2, 3) variances of the drift, by FORGETTING_TURNS_RAD"""
    shared: Array
    """(2,) correlation of neighbours at no distance"""
    length_px: Array
    """(2,) distance over which it decreases by a factor of e"""

    @property
    def slow(self) -> float:
        """Standard deviation of the drift of u and v that lasts over a turn of more than a radian."""
        return float(np.sqrt(self.drifting[0, np.array(FORGETTING_TURNS_RAD) > 1.0].sum()))

    def drift_between(self, turn_rad: Array) -> Array:
        """Covariance (3, F, F) of a landmark's errors of u, v and disparity, from ``turns_between``."""
        forgotten = np.exp(-turn_rad / np.array(FORGETTING_TURNS_RAD)[:, None, None])
        return np.asarray(np.tensordot(self.drifting, forgotten, axes=1)[KINDS])

    def variance(self, data: MotionData) -> Array:
        """Variance (M, 3) of what is independent between frames, times the weight of the neighbours.

        Neighbours look at the target from the same direction: errors that they share act like a larger error
        of each (the design effect of cluster samples, Kish 1965).
        """
        total = self.independent + self.drifting.sum(axis=1)
        a, b = _neighbours(data, min(FAR * float(self.length_px.max()), float(NEIGHBOUR_EDGES_PX[-1])))
        distance = np.linalg.norm(data.uvd_px[a, :2] - data.uvd_px[b, :2], axis=1)
        out = np.empty((len(data.frame), 3))
        for c, kind in enumerate(KINDS):
            common = total[kind] * self.shared[kind] * np.exp(-distance / self.length_px[kind])
            out[:, c] = self.independent[kind] + np.bincount(
                np.concatenate([a, b]), np.concatenate([common, common]), minlength=len(out)
            )
        return out


def turns_between(R_NG: Array, R_RG: Array) -> Array:
    """Turns (F, F) [rad] between frames, half in N, whose light is fixed, half as seen by the camera.

    Chords of SO(3), 2 sin(angle / 2): distances of a Euclidean space, in which exp(-distance) is a
    covariance.
    """
    chords = [np.sqrt(np.maximum(3.0 - R.reshape(-1, 9) @ R.reshape(-1, 9).T, 0.0)) for R in (R_NG, R_RG)]
    return np.asarray(0.5 * (chords[0] + chords[1]))


def measure_correlation(
    data: MotionData, residuals: Array, to_landmark: Array, turn_rad: Array
) -> CorrelatedNoise | None:
    """From whitened residuals (M, 3) and their derivatives in the landmarks (M, 3, 3); None: too few.

    turn_rad (F, F): ``turns_between``.
    """
    seen = np.diff(data.start)
    if np.sum(seen[seen >= MIN_TRACK]) < MIN_OBSERVATIONS:
        return None
    S, q = _quadratic_forms(data, residuals, to_landmark, turn_rad)
    # the poses are fitted to u and v too: six unknowns for the two numbers of each observation
    n = len(S) // 2
    q[:n] /= 1.0 - min(3.0 * len(np.unique(data.frame)) / len(data.frame), MAX_SHARE_OF_POSES)
    scale = 1.0 / np.sqrt(np.diag(S))
    L = np.linalg.cholesky(S * np.outer(scale, scale) + 1e-9 * np.eye(2 * n))
    parts = (scale * nnls(L.T, np.linalg.solve(L, scale * q))[0]).reshape(2, n)
    shared, length_px = _shared_by_neighbours(data, residuals)
    return CorrelatedNoise(parts[:, 0], parts[:, 1:], shared, length_px)


def _quadratic_forms(
    data: MotionData, residuals: Array, to_landmark: Array, turn_rad: Array
) -> tuple[Array, Array]:
    """Expected quadratic forms of the residuals for a unit of each variance, S (8, 8), and found, q (8,)."""
    forgetting = np.array(FORGETTING_TURNS_RAD)[:, None, None, None]
    n_parts = 2 * (1 + len(forgetting))
    S, q = np.zeros((n_parts, n_parts)), np.zeros(n_parts)
    for at in _tracks_of_equal_length(data, n_parts):
        n_marks, n = at.shape
        Q = np.linalg.qr(to_landmark[at].reshape(n_marks, 3 * n, 3))[0]
        r = residuals[at].reshape(n_marks, 3 * n, 1)
        r = (r - Q @ (np.swapaxes(Q, 1, 2) @ r)).reshape(n_marks, n, 3)
        between = turn_rad[data.frame[at][:, :, None], data.frame[at][:, None, :]]
        same = np.broadcast_to(np.eye(n), between.shape)
        over_frames = np.concatenate([same[None], np.exp(-between / forgetting)])
        parts = []
        for number, kind in enumerate((KINDS == 0, KINDS == 1)):
            found = np.einsum("lac,plab,lbc->p", r[:, :, kind], over_frames, r[:, :, kind])
            q[number * len(over_frames) : (number + 1) * len(over_frames)] += found
            for K in over_frames:
                V = np.einsum("lab,c,cd->lacbd", K, kind.astype(np.float64), np.eye(3))
                V = V.reshape(n_marks, 3 * n, 3 * n)
                parts.append(V - Q @ (np.swapaxes(Q, 1, 2) @ V))
        for i, left in enumerate(parts):
            for j, right in enumerate(parts[: i + 1]):
                S[i, j] += np.einsum("lab,lba->", left, right)
    return np.tril(S) + np.tril(S, -1).T, q


def _tracks_of_equal_length(data: MotionData, n_parts: int) -> Iterator[Ints]:
    """Observations (marks, n) of landmarks that are used to measure the drift, in batches."""
    seen = np.diff(data.start)
    long_enough = np.flatnonzero(seen >= MIN_TRACK)
    chosen = long_enough[:: max(1, -(-len(long_enough) // MAX_LANDMARKS))]
    length = np.minimum(seen[chosen], MAX_TRACK)
    for n in np.unique(length):
        marks = chosen[length == n]
        at = data.start[marks][:, None] + np.linspace(0, seen[marks] - 1, n, axis=1).round().astype(np.int64)
        step = max(1, CHUNK // (n_parts * 9 * int(n) ** 2))
        yield from (at[first : first + step] for first in range(0, len(at), step))


def _shared_by_neighbours(data: MotionData, residuals: Array) -> tuple[Array, Array]:
    """Correlation of the residuals of neighbours in one image, at no distance (2,), and its length [px] (2,).

    An exponential is fitted to the products of residuals, averaged between NEIGHBOUR_EDGES_PX.
    """
    enough = np.diff(data.start)[data.landmark] >= MIN_TRACK
    a, b = _neighbours(data, float(NEIGHBOUR_EDGES_PX[-1]), MAX_FRAMES)
    both = enough[a] & enough[b]
    a, b = a[both], b[both]
    shared, length_px = np.zeros(2), np.ones(2)
    if len(a) < MIN_PAIRS:
        return shared, length_px
    distance = np.linalg.norm(data.uvd_px[a, :2] - data.uvd_px[b, :2], axis=1)
    n = len(NEIGHBOUR_EDGES_PX) - 1
    between = np.clip(np.digitize(distance, NEIGHBOUR_EDGES_PX) - 1, 0, n - 1)
    count = np.maximum(np.bincount(between, minlength=n), 1)
    middle = np.bincount(between, distance, minlength=n) / count
    power = np.mean(residuals[enough] ** 2, axis=0)
    products = residuals[a] * residuals[b] / np.maximum(power, 1e-12)
    for kind in range(2):
        own = products[:, kind == KINDS].mean(axis=1)
        alike = np.bincount(between, own, minlength=n) / count

        def misfit(x: Array, alike: Array = alike) -> Array:
            return np.asarray((x[0] * np.exp(-middle / x[1]) - alike) * np.sqrt(count))

        bounds = ([0.0, LENGTHS_PX[0]], [MAX_SHARED, LENGTHS_PX[1]])
        shared[kind], length_px[kind] = least_squares(misfit, [0.3, 4.0], bounds=bounds).x
    return shared, length_px


def _neighbours(data: MotionData, limit_px: float, max_frames: int | None = None) -> tuple[Ints, Ints]:
    """Pairs of observations of one frame that are at most limit_px apart in the left image."""
    order = np.argsort(data.frame, kind="stable")
    bounds = np.searchsorted(data.frame[order], np.arange(data.n_frames + 1))
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    step = 1 if max_frames is None else -(-data.n_frames // max_frames)
    for k in range(0, data.n_frames, step):
        own = order[bounds[k] : bounds[k + 1]]
        if len(own) >= 2:
            found = cKDTree(data.uvd_px[own, :2]).query_pairs(limit_px, output_type="ndarray")
            pairs.append(own[found])
    both = np.concatenate(pairs)
    return both[:, 0], both[:, 1]
