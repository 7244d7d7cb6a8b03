"""Whether the mass properties are the same before and after an unknown push: a part may have left the target.

A run gives one inertia and one centre of mass. When a mass leaves, velocities change at once, which is taken
for a push, and from then on another body turns. Where a push was found, the centres of mass before and after
it are compared; where these agree, the frames before and after the strongest push are solved apart, and what
both determine is compared. What would not show is reported.

The centre of mass is the one point of a free body that does not circle: its path is straight, but for weak
random accelerations. So r(t) = p_NG + R_NG c is linear in the centre c, the position and the velocity at the
start; generalised least squares solves for them, with the covariance of an integrated random walk. The poses
are those of the landmarks frame by frame, without dynamics, as a solution that assumes one body throughout
would bend them.
"""

import logging
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, solve_triangular

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, Ints, hat, inverse_pose, log_so3, transform_points
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.pipeline.checks.data_checks.disparity_steps import fit_view
from polhode.records.estimate import Impulse, InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, frame_step, make_check
from polhode.run_directory.summary_schema import Check
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent

MIN_FRAMES = 8
"""On either side of a push."""
CLEAR_SIGMAS = 5.0
"""Standard deviations above which a difference is significant"""
MIN_CHANGE_M = 1e-3
"""Below it, a change of the centre of mass does not matter"""
ACCEL_PSD = 10.0 ** np.arange(-12.0, -1.5)
"""Of the random accelerations [m^2/s^3]: the likeliest is taken."""

_log = logging.getLogger(__name__)


def mass_checks(
    tracks: StereoTracks, estimate: MotionEstimate, config: Backend
) -> tuple[list[Check], list[str]]:
    """Whether centre of mass and mass properties are the same after a push; else what change would not show.

    At no cost where no push was found.
    """
    centre, halves = make_check("centre before and after", None), make_check("mass before and after", None)
    impulses = estimate.disturbances.impulses if estimate.disturbances is not None else ()
    if not impulses:
        return [centre, halves], []
    path, stamps = seen_path(tracks, estimate), tracks.timestamps_ns
    ends = [[int(np.searchsorted(stamps, at)) for at in (push.start_ns, push.end_ns)] for push in impulses]
    changes = [centre_change(path, *each) for each in ends]
    clearest = max((each for each in changes if each is not None), key=lambda each: each.sigmas, default=None)
    if clearest is not None:
        size_m = float(np.linalg.norm(clearest.change_G))
        facts = {"from_s": tracks.time_s[clearest.first_after], "change_mm": 1e3 * size_m}
        centre = make_check("centre before and after", clearest.sigmas, **facts)
        if size_m <= MIN_CHANGE_M:
            centre = centre.model_copy(update={"reason": ""})
        if centre.reason:
            return [centre, halves], []

    def strength(push: Impulse) -> float:
        """Largest change over its sigma."""
        change = np.concatenate([push.delta_v_N, push.delta_w_P])
        return float(np.max(np.abs(change) / np.concatenate([push.sigma_delta_v_N, push.sigma_delta_w_P])))

    strongest = max(impulses, key=strength)
    start_s, end_s = ((at - int(stamps[0])) * 1e-9 for at in (strongest.start_ns, strongest.end_ns))
    before, after = (
        _solve_part(tracks, estimate, config, frames)
        for frames in (stamps <= strongest.start_ns, stamps >= strongest.end_ns)
    )
    if before is not None and after is not None:
        found = _differences(before, after)
        halves = make_check(
            "mass before and after", len(found), start_s=start_s, end_s=end_s, changes="; ".join(found)
        )
    hidden = "" if halves.reason else _hidden_change(estimate, changes[impulses.index(strongest)])
    if not hidden:
        return [centre, halves], []
    return [centre, halves], [
        "the mass properties are taken as those of one body throughout: if a part left it or moved with the "
        f"push between {start_s:.1f} s and {end_s:.1f} s, {hidden} would not show in these images"
    ]


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


class CentreChange(NamedTuple):
    """Centres of mass before and after the instant that explains the path best."""

    first_after: int
    """Index of a frame"""
    change_G: Array
    """(3,) after minus before [m]"""
    cov_G: Array
    """(3, 3) of the change"""
    sigmas: float
    """Length of the change in standard deviations"""


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
    # a prior: the sigmas of the unknowns stay below 1 km
    information = A.T @ A + 1e-6 * np.eye(A.shape[1])
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
        side = path.frame <= frame
        if min(side.sum(), (~side).sum()) >= MIN_FRAMES:
            found.append((frame + 1, centre_of(path, side), centre_of(path, ~side)))
    if not found:
        return None
    place, before, after = min(found, key=lambda each: each[1].cost + each[2].cost)
    change_G, cov_G = after.com_G - before.com_G, after.cov_G + before.cov_G
    return CentreChange(place, change_G, cov_G, float(np.sqrt(change_G @ np.linalg.solve(cov_G, change_G))))


