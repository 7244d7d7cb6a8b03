"""Whether the mass properties are the same before and after an unknown push: a part may have left the target.

A run gives one inertia and one centre of mass. When a mass leaves, velocities change at once, which is taken
for a push, and from then on another body turns. Where a push was found, the centres of mass before and after
it are compared (``centre_check``); where these agree, the frames before and after the strongest push are
solved apart, and what both determine is compared. What would not show is reported.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, inverse_pose, log_so3, transform_points
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.pipeline.checks.data_checks.centre_check import CentreChange, centre_change, seen_path
from polhode.records.estimate import Impulse, InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, make_check
from polhode.run_directory.summary_schema import Check
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent

MIN_FRAMES = 8
"""On either side of the push."""
CLEAR_SIGMAS = 5.0
"""Standard deviations above which a difference is significant"""
MIN_CHANGE_M, MIN_CHANGE_K, MIN_CHANGE_RAD = 1e-3, 0.01, float(np.deg2rad(1.0))
"""Sizes below which a change does not matter: of the centre of mass, a ratio, an axis"""

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
    strongest = max(impulses, key=_strength)
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


def _strength(push: Impulse) -> float:
    """Largest change over its sigma."""
    change = np.concatenate([push.delta_v_N, push.delta_w_P])
    return float(np.max(np.abs(change) / np.concatenate([push.sigma_delta_v_N, push.sigma_delta_w_P])))


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
    middle = X_GG[len(X_GG) // 2]
    mass = found.mass
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
    number = np.cumsum(frames) - 1
    rows = frames[tracks.frame]
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
    """What both determine and what differs, as descriptions."""
    a, b = before.mass, after.mass
    out = []
    for n, name in enumerate(("k1", "k2")):
        if getattr(a.identifiable, name) and getattr(b.identifiable, name):
            change = getattr(b, name) - getattr(a, name)
            sigma = float(np.sqrt(a.cov_k[n, n] + b.cov_k[n, n]))
            if abs(change) > max(CLEAR_SIGMAS * sigma, MIN_CHANGE_K):
                out.append(f"{name} by {change:+.3f}, sigma {sigma:.3f}")
    if a.identifiable.com and b.identifiable.com:
        size, sigma = _size_and_sigma(b.com_G - a.com_G, a.cov_com_G + b.cov_com_G)
        if size > max(CLEAR_SIGMAS * sigma, MIN_CHANGE_M):
            out.append(f"centre of mass by {1e3 * size:.1f} mm, sigma {1e3 * sigma:.1f} mm")
    if a.identifiable.axes and b.identifiable.axes:
        between = a.R_GP.T @ b.R_GP
        turn = log_so3(between * HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))])
        size, sigma = _size_and_sigma(turn, a.cov_R_GP + b.cov_R_GP)
        if size > max(CLEAR_SIGMAS * sigma, MIN_CHANGE_RAD):
            out.append(f"principal axes by {np.rad2deg(size):.1f} deg, sigma {np.rad2deg(sigma):.1f} deg")
    return out


def _size_and_sigma(change: Array, covariance: Array) -> tuple[float, float]:
    """Length of a vector (3,), and its standard deviation along itself."""
    size = float(np.linalg.norm(change))
    along = change / max(size, 1e-12)
    return size, float(np.sqrt(along @ covariance @ along))
