"""What is found about a motion once there is one: the causal estimate, the checks, what it leaves open."""

from collections.abc import Sequence

import numpy as np

from polhode.backend import align_online_estimate, estimate_online, window_warnings
from polhode.frontend.features.stereo import StereoFeatures
from polhode.pipeline.checks.answer_checks.check_answer import check_answer
from polhode.pipeline.checks.data_checks.check_data import Findings, check_data
from polhode.pipeline.context import RunContext
from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.finish_surface import Coloured, Sentences
from polhode.pipeline.intervals.find_intervals import find_intervals
from polhode.pipeline.runner import stage
from polhode.pipeline.stream_results import Streamed
from polhode.records.estimate import OnlineEstimate
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Check, Coverage, Intervals


@stage("backend", ["backend.for_window"])
def causal_estimate(
    context: RunContext, motion: MotionSolution, streamed: Streamed | None
) -> OnlineEstimate | None:
    """The estimate as each frame came, in the frames of the final one: the stream's, if there was one."""
    # as each frame came, what all of them say of the calibration was not known
    tracks, estimate, config = motion.measured or motion.tracks, motion.estimate, context.config.backend
    if streamed is not None and np.array_equal(streamed.timestamps_ns, estimate.timestamps_ns):
        return align_online_estimate(streamed.online, estimate)
    if not config.window.enabled:
        return None
    return align_online_estimate(estimate_online(tracks, config, progress=context.progress), estimate)


@stage("checks", ["backend"], is_stored=False)
def data_checks(context: RunContext, features: Sequence[StereoFeatures], motion: MotionSolution) -> Findings:
    """Doubts about the data. features: of the first method, of each frame."""
    return check_data(context, features, motion.tracks, motion.estimate, motion.links)


@stage("checks", is_stored=False)
def answer_checks(context: RunContext, motion: MotionSolution) -> list[Check]:
    """Doubts about the motion, from its measurements alone."""
    del context
    return check_answer(motion.tracks, motion.estimate, motion.links)


@stage("fusion", ["backend"], is_stored=False)
def motion_intervals(
    context: RunContext,
    motion: MotionSolution,
    coloured: Coloured,
    covered: tuple[Coverage | None, Sentences],
) -> tuple[Intervals | None, list[str]]:
    """The intervals of what the motion does not determine, and warnings."""
    return find_intervals(motion.estimate, coloured.surface, covered[0], context.config.backend)


@stage("checks", is_stored=False)
def all_checks(context: RunContext, turning: Check, doubts: list[Check], data: Findings) -> list[Check]:
    """Of images, answer and data."""
    del context
    return [turning, *doubts, *data.checks]


@stage("checks", ["backend"], is_stored=False)
def all_warnings(
    context: RunContext,
    streamed: Streamed | None,
    answer: MotionSolution,
    fused: SurfaceModel,
    data: Findings,
    intervals: tuple[Intervals | None, list[str]],
) -> list[str]:
    """What a user should know of the run, beside the doubts. answer: of all frames."""
    warnings = [*(streamed.warnings if streamed is not None else ()), *context.sequence.warnings]
    warnings += window_warnings(answer.tracks.n_frames, context.config.backend)
    return [*warnings, *fused.warnings, *data.limits, *intervals[1]]
