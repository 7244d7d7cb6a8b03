"""All checks of the data, one after the other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.frontend.background.find_masks import doubtful_frames
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.found_masks import FoundMasks
from polhode.pipeline.checks.data_checks.mass_check import mass_checks
from polhode.pipeline.checks.data_checks.pose_checks import (
    clock_check,
    connection_check,
    inspector_check,
    swing_check,
)
from polhode.pipeline.checks.data_checks.rig_check import rig_checks
from polhode.pipeline.checks.data_checks.self_calibration import focal_check
from polhode.pipeline.context import RunContext, doubts_of_masks
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.check_table import attempt_checks, make_check
from polhode.run_directory.summary_schema import Check


@dataclass(frozen=True)
class Findings:
    """What the checks found."""

    checks: list[Check]
    """A reason of one means that something in the data is not as they say"""
    limits: list[str]
    """What these data would not show, a sentence each"""


def check_data(
    context: RunContext,
    features: Sequence[StereoFeatures],
    tracks: StereoTracks,
    estimate: MotionEstimate,
    links: RelativePoses | None = None,
) -> Findings:
    """Doubts about the rig, the clock, the poses and the constancy of the target."""
    seen = np.isin(np.arange(tracks.n_frames), tracks.frame)
    config = context.config.backend
    X_NR, X_NG, limits = tracks.X_NR, estimate.X_NG, list[str]()
    checks = attempt_checks(lambda: [make_check("identical images", float(context.sequence.frozen))])

    def calibration() -> list[Check]:
        return [focal_check(estimate, context.sequence.has_ranges)]

    def mass() -> list[Check]:
        found, unseen = mass_checks(tracks, estimate, config)
        limits.extend(unseen)
        return found

    for step in (
        lambda: rig_checks(context, features, tracks, estimate),
        calibration,
        lambda: [clock_check(tracks.time_s, X_NG[:, :3, :3], seen)],
        lambda: [inspector_check(X_NR, X_NG, seen, tracks.sigma_camera_theta_rad)],
        lambda: [swing_check(tracks, estimate, config)],
        mass,
        lambda: [connection_check(tracks, estimate, links)],
        lambda: mask_checks(context.rectifier.found),
    ):
        checks.extend(attempt_checks(step))
    return Findings(checks, limits)


def mask_checks(found: FoundMasks | None) -> list[Check]:
    """Of the masks that were found before a background that is not dark; none where none had to be found."""
    if found is None:
        return []
    share = 100.0 * (len(doubtful_frames(found)) / max(len(found.quality), 1))
    return [make_check("doubtful masks", share, doubts=doubts_of_masks(found))]
