"""All checks of the answer by its measurements (docs/checks.md), and those that compare it with one thing.

- Relative poses of frame pairs, each found by RANSAC among the matches of two frames, without the others.
  Where landmarks that do not belong to the motion outnumber the rest in some pairs, as the skin that turns
  under a still outline, these pairs keep their own opinion.
- The mirror twin: a body whose relief is turned inside out, front to back, and turns the other way looks the
  same to one camera from afar. Disparities alone tell the two apart. With the relief of the landmarks in each
  frame reversed, all disparities change by twice their distance from the frame's mean; the root of the sum of
  squares, in their noise, is how far away the twin is.
- A force in one direction, at any time within an interval, displaces a body by at most half of the change of
  velocity times the interval, beside the mean of the velocities before and after it. What displaces it
  further is no push: a camera or the inspector's pose that jumped, or another point of the body that is taken
  for its centre of mass from then on.
- The causal estimate at the last frame, where it knows all measurements as well; the sliding window has
  linearized the older ones early, and has found its own outliers.
- The centre of the volume. A uniform density is an assumption, so small differences mean nothing; but a
  centre of mass that is farther from it than the body is large belongs to another motion.
"""

import numpy as np
import trimesh

from polhode.config.backend_settings import Backend
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Array, inverse_pose
from polhode.pipeline.checks.answer_checks.image_motion import model_check
from polhode.pipeline.checks.answer_checks.part_solutions import part_checks
from polhode.pipeline.checks.answer_checks.residual_checks import (
    agreeing_residuals,
    residual_checks,
    sun_check,
)
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import Impulse, MotionEstimate, OnlineEstimate
from polhode.records.metrics import angle_deg
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.check_table import CHECK_TABLE, attempt_checks, make_check
from polhode.run_directory.summary_schema import SAME_MINIMUM, Check, Physics


def check_answer(
    tracks: StereoTracks,
    estimate: MotionEstimate,
    links: RelativePoses,
    config: Backend,
    online: OnlineEstimate | None,
    sun_N: Array | None,
) -> list[Check]:
    """Doubts about the motion found, from its measurements alone.

    ``online``: the causal estimate, None: there is none; sun_N (3,): unit vector towards the Sun, None:
    unknown.
    """
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    return [
        *attempt_checks(lambda: part_checks(tracks, estimate, config)),
        *attempt_checks(lambda: residual_checks(tracks, estimate)),
        *attempt_checks(lambda: [sun_check(tracks, estimate, sun_N)]),
        *attempt_checks(lambda: [link_check(links, X_RG)]),
        *attempt_checks(lambda: [mirror_check(tracks, estimate), runner_up_check(estimate)]),
        *attempt_checks(lambda: [push_check(estimate)]),
        *attempt_checks(lambda: [window_check(online, estimate)]),
    ]


def with_sun_check(
    doubts: list[Check], tracks: StereoTracks, estimate: MotionEstimate, sun_N: Array | None
) -> list[Check]:
    """The doubts with the check against the Sun made again, now that its direction is known."""
    if sun_N is None:
        return doubts
    (check,) = attempt_checks(lambda: [sun_check(tracks, estimate, sun_N)])
    return [check if each.name == CHECK_TABLE["sun"].name else each for each in doubts]


def check_surface(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    physics: Physics | None,
    sun_N: Array | None,
) -> list[Check]:
    """Doubts about the motion found, from the surface that it gives; as ``check_answer``."""
    return [
        *attempt_checks(lambda: [mesh_check(physics)]),
        *attempt_checks(lambda: [model_check(sequence, rectifier, tracks, estimate, mesh, sun_N)]),
    ]


def link_check(links: RelativePoses, X_RG: Array) -> Check:
    """Share of the links that contradict the motion; X_RG (F, 4, 4): the target in the camera, as found.

    Below 5 deg, few inliers on one side of the body explain a difference.
    """
    if len(links.i) < 20:
        return make_check("links", None)
    moved = X_RG[links.i] @ inverse_pose(X_RG[links.j])
    difference_deg = angle_deg(np.swapaxes(moved[:, :3, :3], 1, 2) @ links.X_RiRj[:, :3, :3])
    return make_check("links", 100.0 * float(np.mean(difference_deg > 5.0)))


