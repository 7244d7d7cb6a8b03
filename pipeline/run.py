"""The main job, as the data flows: images, tracks, first motion, motion, window, depth, fusion, report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from polhode.backend import align_online_estimate, window_warnings
from polhode.config import Config
from polhode.frontend.features.stereo import StereoFeatures
from polhode.lie import Array
from polhode.mapping.fusion.field import choose_device
from polhode.pipeline.answer_checks.check_answer import check_surface, with_sun_check
from polhode.pipeline.answer_checks.image_motion import ImageMotion
from polhode.pipeline.build_surface import build_surface, finish_fused
from polhode.pipeline.checkout.checkout import warn_before_run
from polhode.pipeline.context import RunContext, open_context
from polhode.pipeline.correspondences import match_frames
from polhode.pipeline.depth_maps import DepthMaps
from polhode.pipeline.find_motion import find_motion, pose_RG
from polhode.pipeline.intervals.find_intervals import find_intervals
from polhode.pipeline.long_sequence import LongSolution, is_long, solve_long
from polhode.pipeline.pictures import PicturesToMake
from polhode.pipeline.report import finish_run, write_report
from polhode.pipeline.review_motion import MotionToReview, review_motion
from polhode.pipeline.run_directory import outputs
from polhode.pipeline.run_directory.archives import write_measurements
from polhode.pipeline.run_directory.recording import recording_of
from polhode.pipeline.run_directory.run_folder import RunFolder, atomic_run_folder
from polhode.pipeline.run_directory.summary import build_summary
from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.pipeline.streamed import Streamed
from polhode.processes import beside
from polhode.progress import Progress
from polhode.records import MotionEstimate, OnlineEstimate, RelativePoses, SurfaceModel
from polhode.threads import single_threaded

NO_LINKS = RelativePoses(
    np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4)), np.zeros(0, dtype=np.int64)
)
"""Of a long sequence, whose frames are connected by the tracks of a stream"""


@dataclass(frozen=True)
class RunResult:
    """What the command line reports at the end."""

    status: Literal["ok", "degraded", "failed"]
    report_path: Path
    """The page; the folder of the run where there is none"""
    sentence: str
    failure: str | None = None
    """Why the status is "failed"; everything that was found is in the run directory all the same"""
    note: str = ""
    """What the user should know about the place of the run"""


@single_threaded
def run(
    config: Config,
    sequence_folder: Path,
    run_folder: Path,
    progress: Progress,
    overwrite: bool = False,
    even_if_failed: bool = False,
    streamed: Streamed | None = None,
    resume: bool = False,
) -> RunResult:
    """A stereo sequence on disk to a run directory (docs/run_directory.md).

    ``overwrite`` replaces an existing run; a failed run only a failed one, unless ``even_if_failed``.
    ``streamed``: what a stream of these pairs has found already. ``resume``: stages that an earlier run has
    finished there are not computed again, and that run is replaced.

    Raises InputError for bad input and then writes nothing; RunFailure when no consistent motion is found,
    and then the run directory contains what was found before.
    """
    with atomic_run_folder(run_folder, overwrite, write_report, even_if_failed, resume) as written:
        finished = fill_run_folder(written, config, sequence_folder, progress, streamed)
    return finished(written)


@single_threaded
def fill_run_folder(
    written: RunFolder,
    config: Config,
    sequence_folder: Path,
    progress: Progress,
    streamed: Streamed | None = None,
) -> Callable[[RunFolder], RunResult]:
    """The whole run, into a folder that is open. Returns what makes its result once it is published."""
    folder = written.path
    choose_device(config.mapping)  # a missing GPU is an error before anything is computed
    context = open_context(sequence_folder, config, progress)
    clock = context.clock
    written.recording = recording_of(context.sequence)
    context = replace(context, stages=written.open_stages(sequence_folder, config.runtime))
    outputs.write_config(folder, config)
    warn_before_run(context.sequence, context.rectifier)
    if streamed is not None:
        # In its own frame G until the motion is found, should that fail.
        outputs.write_online_estimate(folder, streamed.online)

    long: LongSolution | None = None
    online: OnlineEstimate | None
    if is_long(context):
        long = solve_long(context, streamed)
        # What follows sees the key frames only; what the run says of all frames is written now.
        context, features, links = long.context, long.features, NO_LINKS
        tracks, estimate = long.tracks, long.estimate
        long.write(folder)
        depth, online = _depth_maps(context, features, None), long.key_online
    else:
        correspondences = match_frames(context, streamed)
        features, links = correspondences.features, correspondences.links
        write_measurements(correspondences.tracks(context), folder / "measurements.npz", links)

        depth = _depth_maps(context, features, streamed)
        with depth.made_beside():
            for solution in find_motion(context, correspondences):
                # Each solution is written, so that it is kept should a later step fail.
                outputs.write_estimate(folder, solution.tracks, solution.estimate, solution.links)
        tracks, estimate, links = solution.tracks, solution.estimate, solution.links
        online = _online_of_stream(estimate, streamed)
    aside = context.for_another_process()
    with beside(context.workers) as start:
        reviewed = start(
            review_motion,
            MotionToReview(
                aside, folder if long is None else None, features, tracks, estimate, links, online
            ),
        )
        made: list[Callable[[], float]] = []

        def ready(finished: SurfaceModel, sun_N: Array | None) -> None:
            pictures = PicturesToMake(aside, folder, tracks, estimate, finished, sun_N)
            made.append(start(PicturesToMake.make, pictures))

        images = ImageMotion(
            context.rig, pose_RG(tracks, estimate), np.isin(np.arange(tracks.n_frames), tracks.frame)
        )
        fused = build_surface(context, depth, tracks, estimate, images)
        with clock("fusion"):
            finished = finish_fused(context, fused, tracks, estimate, ready)
            surface, shape = finished.surface, finished.findings
            sun = shape.mesh.sun if shape.mesh is not None else None
            sun_N = None if sun is None or sun.sigma_deg is None else np.array(sun.direction_N)
            if not made:
                ready(surface, sun_N)
            intervals, unbounded = find_intervals(estimate, surface, shape.coverage, config.backend)
        outputs.write_surface(folder, surface, finished.levels)

        with clock("checks"):
            doubts = images.checks(float(np.median(np.diff(tracks.time_s))))
            shown = context.sequence, context.rectifier
            of_surface = check_surface(*shown, tracks, estimate, surface.mesh, shape.physics, sun_N)
        # the images were compared while the depth maps passed to the fusion
        clock.seconds["checks"] += images.seconds
        clock.seconds["fusion"] -= images.seconds
        with context.progress.stage("checks and pictures", 1 + len(made)) as advance:
            review = reviewed()
            advance()
            doubts += [*with_sun_check(review.doubts, tracks, estimate, sun_N), *of_surface]
            for seconds in made:
                clock.add({"report": seconds()})
                advance()
        clock.add(review.seconds)
    clock.add_total()
    warnings = [*(streamed.warnings if streamed is not None else ()), *context.sequence.warnings]
    if long is not None:
        tracks, estimate = long.all_tracks, long.all_frames
    warnings += window_warnings(tracks.n_frames, config.backend)
    warnings += [*fused.warnings, *review.findings.limits, *unbounded]
    checks = [*doubts, *review.findings.checks]
    summary = build_summary(
        *(tracks, estimate, surface, clock.seconds, warnings),
        shape=shape,
        checks=checks,
        intervals=intervals,
    )
    summary = summary.model_copy(update={"data": written.recording})
    with progress.stage("report", 1) as advance:
        summary = finish_run(folder, summary)
        advance()
    failure = summary.warnings[0] if summary.status == "failed" else None
    return partial(_result, summary, _sentence(summary, estimate), failure)


def _result(summary: Summary, sentence: str, failure: str | None, written: RunFolder) -> RunResult:
    report = written.published / "report.html"
    report = report if report.is_file() else written.published
    return RunResult(summary.status, report, sentence, failure, written.note)


def _online_of_stream(estimate: MotionEstimate, streamed: Streamed | None) -> OnlineEstimate | None:
    """The causal estimate of a stream of the same frames, in the frames of the final one."""
    if streamed is None or not np.array_equal(streamed.timestamps_ns, estimate.timestamps_ns):
        return None
    return align_online_estimate(streamed.online, estimate)


def _depth_maps(
    context: RunContext, features: Sequence[StereoFeatures], streamed: Streamed | None
) -> DepthMaps:
    """Those of the stream, where it had the same masks, and the others."""
    fits = streamed is not None and streamed.fits(context.sequence.timestamps_ns, context.rectifier)
    return DepthMaps(context, features, streamed.depth if fits and streamed is not None else None)


def _sentence(summary: Summary, estimate: MotionEstimate) -> str:
    """The result in one line."""
    rate_rpm = float(np.median(np.linalg.norm(estimate.w_P, axis=1))) * 30.0 / np.pi
    known, bounded = estimate.mass.identifiable, summary.intervals
    ratios = []
    for name, value, variance, determined in (
        ("k1", estimate.mass.k1, estimate.mass.cov_k[0, 0], known.k1),
        ("k2", estimate.mass.k2, estimate.mass.cov_k[1, 1], known.k2),
    ):
        spread = f"{value:.4f} +- {np.sqrt(variance):.4f}" if determined else "not determined by this motion"
        interval = None if determined or bounded is None else getattr(bounded, name)
        if interval is not None:
            spread += f" (from {interval[0]:.2f} to {interval[1]:.2f} is possible)"
        ratios.append(f"{name} {spread}")
    return (
        f"{summary.frames_used} of {summary.frames} frames: the target rotates at {rate_rpm:.2f} RPM; "
        f"{', '.join(ratios)}; {summary.landmarks} landmarks"
    )
