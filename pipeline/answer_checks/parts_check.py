"""Whether parts of the measurements, solved apart, give the same motion within their standard deviations.

- Forward prediction: the first part of the sequence, continued by the dynamics, against the whole. A wrong
  inertia, a wrong clock, a push or a change of the body bends the rest away from the prediction.
- Halves: two disjoint sets of landmarks, chosen at random. Errors that each landmark has by itself scatter as
  the sigmas say, or more.
- Outline and interior: landmarks near the outline of what is seen of them, and the others. Outlines and
  rings of a body of revolution that stand still, errors of depth at oblique surfaces and a wrong calibration
  move the two apart.

What all landmarks share, as a shift of the whole target, none of them shows.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from polhode.backend.part import estimate_part
from polhode.config.backend_settings import Backend
from polhode.pipeline.answer_checks.agreement import disagreements, largest
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Bools, Ints, MotionEstimate, StereoTracks

FIRST_PART = 0.7
"""Of the observations, in time"""
MAX_FRAMES = 120
"""Longer sequences are thinned out to this number."""
MAX_PREDICTION, MAX_HALVES, MAX_OUTLINE = 3.0, 3.0, 3.5
"""[sigma] Above these the answer is doubted (docs/checks.md)."""
MIN_HULL = 8
"""Landmarks of a frame whose outline counts"""


@dataclass(frozen=True)
class Whole:
    """The measurements, the estimate of all of them, and the frames of the parts' states."""

    tracks: StereoTracks
    estimate: MotionEstimate
    config: Backend
    frames: Ints

    def part(self, rows: Bools) -> MotionEstimate | None:
        """The estimate of some observations (M,); None: there is none."""
        return estimate_part(self.tracks, self.estimate, self.config, rows, self.frames)


def parts_checks(tracks: StereoTracks, estimate: MotionEstimate, config: Backend) -> list[Check]:
    """Forward prediction, halves, outline and interior."""
    step = -(-tracks.n_frames // MAX_FRAMES)
    whole = Whole(tracks, estimate, config, np.arange(0, tracks.n_frames, step))
    return [_prediction(whole), _halves(whole), _outline(whole)]


def _prediction(whole: Whole) -> Check:
    check = Check(
        name="prediction from the first part, against the whole", limit=MAX_PREDICTION, unit="sigma"
    )
    tracks, last = whole.tracks, len(whole.frames) - 1
    until = int(np.quantile(tracks.frame, FIRST_PART)) if len(tracks.frame) else 0
    first, all_of_it = (whole.part(tracks.frame <= end) for end in (until, tracks.n_frames))
    if first is None or all_of_it is None:
        return check
    found = largest(disagreements(first, all_of_it, np.array([last]), contained=True))
    if found is None:
        return check
    return check.judged(
        found.sigmas,
        f"the motion up to {tracks.time_s[until]:g} s predicts another {found.quantity} at the end than all "
        f"measurements give ({found.sigmas:.1f} sigma): the target may not be one body that moves freely, or "
        "the clock, the poses or the associations are wrong",
    )


def _halves(whole: Whole) -> Check:
    check = Check(name="halves of the landmarks, solved apart", limit=MAX_HALVES, unit="sigma")
    chosen = np.random.default_rng(0).permutation(whole.tracks.n_landmarks) % 2 == 0
    rows = chosen[whole.tracks.landmark]
    return _apart(check, whole, rows, ~rows, "two halves of the landmarks, chosen at random,", "")


def _outline(whole: Whole) -> Check:
    check = Check(name="landmarks of the outline and of the interior", limit=MAX_OUTLINE, unit="sigma")
    return _apart(
        check,
        whole,
        *outline_and_interior(whole.tracks, whole.estimate),
        "landmarks near the outline and those of the interior, solved apart,",
        "; outlines that stand still on a turning target, depth at oblique surfaces or the calibration may "
        "be the cause",
    )


def _apart(check: Check, whole: Whole, a: Bools, b: Bools, who: str, cause: str) -> Check:
    """Whether two sets of observations (M,) agree."""
    first, second = whole.part(a), whole.part(b)
    if first is None or second is None:
        return check
    found = largest(disagreements(first, second, np.arange(len(whole.frames)), contained=False))
    if found is None:
        return check
    return check.judged(
        found.sigmas,
        f"{who} give another {found.quantity} ({found.sigmas:.1f} sigma of the difference): the standard "
        "deviations are too small by about this factor, or some landmarks are not fixed to the target"
        + cause,
    )


def outline_and_interior(tracks: StereoTracks, estimate: MotionEstimate) -> tuple[Bools, Bools]:
    """Observations (M,) of the landmarks that are nearer to the outline, and of the others.

    The outline of a frame is the convex hull of its landmarks in the image; the distance from it, over the
    radius of a disc of its area, is averaged over a landmark's frames.
    """
    good = estimate.inlier_weight > 0.0
    distance = np.full(len(tracks.frame), np.nan)
    order = np.argsort(tracks.frame, kind="stable")
    bounds = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1))
    for k in range(tracks.n_frames):
        own = order[bounds[k] : bounds[k + 1]]
        own = own[good[own]]
        if len(own) < MIN_HULL:
            continue
        uv = tracks.uvd_px[own, :2]
        try:
            hull = ConvexHull(uv)
        except QhullError:
            continue
        inwards = -np.max(hull.equations[:, :2] @ uv.T + hull.equations[:, 2:], axis=0)
        # of a plane hull, Qhull's volume is the area
        distance[own] = inwards / max(float(np.sqrt(hull.volume / np.pi)), 1.0)
    known = np.isfinite(distance)
    count = np.bincount(tracks.landmark[known], minlength=tracks.n_landmarks)
    mean = np.bincount(tracks.landmark[known], distance[known], tracks.n_landmarks) / np.maximum(count, 1)
    of_landmark = mean[tracks.landmark]
    outer = known & (of_landmark <= np.median(of_landmark[known])) if known.any() else known
    return outer, known & ~outer
