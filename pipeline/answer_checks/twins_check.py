"""Other solutions that might explain the data as well: the runner-up of the starts, the mirror twin.

- The runner-up: the back end starts from several inertias; another that ends elsewhere with nearly the same
  cost would be an ambiguity. Those that matter it states in the sigmas (``backend/uncertainty/ambiguity``);
  the distance is information: right and wrong runs do not differ by it.
- The mirror twin: a body whose relief is turned inside out, front to back, and turns the other way looks the
  same to one camera from afar. Disparities alone tell the two apart. With the relief of the landmarks in each
  frame reversed, all disparities change by twice their distance from the frame's mean; the root of the sum of
  squares, in their noise, is how far away the twin is.

A half-turn about a principal axis leaves the same motion (a symmetry of the answer); of parts of the sequence
against each other it is excluded by the landmarks that connect them (``data_checks/connection_check``).
"""

import numpy as np

from polhode.pipeline.answer_checks.residual_check import agreeing_residuals
from polhode.pipeline.run_directory.summary_schema import SAME_MINIMUM, Check
from polhode.records import MotionEstimate, StereoTracks

MIN_MIRROR = 12.0
"""[sigma] of a frame; undisturbed runs have 90 or more."""


def twins_checks(tracks: StereoTracks, estimate: MotionEstimate) -> list[Check]:
    """The mirror twin, and the runner-up."""
    return [_mirror(tracks, estimate), _runner_up(estimate)]


def _mirror(tracks: StereoTracks, estimate: MotionEstimate) -> Check:
    check = Check(
        name="distance of the mirror twin, by the relief", limit=MIN_MIRROR, unit="sigma", at_least=True
    )
    found = agreeing_residuals(tracks, estimate)
    if not len(found.frame):
        return check
    disparity = found.uvd_px[:, 2]
    count = np.bincount(found.frame)
    mean = np.bincount(found.frame, disparity) / np.maximum(count, 1)
    change = 2.0 * (disparity - mean[found.frame]) / max(estimate.noise.disparity_sigma_px, 1e-9)
    distance = np.sqrt(np.bincount(found.frame, change**2)[count > 2])
    if not len(distance):
        return check
    size = float(np.median(distance))
    return check.judged(
        size,
        f"the relief of the target hardly shows in the disparities ({size:.0f} sigma a frame): the same body "
        "turned inside out, rotating the other way, would fit these images almost as well; come closer or "
        "use a longer baseline",
    )


def _runner_up(estimate: MotionEstimate) -> Check:
    """The least cost of a start that ended in another minimum, above the best one's."""
    check = Check(name="cost of the runner-up among the starts, above the best", limit=None)
    others = [cost for cost in estimate.solver.runner_up.values() if cost > SAME_MINIMUM]
    return check if not others else check.judged(min(others), "")
