"""Where the measurements come from: a dataset, a stored run, or the Monte Carlo generator.

Those of a dataset are made as by ``polhode run``: by the front end and the iterations with the back end,
without depth, fusion, online estimate and report. They are stored beside the problems, as they take most of
the time of a comparison that is resumed.
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from polhode.compare.problem.fingerprint import BASE, code_of, versions
from polhode.compare.problem.measured_problem import MeasuredProblem, freeze
from polhode.config import Config
from polhode.config.backend_settings import Backend
from polhode.config.compare_settings import Motion
from polhode.config.loader import dump_config
from polhode.files.atomic import write_text
from polhode.files.foreign_files import MIB, read_text
from polhode.files.output.run_files import SUMMARY
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.archives import read_measurements, read_relative_poses, write_measurements
from polhode.run_directory.recording import require_recording
from polhode.run_directory.summary import read_summary
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.simulation.monte_carlo import SyntheticScene, generate

BOX = np.diag([1.5, 1.2, 0.9])
THESIS = SyntheticScene(detection=0.35, station_keeping=True, min_inliers=20)
SCENES: dict[Motion, SyntheticScene] = {
    "ts38": THESIS,
    "flip": replace(THESIS, J_G=BOX, w_G=(0.1, 0.8, 0.1)),
    "minor_wobble": replace(THESIS, J_G=BOX, w_G=(0.12, 0.08, 0.8)),
    "major_wobble": replace(THESIS, J_G=BOX, w_G=(0.8, 0.08, 0.12)),
    "tumble": replace(THESIS, J_G=BOX, w_G=(0.4, 0.5, 0.45)),
    "slow_tumble": replace(
        THESIS, J_G=BOX, w_G=(0.045, 0.05, 0.055), dt_s=2.0, accel_psd=1e-9, torque_psd=1e-9
    ),
    "fast_tumble": replace(THESIS, J_G=BOX, w_G=(0.8, 1.8, 0.7), dt_s=0.25),
}
"""The motions of the benchmark of accuracy."""
CODE = (
    "polhode", "polhode.frontend", "polhode.backend", "polhode.pipeline.context",
    "polhode.pipeline.correspondences", "polhode.pipeline.find_motion",
)  # fmt: skip
"""Our code by which the measurements of a dataset are made."""
DISTRIBUTIONS = (*BASE, "torch", "opencv-python-headless", "kornia")
MAX_STAMP_BYTES = MIB


@dataclass(frozen=True)
class Source:
    """One set of measurements, before it is read."""

    name: str
    description: str
    folder: Path | None = None
    is_run: bool = False
    """Whether ``folder`` is that of a run; if not, that of a dataset"""
    truth: Path | None = None
    """Folder of a sequence whose truth gives the errors of the rows, if it has one"""
    scene: SyntheticScene | None = None
    """To be generated; None: read from ``folder``"""
    seed: int = 0

    def problem(self, config: Config, progress: Progress, store: Path) -> MeasuredProblem:
        """Read or make the measurements and freeze their problem. ``store``: where they are kept."""
        backend = config.backend.model_copy(update={"process_noise": config.compare.process_noise})
        if self.scene is not None:
            return synthetic_problem(self.name, self.scene, self.seed, backend)
        assert self.folder is not None
        if self.is_run:
            tracks, relative = read_measurements(self.folder), read_relative_poses(self.folder)
        else:
            tracks, relative = measure(self.folder, config, progress, store)
        truth = None
        if self.truth is not None:
            # read by evaluation alone; it is passed to the assessment, to no solver
            from polhode.report.evaluation import truth_of_frames

            truth = truth_of_frames(self.truth, tracks.timestamps_ns)
        return freeze(self.name, tracks, relative, backend, truth)


def sources(
    config: Config, data: Path | None, run: Path | None, truth: Path | None = None
) -> Iterator[Source]:
    """Those that the command line and the configuration ask for. Raises InputError."""
    for folder in (data, run, truth):
        if folder is not None and not folder.is_dir():
            raise InputError(f"{folder}: no such folder")
    if data is not None and run is not None:
        raise InputError("give --data or --run, not both")
    if truth is not None and run is None:
        raise InputError("--truth goes with --run: the truth of a dataset, or a generated one, is found")
    if truth is not None and not (truth / "mav0" / "target0").is_dir():
        raise InputError(
            f"{truth}: has no truth (mav0/target0); give the sequence that the run was made from"
        )
    if data is not None:
        yield Source(data.resolve().name, f"dataset {data}", data, truth=data)
        return
    if run is not None:
        # measurements or a truth that are not this run's are refused; measurements alone pass
        summary = read_summary(run) if (run / SUMMARY).is_file() else None
        if summary is not None and truth is not None:
            require_recording(summary.data, truth)
        yield Source(run.resolve().name, f"run {run}", run, is_run=True, truth=truth)
        return
    wanted = config.compare.monte_carlo
    for motion, frames, landmarks in product(wanted.motions, wanted.frames, wanted.landmarks):
        scene = replace(
            SCENES[motion],
            frames=frames,
            landmarks=landmarks,
            sigma_uv_px=wanted.noise_px,
            sigma_d_px=wanted.noise_px,
            outliers=wanted.outliers,
            loop_closure=wanted.loop_closure,
            # few enough for the links between frames of small problems
            min_inliers=min(SCENES[motion].min_inliers, max(6, landmarks // 120)),
        )
        description = f"Monte Carlo, {motion}, seed {wanted.seed}"
        yield Source(f"{motion}-{frames}-{landmarks}", description, scene=scene, seed=wanted.seed)


def synthetic_problem(name: str, scene: SyntheticScene, seed: int, backend: Backend) -> MeasuredProblem:
    """A Monte Carlo sequence as a problem, with its truth and the scene's process noise."""
    sequence = generate(scene, seed)
    config = backend.model_copy(
        update={"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd, "unknown_wrench": "none"}
    )
    return freeze(name, sequence.tracks, sequence.relative, config, sequence.truth)


def measure(
    sequence: Path, config: Config, progress: Progress, store: Path
) -> tuple[StereoTracks, RelativePoses | None]:
    """Tracks and relative poses of a sequence on disk, or those in ``store`` if they are of the same images.

    Raises InputError for a folder that is no dataset; RunFailure when no motion is found.
    """
    # torch and OpenCV are loaded only for a dataset
    from polhode.pipeline.context import open_context
    from polhode.pipeline.correspondences import match_frames
    from polhode.pipeline.find_motion import find_motion

    file, stamp_file = store.with_suffix(".npz"), store.with_suffix(".json")
    stamp = _stamp(sequence, config)
    # what is damaged is made again
    with suppress(InputError, ValueError, RecursionError):
        if json.loads(read_text(stamp_file, MAX_STAMP_BYTES, "a stamp of measurements")) == stamp:
            return read_measurements(file), read_relative_poses(file)
    stamp_file.unlink(missing_ok=True)
    context = open_context(sequence, config, progress)
    solution = find_motion(context, match_frames(context))
    tracks, links = solution.tracks, solution.links
    write_measurements(tracks, file, links)
    write_text(stamp_file, json.dumps(stamp) + "\n")
    return read_measurements(file), read_relative_poses(file)


def _stamp(sequence: Path, config: Config) -> dict[str, object]:
    """Digest of the files of a dataset except its truth, with the settings and our code."""
    digest = hashlib.sha256()
    mav0 = sequence / "mav0"
    for file in sorted(mav0.rglob("*")):
        if file.is_file() and file.relative_to(mav0).parts[0] != "target0":
            found = file.stat()
            digest.update(f"{file.relative_to(mav0)} {found.st_size} {found.st_mtime_ns}\n".encode())
    settings = dump_config(config.model_copy(update={"compare": type(config.compare)()}))
    return {"files": digest.hexdigest(), "settings": settings, "code": code_of(CODE),
            "versions": versions(DISTRIBUTIONS)}  # fmt: skip
