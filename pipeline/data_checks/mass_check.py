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
from polhode.errors import RunFailure
from polhode.lie import Array, inverse_pose, log_so3, transform_points
from polhode.pipeline.data_checks.centre_check import CentreChange, SeenPath, centre_change, seen_path
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.progress import Silent
from polhode.records import Bools, Impulse, InitialMotion, MotionEstimate, StereoTracks
from polhode.rigid_body import HALF_TURNS

MIN_FRAMES = 8
"""On either side of the push."""
CLEAR = 5.0
"""A difference is significant above this number of standard deviations;"""
CLEAR_CENTRE = 7.0
"""The same of the centre of mass by poses alone, whose errors have more in common than their sigmas know:
undisturbed sequences show 6.1 at the worst of all instants."""
MATTERS_M, MATTERS_K, MATTERS_RAD = 1e-3, 0.01, float(np.deg2rad(1.0))
"""and above this size: of the centre of mass, a ratio, an axis."""

_log = logging.getLogger(__name__)


def mass_checks(
    tracks: StereoTracks, estimate: MotionEstimate, config: Backend
) -> tuple[list[Check], list[str]]:
    """Whether centre of mass and mass properties are the same after a push; else what change would not show.

    At no cost where no push was found.
    """
    centre = Check(name="centre of mass before and after a push", limit=CLEAR_CENTRE, unit="sigma")
    halves = Check(name="mass properties that differ before and after a push", limit=0.0)
    impulses = estimate.disturbances.impulses if estimate.disturbances is not None else ()
    if not impulses:
        return [centre, halves], []
    path = seen_path(tracks, estimate)
    changes = [_change_at(path, tracks, push) for push in impulses]
    known = [change for change in changes if change is not None]
    clearest = max(known, key=lambda change: change.sigmas, default=None)
    if clearest is not None:
        reason = _moved_centre(clearest, tracks.time_s) if _moved(clearest) else ""
        centre = centre.model_copy(update={"value": clearest.sigmas, "reason": reason})
        if reason:
            return [centre, halves], []
    strongest = max(impulses, key=_strength)
    found = _different_halves(tracks, estimate, config, strongest)
    if found is not None:
        words = _other_properties(found, strongest, int(tracks.timestamps_ns[0]))
        halves = halves.judged(len(found), words)
    change = changes[impulses.index(strongest)]
    return [centre, halves], [] if halves.reason else _unseen_change(estimate, strongest, change)


def _change_at(path: SeenPath, tracks: StereoTracks, push: Impulse) -> CentreChange | None:
    first, last = (int(np.searchsorted(tracks.timestamps_ns, at)) for at in (push.start_ns, push.end_ns))
    return centre_change(path, first, last)


def _moved(change: CentreChange) -> bool:
    return change.sigmas > CLEAR_CENTRE and float(np.linalg.norm(change.change_G)) > MATTERS_M


def _moved_centre(change: CentreChange, time_s: Array) -> str:
    size_m = float(np.linalg.norm(change.change_G))
    return (
        f"from {time_s[change.first_after]:.1f} s on the centre of mass is another point of the target than "
        f"before (by {1e3 * size_m:.1f} mm, {change.sigmas:.0f} sigma): a part may have left it, or moved; "
        "what is stated of mass, axes and motion for the whole sequence is true of neither"
    )


def _unseen_change(estimate: MotionEstimate, push: Impulse, change: CentreChange | None) -> list[str]:
    """How far the centre of mass may have moved at the push without a sign, where that matters."""
    first_ns, mass = int(estimate.timestamps_ns[0]), estimate.mass
    start_s, end_s = ((at - first_ns) * 1e-9 for at in (push.start_ns, push.end_ns))
    claimed = np.array(mass.identifiable.com_P)
    if not claimed.any():
        return []
    said = "any change" if change is None else ""
    if change is not None:
        hidden_m = CLEAR_CENTRE * np.sqrt(np.diagonal(mass.R_GP.T @ change.cov_G @ mass.R_GP))[claimed].max()
        stated_m = np.sqrt(np.diagonal(mass.R_GP.T @ np.nan_to_num(mass.cov_com_G, posinf=0.0) @ mass.R_GP))
        if hidden_m < max(CLEAR * float(stated_m[claimed].max()), MATTERS_M):
            return []
        said = f"a centre of mass that moved by up to {1e3 * hidden_m:.2g} mm"
    return [
        "the mass properties are taken as those of one body throughout: if a part left it or moved with the "
        f"push between {start_s:.1f} s and {end_s:.1f} s, {said} would not show in these images"
    ]


def _different_halves(
    tracks: StereoTracks, estimate: MotionEstimate, config: Backend, push: Impulse
) -> list[str] | None:
    """What differs between the frames before and after the push, solved apart; None: not possible."""
    before, after = tracks.timestamps_ns <= push.start_ns, tracks.timestamps_ns >= push.end_ns
    halves = [_solved(tracks, estimate, config, frames) for frames in (before, after)]
    if halves[0] is None or halves[1] is None:
        return None
    return _differences(halves[0], halves[1])


def _other_properties(found: list[str], push: Impulse, first_ns: int) -> str:
    start_s, end_s = ((at - first_ns) * 1e-9 for at in (push.start_ns, push.end_ns))
    return (
        f"after {end_s:.1f} s the target has other mass properties than before {start_s:.1f} s "
        f"({'; '.join(found)}): a part may have left it, or moved; what is stated for the whole sequence is "
        "true of neither"
    )


def _strength(push: Impulse) -> float:
    """Largest change over its sigma."""
    change = np.concatenate([push.delta_v_N, push.delta_w_P])
    return float(np.max(np.abs(change) / np.concatenate([push.sigma_delta_v_N, push.sigma_delta_w_P])))


def _solved(
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
            if _clear(change, sigma, MATTERS_K):
                out.append(f"{name} by {change:+.3f}, sigma {sigma:.3f}")
    if a.identifiable.com and b.identifiable.com:
        change_m = b.com_G - a.com_G
        size = float(np.linalg.norm(change_m))
        along = change_m / max(size, 1e-12)
        sigma = float(np.sqrt(along @ (a.cov_com_G + b.cov_com_G) @ along))
        if _clear(size, sigma, MATTERS_M):
            out.append(f"centre of mass by {1e3 * size:.1f} mm, sigma {1e3 * sigma:.1f} mm")
    if a.identifiable.axes and b.identifiable.axes:
        turn = _between_axes(a.R_GP, b.R_GP)
        size = float(np.linalg.norm(turn))
        along = turn / max(size, 1e-12)
        sigma = float(np.sqrt(along @ (a.cov_R_GP + b.cov_R_GP) @ along))
        if _clear(size, sigma, MATTERS_RAD):
            out.append(f"principal axes by {np.rad2deg(size):.1f} deg, sigma {np.rad2deg(sigma):.1f} deg")
    return out


def _clear(change: float, sigma: float, matters: float) -> bool:
    return abs(change) > max(CLEAR * sigma, matters)


def _between_axes(R_a: Array, R_b: Array) -> Array:
    """Rotation vector (3,) from one triad to the other, up to half-turns."""
    between = R_a.T @ R_b
    return np.asarray(log_so3(between * HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))]))