def mirror_check(tracks: StereoTracks, estimate: MotionEstimate) -> Check:
    """Distance of the mirror twin, of the median frame."""
    found = agreeing_residuals(tracks, estimate)
    if not len(found.frame):
        return make_check("mirror", None)
    disparity, count = found.uvd_px[:, 2], np.bincount(found.frame)
    mean = np.bincount(found.frame, disparity) / np.maximum(count, 1)
    change = 2.0 * (disparity - mean[found.frame]) / max(estimate.noise.disparity_sigma_px, 1e-9)
    distance = np.sqrt(np.bincount(found.frame, change**2)[count > 2])
    return make_check("mirror", float(np.median(distance)) if len(distance) else None)


def runner_up_check(estimate: MotionEstimate) -> Check:
    """The least cost of a start that ended in another minimum, above the best one's."""
    others = [cost for cost in estimate.solver.runner_up.values() if cost > SAME_MINIMUM]
    return make_check("runner-up", min(others, default=None))


def push_check(estimate: MotionEstimate) -> Check:
    """The largest excess over what a push can do, in its standard deviations; not possible without pushes."""
    stamps, last = estimate.timestamps_ns, len(estimate.timestamps_ns) - 1
    found: list[tuple[float, float, Impulse]] = []
    for push in estimate.disturbances.impulses if estimate.disturbances is not None else ():
        a, b = (min(int(np.searchsorted(stamps, at)), last) for at in (push.start_ns, push.end_ns))
        seconds = 1e-9 * float(stamps[b] - stamps[a])
        mean_v, change_v = 0.5 * (estimate.v_N[a] + estimate.v_N[b]), estimate.v_N[b] - estimate.v_N[a]
        displacement = estimate.r_N[b] - estimate.r_N[a] - seconds * mean_v
        length = float(np.linalg.norm(displacement))
        P_a, P_b = estimate.covariance[a], estimate.covariance[b]
        covariance = P_a[:3, :3] + P_b[:3, :3] + 0.25 * seconds**2 * (P_a[3:6, 3:6] + P_b[3:6, 3:6])
        if np.isfinite(covariance).all() and length > 0.0:
            along = displacement / length
            excess_m = length - 0.5 * float(np.linalg.norm(change_v)) * seconds
            found.append((excess_m / float(np.sqrt(along @ covariance @ along)), excess_m, push))
    if not found:
        return make_check("push", None)
    sigmas, excess_m, push = max(found, key=lambda each: each[0])
    start_s, end_s = (1e-9 * (at - int(stamps[0])) for at in (push.start_ns, push.end_ns))
    facts = {"start_s": start_s, "end_s": end_s, "excess_mm": 1e3 * excess_m, "sigmas": sigmas}
    return make_check("push", max(sigmas, 0.0), **facts)


def window_check(online: OnlineEstimate | None, estimate: MotionEstimate) -> Check:
    """The worst component of position, velocity and rate of the last frame; None: no window.

    In the larger of both standard deviations: those of the window take the errors of features as independent.
    """
    if online is None:
        return make_check("window", None)
    names, rows = ("r_N", "v_N", "w_P"), np.r_[0:6, 9:12]
    difference = np.concatenate([getattr(online, x)[-1] - getattr(estimate, x)[-1] for x in names])
    own, smoothed = (np.diagonal(each.covariance[-1])[rows] for each in (online, estimate))
    known = np.isfinite(own) & np.isfinite(smoothed) & (own > 0.0)
    if not known.any():
        return make_check("window", None)
    sigma = np.sqrt(np.maximum(own, smoothed)[known])
    return make_check("window", float(np.max(np.abs(difference[known]) / sigma)))


def mesh_check(physics: Physics | None) -> Check:
    """Offset of the centre of mass from that of uniform density, of the components that are determined.

    Less three of its standard deviations, over the edge of a cube of the same volume [%].
    """
    if physics is None or physics.com_offset_G is None or physics.com_offset_sigma_m is None:
        return make_check("centre of volume", None)
    size_m, offset_m = float(np.cbrt(physics.volume_m3)), float(np.linalg.norm(physics.com_offset_G))
    certain_m = max(offset_m - 3.0 * physics.com_offset_sigma_m, 0.0)
    facts = {"offset_mm": 1e3 * offset_m, "size_mm": 1e3 * size_m}
    return make_check("centre of volume", 100.0 * certain_m / size_m, **facts)
