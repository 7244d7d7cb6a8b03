"""The main job, as the data flows: images, tracks, first motion, motion, window, depth, fusion, report."""

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Literal, TypeVar

import numpy as np

from backend import (
    estimate_motion,
    estimate_online,
    in_words_of,
    initialize_motion,
    undisputed_links,
    window_warnings,
)
from frontend.duplicates import merge_duplicates
from frontend.extract import extract_depth, extract_features
from frontend.guided import consistent_matches, reconnect
from frontend.pairs import PairMatch, match_pairs, relative_poses
from frontend.rectify import Rectifier, make_rectifier
from frontend.retrieval import pairs_to_match
from frontend.stereo import StereoFeatures
from frontend.track_refinement import refine_tracks
from frontend.tracks import Association, join_matches, to_tracks
from mapping.fusion import fuse
from pipeline import outputs
from pipeline.finish_surface import finish_surface
from pipeline.pictures import make_pictures
from pipeline.run_folder import RunFolder
from pipeline.second_look import contradicts
from pipeline.summary import Summary, build_summary
from polhode.config import Config
from polhode.dataset import StereoSequence, open_sequence
from polhode.errors import RunFailure
from polhode.lie import Array, inverse_pose, transform_points
from polhode.progress import Progress
from polhode.records import InitialMotion, MotionEstimate, OnlineEstimate, StereoTracks, SurfaceModel

Item = TypeVar("Item")

_log = logging.getLogger(__name__)
FEWEST_MEASURED_FRAMES = 3


@dataclass(frozen=True)
class RunResult:
    """What the command line says at the end."""

    status: Literal["ok", "degraded", "failed"]
    report_path: Path
    sentence: str
    failure: str | None = None
    """Why the status is "failed"; everything that was found is in the run directory all the same"""


def run(
    config: Config, sequence_folder: Path, run_folder: Path, progress: Progress, overwrite: bool = False
) -> RunResult:
    """A stereo sequence on disk to a run directory (CONTRACT.md).

    Raises InputError for bad input and then writes nothing; RunFailure when no consistent motion is found,
    and then what was found by then is in the run directory.
    """
    with RunFolder(run_folder, overwrite) as folder:
        clock = Stopwatch()
        images = _open_images(sequence_folder)
        outputs.write_config(folder, config)

        features = _extract_features(images, config, progress, clock)
        matches = _match_frames(images, features, config, progress, clock)
        links = relative_poses(matches)
        blind = images.tracks(features, join_matches(features, matches), config)
        outputs.write_measurements(blind, folder / "measurements.npz", links)

        with clock("initialization"), progress.stage("first motion", 1) as advance:
            first = initialize_motion(blind, links, config.backend)
            advance()
        for tracks, estimate in _associate_and_solve(
            images, features, matches, first, config, progress, clock
        ):
            # what is known by now stands, should a later round fail
            outputs.write_estimate(folder, tracks, estimate, links)
        if config.backend.window.enabled:
            outputs.write_online_estimate(folder, _replay(tracks, estimate, config, progress, clock))

        fused = _build_surface(images, tracks, estimate, config, progress, clock)
        seen = images.sequence, images.rectifier
        with clock("fusion"):
            X_RG = _pose_RG(tracks, estimate)
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


@dataclass(frozen=True)
class _Images:
    """The sequence on disk and how to rectify it."""

    sequence: StereoSequence
    rectifier: Rectifier

    @property
    def time_s(self) -> Array:
        """(F,) since the first pair [s]"""
        return np.asarray((self.sequence.timestamps_ns - self.sequence.timestamps_ns[0]) * 1e-9)

    @property
    def X_NR(self) -> Array:
        """(F, 4, 4) rectified left camera"""
        return np.asarray(self.sequence.X_NC @ self.rectifier.X_CR)

    def tracks(
        self, features: Sequence[StereoFeatures], association: Association, config: Config
    ) -> StereoTracks:
        tracks = to_tracks(
            features,
            association,
            self.rectifier.rig,
            self.sequence.timestamps_ns,
            self.X_NR,
            config.frontend.tracks,
            (self.sequence.sigma_camera_p_m, self.sequence.sigma_camera_theta_rad),
        )
        X_BR = self.sequence.calibration.X_BC0 @ self.rectifier.X_CR
        return replace(tracks, X_BR=X_BR, wrench=self.sequence.wrench)


@dataclass
class Stopwatch:
    """Seconds spent in each stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=perf_counter)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - begin

    def waiting(self, stage: str, items: Iterator[Item]) -> Iterator[Item]:
        """Pass the items on; the time until each comes counts as the stage's."""
        while True:
            with self(stage):
                item = next(items, None)
            if item is None:
                return
            yield item

    def add_total(self) -> None:
        """The whole time since the start, also what no stage claims."""
        self.seconds["total"] = perf_counter() - self.start


def _workers(config: Config) -> int:
    return config.runtime.workers or os.cpu_count() or 1


def _open_images(folder: Path) -> _Images:
    sequence = open_sequence(folder)
    for warning in sequence.warnings:
        _log.warning(warning)
    return _Images(sequence, make_rectifier(sequence.calibration))


