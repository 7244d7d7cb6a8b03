"""The main job, as the data flows: images, tracks, first motion, motion, window, depth, fusion, report."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from polhode.backend import align_online_estimate, estimate_online, window_warnings
from polhode.config import Config
from polhode.frontend.extract import extract_depth
from polhode.lie import transform_points
from polhode.mapping.fusion.fuse import fuse
from polhode.pipeline.correspondences import look, workers
from polhode.pipeline.find_motion import find_motion, pose_RG
from polhode.pipeline.finish_surface import finish_surface
from polhode.pipeline.images import Images, open_images
from polhode.pipeline.pictures import make_pictures
from polhode.pipeline.run_directory import outputs
from polhode.pipeline.run_directory.run_folder import RunFolder
from polhode.pipeline.run_directory.summary import Summary, build_summary
from polhode.pipeline.stopwatch import Stopwatch
from polhode.progress import Progress
from polhode.records import MotionEstimate, OnlineEstimate, StereoTracks, SurfaceModel
from polhode.threads import single_threaded

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunResult:
    """What the command line says at the end."""

    status: Literal["ok", "degraded", "failed"]
    report_path: Path
    sentence: str
    failure: str | None = None
    """Why the status is "failed"; everything that was found is in the run directory all the same"""


@single_threaded
def run(
    config: Config, sequence_folder: Path, run_folder: Path, progress: Progress, overwrite: bool = False
) -> RunResult:
    """A stereo sequence on disk to a run directory (CONTRACT.md).

    Raises InputError for bad input and then writes nothing; RunFailure when no consistent motion is found,
    and then what was found by then is in the run directory.
    """
    with RunFolder(run_folder, overwrite) as folder:
        clock = Stopwatch()
        images = open_images(sequence_folder)
        outputs.write_config(folder, config)

        sight = look(images, config, progress, clock)
        outputs.write_measurements(sight.tracks(images, config), folder / "measurements.npz", sight.links)

        for found in find_motion(images, sight, config, progress, clock):
            # what is known by now stands, should a later step fail
            outputs.write_estimate(folder, found.tracks, found.estimate, found.links)
        tracks, estimate = found.tracks, found.estimate
        if config.backend.window.enabled:
            outputs.write_online_estimate(folder, _replay(tracks, estimate, config, progress, clock))

        fused = _build_surface(images, tracks, estimate, config, progress, clock)
        seen = images.sequence, images.rectifier
        with clock("fusion"):
            X_RG = pose_RG(tracks, estimate)
            if fused.aligned is not None:
                X_RG = fused.aligned.put_into(X_RG)
            surface, levels, shape = finish_surface(fused, *seen, X_RG, estimate.mass, config)
        outputs.write_surface(folder, surface, levels)

        with clock("report"):
            make_pictures(folder, *seen, tracks, estimate, surface, config.pictures, progress)
        clock.add_total()
        warnings = [*images.sequence.warnings, *window_warnings(tracks.n_frames, config.backend)]
        warnings += fused.warnings
        summary = build_summary(tracks, estimate, surface, clock.seconds, warnings, shape=shape)
        with progress.stage("report", 1) as advance:
            summary = outputs.finish_run(folder, summary)
            advance()
    failure = summary.warnings[0] if summary.status == "failed" else None
    report = run_folder / "report.html"
    return RunResult(summary.status, report, _sentence(summary, estimate), failure)


def _replay(
    tracks: StereoTracks, estimate: MotionEstimate, config: Config, progress: Progress, clock: Stopwatch
) -> OnlineEstimate:
    """What a sliding window knew when each frame came, in the words of the final estimate."""
    with clock("backend"):
        return align_online_estimate(estimate_online(tracks, config.backend, progress), estimate)


def _build_surface(
    images: Images,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> SurfaceModel:
    """Depth of every pair, moved into G by the motion, fused."""
    rig = images.rectifier.rig
    X_RG = pose_RG(tracks, estimate)
    # What the frame's own landmarks span bounds the search for its disparities.
    spans: list[tuple[float, float] | None] = []
    for X in X_RG:
        disparity = rig.project(transform_points(X, estimate.landmarks.p_G))[:, 2]
        spans.append((float(disparity.min()), float(disparity.max())) if len(disparity) else None)
    maps = extract_depth(images.sequence, images.rectifier, config.frontend, spans, workers(config))
    with clock("fusion"):
        surface = fuse(
            *(zip(clock.waiting("depth", maps), X_RG, strict=True), rig, config.mapping, progress, len(X_RG)),
            covariance_G=estimate.covariance_X_NG,
        )
    for warning in surface.warnings:
        _log.warning(warning)
    if surface.aligned is not None:
        _log.info(
            "%d of %d frames with doubtful poses were aligned to the surface of the others",
            *(len(surface.aligned.frames), surface.aligned.doubtful),
        )
    clock.seconds["fusion"] -= clock.seconds.get("depth", 0.0)
    return surface


def _sentence(summary: Summary, estimate: MotionEstimate) -> str:
    """What was found, in a line."""
    rate_rpm = float(np.median(np.linalg.norm(estimate.w_P, axis=1))) * 30.0 / np.pi
    known = estimate.mass.identifiable
    ratios = []
    for name, value, variance, sure in (
        ("k1", estimate.mass.k1, estimate.mass.cov_k[0, 0], known.k1),
        ("k2", estimate.mass.k2, estimate.mass.cov_k[1, 1], known.k2),
    ):
        spread = f"{value:.4f} +- {np.sqrt(variance):.4f}" if sure else "not determined by this motion"
        ratios.append(f"{name} {spread}")
    return (
        f"{summary.frames_used} of {summary.frames} frames: the target turns at {rate_rpm:.2f} RPM; "
        f"{', '.join(ratios)}; {summary.landmarks} landmarks"
    )
