"""All checks of the data, one after the other."""

import logging
from collections.abc import Callable, Sequence

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.pipeline.context import RunContext
from polhode.pipeline.data_checks.clock_check import clock_contradictions
from polhode.pipeline.data_checks.inspector_check import inspector_contradictions
from polhode.pipeline.data_checks.mass_check import mass_contradictions
from polhode.pipeline.data_checks.rig_check import rig_contradictions
from polhode.records import MotionEstimate, StereoTracks

_log = logging.getLogger(__name__)


def contradictions(
    context: RunContext, features: Sequence[StereoFeatures], tracks: StereoTracks, estimate: MotionEstimate
) -> list[str]:
    """Reasons to doubt the rig, the clock, the poses or the constancy of the target, one sentence each.

    A check that fails does not cost the run.
    """
    seen = np.isin(np.arange(tracks.n_frames), tracks.frame)
    checks: tuple[Callable[[], list[str]], ...] = (
        lambda: rig_contradictions(context, features, tracks, estimate),
        lambda: clock_contradictions(tracks.time_s, estimate.X_NG[:, :3, :3], seen),
        lambda: inspector_contradictions(tracks.X_NR, estimate.X_NG, seen, tracks.sigma_camera_theta_rad),
        lambda: mass_contradictions(tracks, estimate, context.config.backend),
    )
    reasons: list[str] = []
    with context.clock("backend"):
        for check in checks:
            try:
                reasons += check()
            except (ArithmeticError, LookupError, ValueError, MemoryError):
                _log.exception("a check of the data failed")
    for reason in reasons:
        _log.warning(reason)
    return reasons
