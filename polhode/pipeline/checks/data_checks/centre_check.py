"""Where the centre of mass was, before and after an instant, by the poses of the target alone.

The centre of mass is the one point of a free body that does not circle: its path is straight, but for weak
random accelerations. So r(t) = p_NG + R_NG c is linear in the centre c, the position and the velocity at the
start; generalised least squares solves for them, with the covariance of an integrated random walk. The poses
are those of the landmarks frame by frame, without dynamics, as a solution that assumes one body throughout
would bend them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from polhode.geometry.lie import Array, Bools, Ints, hat, inverse_pose, transform_points
from polhode.pipeline.checks.data_checks.disparity_steps import fit_view
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import frame_step

MIN_FRAMES = 8
"""On either side of the instant."""
ACCEL_PSD = 10.0 ** np.arange(-12.0, -1.5)
"""Of the random accelerations [m^2/s^3]: the likeliest is taken."""
PRIOR = 1e-6
"""Of the information on each unknown: their sigmas stay below 1 km"""


@dataclass(frozen=True)
class SeenPath:
    """The target in the frames that show enough of it, without dynamics."""

    frame: Ints
    """(n,) index"""
    time_s: Array
    """(n,)"""
    R_NG: Array
    """(n, 3, 3)"""
    p_N: Array
    """(n, 3) of a point of the body near its centre of mass [m]"""
    point_G: Array
    """(3,) that point [m]"""
    cov_p_N: Array
    """(n, 3, 3) [m^2]"""


class Centre(NamedTuple):
    """The centre of mass that makes a path straight."""

    com_G: Array
    """(3,) [m]"""
    cov_G: Array
    """(3, 3) [m^2]"""
    cost: float
    """Minus twice the logarithm of the restricted likelihood"""


@dataclass(frozen=True)
class CentreChange:
    """Centres of mass before and after the instant that explains the path best."""

    before: Centre
    after: Centre
    first_after: int
    """Index of a frame"""

    @property
    def change_G(self) -> Array:
        """(3,) after minus before [m]."""
        return self.after.com_G - self.before.com_G

    @property
    def cov_G(self) -> Array:
        """(3, 3) of the change."""
        return self.after.cov_G + self.before.cov_G

    @property
    def sigmas(self) -> float:
        """Length of the change in standard deviations."""
        return float(np.sqrt(self.change_G @ np.linalg.solve(self.cov_G, self.change_G)))


def seen_path(tracks: StereoTracks, estimate: MotionEstimate) -> SeenPath:
    """Each frame's pose by itself: least squares over the landmarks where the estimate has them."""
    used, noise, com_G = np.flatnonzero(estimate.inlier_weight > 0.0), estimate.noise, estimate.mass.com_G
    X = (inverse_pose(estimate.X_NG) @ tracks.X_NR)[tracks.frame[used]]
    p_R = tracks.rig.triangulate(tracks.uvd_px[used] - estimate.residuals_px[used])
    p_G, known = np.zeros((tracks.n_landmarks, 3)), np.zeros(tracks.n_landmarks, dtype=np.bool_)
    p_G[tracks.landmark[used]] = np.einsum("nij,nj->ni", X[:, :3, :3], p_R) + X[:, :3, 3]
    known[tracks.landmark[used]] = True
    sigma_px = np.maximum([noise.pixel_sigma_px, noise.pixel_sigma_px, noise.disparity_sigma_px], 1e-6)
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    found = []
    for k in range(0, tracks.n_frames, frame_step(tracks.n_frames)):
        rows = np.flatnonzero((tracks.frame == k) & known[tracks.landmark])
        if len(rows) < 8:
            continue
        seen = p_G[tracks.landmark[rows]], tracks.uvd_px[rows]
        if (fitted := fit_view(tracks.rig, X_RG[k], *seen, sigma_px, with_offset=False)) is None:
            continue
        at_R, R_NR = transform_points(fitted.X_BA, com_G[None])[0], tracks.X_NR[k, :3, :3]
        J = R_NR @ np.hstack([np.eye(3), -hat(at_R)])
        p_N = transform_points(tracks.X_NR[k], at_R[None])[0]
        found.append((k, R_NR @ fitted.X_BA[:3, :3], p_N, J @ fitted.covariance @ J.T))
    frame = np.array([each[0] for each in found], dtype=np.int64)
    R_NG, p_N, cov_p_N = (
        np.array([each[n] for each in found]).reshape(-1, *shape)
        for n, shape in ((1, (3, 3)), (2, (3,)), (3, (3, 3)))
    )
    return SeenPath(frame, tracks.time_s[frame], R_NG, p_N, com_G, cov_p_N)


def centre_of(path: SeenPath, rows: Bools) -> Centre:
    """The centre of mass by some of the poses (n,), with the likeliest random accelerations."""
    R_NG, p_N = path.R_NG[rows], path.p_N[rows]
    t = path.time_s[rows] - path.time_s[rows][0]
    n = len(t)
    design = np.zeros((n, 3, 9))
    design[:, :, 0:3], design[:, :, 3:6] = np.eye(3), t[:, None, None] * np.eye(3)
    # r = p + R (c - point), and r is straight
    design[:, :, 6:9] = -R_NG
    early, late = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    walk = early**2 * (3.0 * late - early) / 6.0
    measured = np.zeros((n, 3, n, 3))
    measured[np.arange(n), :, np.arange(n), :] = path.cov_p_N[rows]
    every_axis = walk[:, None, :, None] * np.eye(3)[None, :, None, :]
    solutions = [
        _least_squares(design.reshape(-1, 9), p_N.ravel(), (measured + psd * every_axis).reshape(3 * n, -1))
        for psd in ACCEL_PSD
    ]
    x, covariance, cost = min(solutions, key=lambda each: each[2])
    return Centre(path.point_G + x[6:9], covariance[6:9, 6:9], cost)


def _least_squares(A: Array, y: Array, covariance: Array) -> tuple[Array, Array, float]:
    """Unknowns, their covariance, and the cost of the covariance of y, scaled up to what is found."""
    L = np.linalg.cholesky(covariance)
    A, y = solve_triangular(L, A, lower=True), solve_triangular(L, y, lower=True)
    information = A.T @ A + PRIOR * np.eye(A.shape[1])
    inverse = np.linalg.inv(information)
    x = inverse @ (A.T @ y)
    squares, freedom = float(np.sum((y - A @ x) ** 2)), len(y) - A.shape[1]
    scale = max(squares / freedom, 1.0)
    logarithms = 2.0 * np.sum(np.log(np.diagonal(L))) + np.linalg.slogdet(information)[1]
    cost = float(logarithms + freedom * np.log(scale) + squares / scale)
    return x, inverse * scale, cost


def centre_change(path: SeenPath, first: int, last: int) -> CentreChange | None:
    """The centres before and after the likeliest instant between two frames; None: too few frames."""
    found = []
    for frame in range(first, max(last, first + 1)):
        before = path.frame <= frame
        if min(before.sum(), (~before).sum()) >= MIN_FRAMES:
            found.append(CentreChange(centre_of(path, before), centre_of(path, ~before), frame + 1))
    return min(found, key=lambda each: each.before.cost + each.after.cost, default=None)
