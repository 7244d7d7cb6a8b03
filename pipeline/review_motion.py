"""What is found about a motion from its measurements alone: the causal estimate, and the checks.

Nothing of it waits for the surface, nor the surface for it: ``run`` has it done by another process.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from polhode.backend import align_online_estimate, estimate_online
from polhode.frontend.features.stereo import StereoFeatures
from polhode.pipeline.answer_checks.check_answer import check_answer
from polhode.pipeline.context import RunContext
from polhode.pipeline.data_checks.check_data import Findings, check_data
from polhode.pipeline.run_directory import outputs
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import MotionEstimate, OnlineEstimate, RelativePoses, StereoTracks
from polhode.threads import single_threaded


@dataclass(frozen=True)
class MotionToReview:
    """A motion with what it was found from."""

    context: RunContext
    folder: Path | None
    """Where the causal estimate is written; None: it is there already, of more frames than these"""
    features: Sequence[StereoFeatures]
    tracks: StereoTracks
    estimate: MotionEstimate
    links: RelativePoses
    online: OnlineEstimate | None
    """The causal estimate of a stream, in the frames of the final one; None: there was no stream"""


@dataclass(frozen=True)
class MotionReview:
    """What was found."""

    findings: Findings
    doubts: list[Check]
    """Of the answer; the check against the Sun comes with its direction"""
    seconds: dict[str, float]
    """By stage"""


@single_threaded
def review_motion(given: MotionToReview) -> MotionReview:
    """The causal estimate as a file, then the checks of the data and of the answer."""
    context, tracks, estimate = given.context, given.tracks, given.estimate
    config, online = context.config.backend, given.online
    if online is None and config.window.enabled:
        with context.clock("backend"):
            found = context.stages.once(estimate_online, tracks, config.for_window, progress=context.progress)
            online = align_online_estimate(found, estimate)
    if online is not None and given.folder is not None:
        outputs.write_online_estimate(given.folder, online)
    findings = check_data(context, given.features, tracks, estimate)
    with context.clock("checks"):
        doubts = check_answer(tracks, estimate, given.links, config, online, None)
    return MotionReview(findings, doubts, context.clock.seconds)
