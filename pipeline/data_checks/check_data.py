"""All checks of the data, one after the other."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.pipeline.context import RunContext
from polhode.pipeline.data_checks.clock_check import clock_contradictions
from polhode.pipeline.data_checks.connection_check import weak_connections
from polhode.pipeline.data_checks.inspector_check import inspector_contradictions
from polhode.pipeline.data_checks.mass_check import mass_contradictions
from polhode.pipeline.data_checks.rig_check import rig_contradictions
from polhode.pipeline.data_checks.self_calibration import (
    best_correction,
    calibration_limits,
    focal_contradictions,
)
from polhode.records import MotionEstimate, StereoTracks

FROZEN = (
    "all pairs of images are the same, bit for bit: a camera or the recorder stood still, and the motion "
    "found is not the target's (or the images are rendered ones, without noise, of a target at rest)"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Findings:
    """Sentences of the checks."""

    reasons: list[str]
    """To call the answer degraded: something in the data is not as they say"""
    limits: list[str]
    """What these data would not show"""


def check_data(
    context: RunContext, features: Sequence[StereoFeatures], tracks: StereoTracks, estimate: MotionEstimate
) -> Findings:
    """Doubts about the rig, the clock, the poses and the constancy of the target.

    A check that fails does not cost the run.
    """
    seen = np.isin(np.arange(tracks.n_frames), tracks.frame)
    reasons = [FROZEN] if context.sequence.frozen else []
    limits: list[str] = []

    def calibration() -> None:
        found = best_correction(tracks, estimate)
        reasons.extend(focal_contradictions(found))
        limits.extend([] if reasons else calibration_limits(found, tracks, estimate))

    def mass() -> None:
        doubts, unseen = mass_contradictions(tracks, estimate, context.config.backend)
        reasons.extend(doubts)
        limits.extend(unseen)

    checks: tuple[Callable[[], list[str] | None], ...] = (
        lambda: rig_contradictions(context, features, tracks, estimate),
        calibration,
        lambda: clock_contradictions(tracks.time_s, estimate.X_NG[:, :3, :3], seen),
        lambda: inspector_contradictions(tracks.X_NR, estimate.X_NG, seen, tracks.sigma_camera_theta_rad),
        mass,
        lambda: weak_connections(tracks, estimate),
    )
    with context.clock("backend"):
        for check in checks:
            try:
                reasons += check() or []
            except (ArithmeticError, LookupError, ValueError, MemoryError):
                _log.exception("a check of the data failed")
    for reason in reasons:
        _log.warning(reason)
    return Findings(reasons, limits)