def _extract_features(
    images: _Images, config: Config, progress: Progress, clock: Stopwatch
) -> list[StereoFeatures]:
    with clock("frontend"), progress.stage("features and stereo", len(images.sequence)) as advance:
        features = extract_features(
            images.sequence, images.rectifier, config.frontend, _workers(config), advance
        )
    _log.info("stereo features in a frame: median %d", int(np.median([len(f) for f in features])))
    measured = sum(len(f) >= config.frontend.pairs.min_inliers for f in features)
    if measured < FEWEST_MEASURED_FRAMES:
        raise RunFailure(
            f"only {measured} of {len(features)} frames show enough stereo features on the target; "
            "check exposure, focus and the calibration"
        )
    return features


def _match_frames(
    images: _Images, features: Sequence[StereoFeatures], config: Config, progress: Progress, clock: Stopwatch
) -> list[PairMatch]:
    """Every frame against every frame, or against those that look like it, blind."""
    rig, workers = images.rectifier.rig, _workers(config)
    with clock("frontend"), progress.stage("matching frames", len(features)) as advance:
        partners = pairs_to_match(features, config.frontend.pairs, config.seed)
        matches = match_pairs(features, partners, rig, config.frontend, config.seed, workers, advance)
    with clock("initialization"):
        good = undisputed_links(relative_poses(matches), images.time_s, images.X_NR[:, :3, :3])
    tried = sum(map(len, partners))
    _log.info("%d links between frames, of %d tried; %d contradicted", len(matches), tried, np.sum(~good))
    return [match for match, kept in zip(matches, good, strict=True) if kept]


def _associate_and_solve(
    images: _Images,
    features: Sequence[StereoFeatures],
    matches: Sequence[PairMatch],
    motion: InitialMotion,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> Iterator[tuple[StereoTracks, MotionEstimate]]:
    """Solve, and again as long as the solved motion finds frames that were lost before; the last counts."""
    rig, guided = images.rectifier.rig, config.frontend.guided
    matches = consistent_matches(matches, features, motion, rig, guided.consistency_px)
    association = join_matches(features, matches)
    for turn in range(guided.rounds):
        before = motion.connected
        with clock("frontend"):
            found = reconnect(features, association, motion, rig, guided, config.seed)
            association, motion = found.association, found.motion
            tracks = images.tracks(features, association, config)
        _log.info("round %d: %d of %d frames connected", turn + 1, motion.connected.sum(), len(before))
        if turn > 0 and np.array_equal(motion.connected, before):
            break
        with clock("backend"):
            estimate = estimate_motion(tracks, motion, config.backend, progress)
        yield tracks, estimate
        motion = InitialMotion(_pose_RG(tracks, estimate), motion.connected)
    for step in (_join_duplicates, _refine_places):
        with clock("frontend"):
            changed = step(images, features, association, motion, config)
            if changed is None:
                continue
            tracks = images.tracks(*changed, config)
        try:
            with clock("backend"):
                again = estimate_motion(tracks, motion, config.backend, progress)
        except RunFailure as failure:
            _log.info("that leads to no motion and is not used: %s", failure)
            continue
        if contradicts(again, estimate):
            _log.info("that fits worse and is not used")
            continue
        yield tracks, again
        (features, association), estimate = changed, again
        motion = InitialMotion(_pose_RG(tracks, estimate), motion.connected)


def _join_duplicates(
    images: _Images,
    features: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    config: Config,
) -> tuple[Sequence[StereoFeatures], Association] | None:
    """Landmarks that the motion shows to be one become one; None: there are none."""
    guided = config.frontend.guided
    if not guided.merge:
        return None
    merged = merge_duplicates(features, association, motion, images.rectifier.rig, guided)
    joined = association.n_landmarks - merged.n_landmarks
    _log.info("%d of %d landmarks joined to others", joined, association.n_landmarks)
    return (features, merged) if joined else None


def _refine_places(
    images: _Images,
    features: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    config: Config,
) -> tuple[Sequence[StereoFeatures], Association] | None:
    """Each landmark is put to the same point of the surface in every view; None: surfaces are not known."""
    if not config.frontend.tracks.refine or all(found.R_RS is None for found in features):
        return None
    return refine_tracks(
        *(images.sequence, images.rectifier, features, association, motion),
        *(config.frontend, _workers(config)),
    )


def _replay(
    tracks: StereoTracks, estimate: MotionEstimate, config: Config, progress: Progress, clock: Stopwatch
) -> OnlineEstimate:
    """What a sliding window knew when each frame came, in the words of the final estimate."""
    with clock("backend"):
        return in_words_of(estimate_online(tracks, config.backend, progress), estimate)


def _pose_RG(tracks: StereoTracks, estimate: MotionEstimate) -> Array:
    """(F, 4, 4) pose of the target in the rectified left camera."""
    return inverse_pose(tracks.X_NR) @ estimate.X_NG


def _build_surface(
    images: _Images,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> SurfaceModel:
    """Depth of every pair, moved into G by the motion, fused."""
    rig = images.rectifier.rig
    X_RG = _pose_RG(tracks, estimate)
    # What the frame's own landmarks span bounds the search for its disparities.
    spans: list[tuple[float, float] | None] = []
    for X in X_RG:
        disparity = rig.project(transform_points(X, estimate.landmarks.p_G))[:, 2]
        spans.append((float(disparity.min()), float(disparity.max())) if len(disparity) else None)
    maps = extract_depth(images.sequence, images.rectifier, config.frontend, spans, _workers(config))
    with clock("fusion"):
        surface = fuse(
            *(zip(clock.waiting("depth", maps), X_RG, strict=True), rig, config.mapping, progress, len(X_RG)),
            covariance_G=estimate.covariance_X_NG,
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
