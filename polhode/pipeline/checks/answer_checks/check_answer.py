"""The checks of the answer by its measurements (docs/checks.md).

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
"""

import numpy as np

from polhode.geometry.lie import Array, inverse_pose
from polhode.pipeline.checks.data_checks.pose_checks import AGREES_DEG, contradicted_deg
from polhode.records.estimate import Impulse, MotionEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.check_table import attempt_checks, make_check
from polhode.run_directory.summary_schema import Check

FULL_WEIGHT = 0.1
"""Observations with less weight contradict the motion."""


def check_answer(tracks: StereoTracks, estimate: MotionEstimate, links: RelativePoses) -> list[Check]:
    """Doubts about the motion found, from its measurements alone."""
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    return [
        *attempt_checks(lambda: [link_check(links, X_RG)]),
        *attempt_checks(lambda: [mirror_check(tracks, estimate)]),
        *attempt_checks(lambda: [push_check(estimate)]),
    ]


def link_check(links: RelativePoses, X_RG: Array) -> Check:
    """Share of the links that contradict the motion; X_RG (F, 4, 4): the target in the camera, as found."""
    if len(links.i) < 20:
        return make_check("links", None)
    return make_check("links", 100.0 * float(np.mean(contradicted_deg(links, X_RG) > AGREES_DEG)))


def mirror_check(tracks: StereoTracks, estimate: MotionEstimate) -> Check:
    """Distance of the mirror twin, of the median frame."""
    agrees = estimate.inlier_weight > FULL_WEIGHT
    frame = tracks.frame[agrees]
    if not len(frame):
        return make_check("mirror", None)
    disparity, count = (tracks.uvd_px - estimate.residuals_px)[agrees, 2], np.bincount(frame)
    mean = np.bincount(frame, disparity) / np.maximum(count, 1)
    change = 2.0 * (disparity - mean[frame]) / max(estimate.noise.disparity_sigma_px, 1e-9)
    distance = np.sqrt(np.bincount(frame, change**2)[count > 2])
    return make_check("mirror", float(np.median(distance)) if len(distance) else None)


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
