"""All checks of the data, one after the other."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.pipeline.context import RunContext
from polhode.pipeline.data_checks.clock_check import clock_check
from polhode.pipeline.data_checks.connection_check import connection_check
from polhode.pipeline.data_checks.inspector_check import inspector_check
from polhode.pipeline.data_checks.mask_check import mask_checks
from polhode.pipeline.data_checks.mass_check import mass_checks
from polhode.pipeline.data_checks.rig_check import rig_checks
from polhode.pipeline.data_checks.self_calibration import (
    best_correction,
    calibration_limits,
    focal_check,
)
from polhode.pipeline.data_checks.swing_check import swing_check
from polhode.pipeline.run_directory.summary_schema import Check, not_made, reasons_of
from polhode.records import MotionEstimate, StereoTracks

FROZEN = (
    "all pairs of images are the same, bit for bit: a camera or the recorder stood still, and the motion "
    "found is not the target's (or the images are rendered ones, without noise, of a target at rest)"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Findings:
    """What the checks found."""

    checks: list[Check]
    """A reason of one means that something in the data is not as they say"""
    limits: list[str]
    """What these data would not show, a sentence each"""

    @property
    def reasons(self) -> list[str]:
        """Why the answer is doubted."""
        return reasons_of(self.checks)


def check_data(
    context: RunContext, features: Sequence[StereoFeatures], tracks: StereoTracks, estimate: MotionEstimate
) -> Findings:
    """Doubts about the rig, the clock, the poses and the constancy of the target.

    An error in a check does not cost the run, which is doubted for it.
    """
    seen = np.isin(np.arange(tracks.n_frames), tracks.frame)
    found = Findings([_frozen(context.sequence.frozen)], [])

    def calibration() -> list[Check]:
        correction = best_correction(tracks, estimate)
        has_ranges = context.sequence.has_ranges
        check = focal_check(correction, has_ranges)
        # with ranges, a wrong focal length moves nothing along the line of sight
        doubted = has_ranges or found.reasons or check.reason
        found.limits.extend([] if doubted else calibration_limits(correction, tracks, estimate))
        return [check]

    def mass() -> list[Check]:
        checks, unseen = mass_checks(tracks, estimate, context.config.backend)
        found.limits.extend(unseen)
        return checks

    X_NR, sigma_rad = tracks.X_NR, tracks.sigma_camera_theta_rad
    steps: tuple[Callable[[], list[Check]], ...] = (
        lambda: rig_checks(context, features, tracks, estimate),
        calibration,
        lambda: [clock_check(tracks.time_s, estimate.X_NG[:, :3, :3], seen)],
        lambda: [inspector_check(X_NR, estimate.X_NG, seen, sigma_rad)],
        lambda: [swing_check(tracks, estimate, context.config.backend)],
        mass,
        lambda: [connection_check(tracks, estimate)],
        lambda: mask_checks(context.rectifier.found),
    )
    for step in steps:
        try:
            found.checks.extend(step())
        except (ArithmeticError, LookupError, ValueError, MemoryError) as error:
            _log.debug("a check of the data ended with an error", exc_info=True)
            found.checks.append(not_made(error))
    for reason in found.reasons:
        _log.warning(reason)
    return found


def _frozen(frozen: bool) -> Check:
    return Check(
        name="images that are all the same", value=float(frozen), limit=0.0, reason=FROZEN if frozen else ""
    )