def _hidden_change(estimate: MotionEstimate, change: CentreChange | None) -> str:
    """How far the centre of mass may have moved at a push without a sign; empty: that does not matter."""
    mass = estimate.mass
    claimed = np.array(mass.identifiable.com_P)
    if not claimed.any():
        return ""
    if change is None:
        return "any change"
    clear = CHECK_TABLE["centre before and after"].limit or 0.0
    hidden_m = clear * np.sqrt(np.diagonal(mass.R_GP.T @ change.cov_G @ mass.R_GP))[claimed].max()
    stated_m = np.sqrt(np.diagonal(mass.R_GP.T @ np.nan_to_num(mass.cov_com_G, posinf=0.0) @ mass.R_GP))
    if hidden_m < max(CLEAR_SIGMAS * float(stated_m[claimed].max()), MIN_CHANGE_M):
        return ""
    return f"a centre of mass that moved by up to {1e3 * hidden_m:.2g} mm"


def _solve_part(
    tracks: StereoTracks, estimate: MotionEstimate, config: Backend, frames: Bools
) -> MotionEstimate | None:
    """The estimate of some frames (F,) alone, its G moved onto that of the whole; None: too few, or none."""
    part = part_of(tracks, frames)
    if len(np.unique(part.frame)) < MIN_FRAMES:
        return None
    X_NG = estimate.X_NG[frames]
    seen = np.isin(np.arange(part.n_frames), part.frame)
    try:
        found = estimate_motion(part, InitialMotion(inverse_pose(part.X_NR) @ X_NG, seen), config, Silent())
    except (RunFailure, LinAlgError) as failure:
        _log.info("a part of the sequence has no solution of its own: %s", failure)
        return None
    X_GG = inverse_pose(X_NG) @ found.X_NG
    middle, mass = X_GG[len(X_GG) // 2], found.mass
    R = middle[:3, :3]
    moved = replace(
        mass,
        com_G=transform_points(middle, mass.com_G[None])[0],
        cov_com_G=R @ np.nan_to_num(mass.cov_com_G, posinf=1e6) @ R.T,
        R_GP=R @ mass.R_GP,
    )
    return replace(found, mass=moved)


def part_of(tracks: StereoTracks, frames: Bools) -> StereoTracks:
    """The measurements of some frames (F,); landmarks get new numbers."""
    number, rows = np.cumsum(frames) - 1, frames[tracks.frame]
    _, landmark = np.unique(tracks.landmark[rows], return_inverse=True)
    return replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[frames],
        X_NR=tracks.X_NR[frames],
        frame=number[tracks.frame[rows]],
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows],
    )


def _differences(before: MotionEstimate, after: MotionEstimate) -> list[str]:
    """What both determine and what differs by enough to matter, as descriptions."""

    def size_and_sigma(change: Array, covariance: Array) -> tuple[float, float]:
        """Length of a vector (3,), and its standard deviation along itself."""
        size = float(np.linalg.norm(change))
        along = change / max(size, 1e-12)
        return size, float(np.sqrt(along @ covariance @ along))

    a, b = before.mass, after.mass
    out = []
    for n, name in enumerate(("k1", "k2")):
        if getattr(a.identifiable, name) and getattr(b.identifiable, name):
            change = getattr(b, name) - getattr(a, name)
            sigma = float(np.sqrt(a.cov_k[n, n] + b.cov_k[n, n]))
            if abs(change) > max(CLEAR_SIGMAS * sigma, 0.01):
                out.append(f"{name} by {change:+.3f}, sigma {sigma:.3f}")
    if a.identifiable.com and b.identifiable.com:
        size, sigma = size_and_sigma(b.com_G - a.com_G, a.cov_com_G + b.cov_com_G)
        if size > max(CLEAR_SIGMAS * sigma, MIN_CHANGE_M):
            out.append(f"centre of mass by {1e3 * size:.1f} mm, sigma {1e3 * sigma:.1f} mm")
    if a.identifiable.axes and b.identifiable.axes:
        between = a.R_GP.T @ b.R_GP
        turn = log_so3(between * HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))])
        size, sigma = size_and_sigma(turn, a.cov_R_GP + b.cov_R_GP)
        if size > max(CLEAR_SIGMAS * sigma, float(np.deg2rad(1.0))):
            out.append(f"principal axes by {np.rad2deg(size):.1f} deg, sigma {np.rad2deg(sigma):.1f} deg")
    return out
