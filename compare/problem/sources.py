"""Where the measurements come from: a dataset, a stored run, or the Monte Carlo generator."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polhode.compare.problem.measured_problem import MeasuredProblem, freeze
from polhode.config import Config
from polhode.config.backend import Backend
from polhode.config.compare import MonteCarlo, Motion
from polhode.errors import InputError
from polhode.pipeline.run_directory.archives import read_measurements, read_relative_poses
from polhode.progress import Progress
from polhode.records import Ints, Truth
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


@dataclass(frozen=True)
class Source:
    """One set of measurements that is not read yet."""

    name: str
    words: str
    kind: str
    """data, run or monte_carlo"""
    folder: Path | None = None
    truth: Path | None = None
    """Folder of a sequence whose truth the rows are judged by, if it has one"""
    scene: SyntheticScene | None = None
    seed: int = 0

    def problem(self, config: Config, progress: Progress, store: Path) -> MeasuredProblem:
        """Read or make the measurements and freeze their problem. ``store``: where to keep what was made."""
        backend = config.backend.model_copy(update={"process_noise": config.compare.process_noise})
        if self.scene is not None:
            return synthetic_problem(self.name, self.scene, self.seed, backend)
        assert self.folder is not None
        if self.kind == "run":
            tracks, relative = read_measurements(self.folder), read_relative_poses(self.folder)
        else:
            from polhode.compare.problem.dataset import measure

            tracks, relative = measure(self.folder, config, progress, store)
        return freeze(self.name, tracks, relative, backend, self._truth(tracks.timestamps_ns))

    def _truth(self, timestamps_ns: Ints) -> Truth | None:
        """Read by evaluation alone; it reaches the assessment, no solver."""
        if self.truth is None:
            return None
        from polhode.pipeline.evaluation import truth_of_frames

        return truth_of_frames(self.truth, timestamps_ns)


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
        raise InputError(
            "--truth goes with --run: a dataset's own truth is found, and so is a generated one's"
        )
    if truth is not None and not (truth / "mav0" / "target0").is_dir():
        raise InputError(
            f"{truth}: has no truth (mav0/target0); give the sequence that the run was made from"
        )
    if data is not None:
        yield Source(data.resolve().name, f"dataset {data}", "data", folder=data, truth=data)
    elif run is not None:
        yield Source(run.resolve().name, f"run {run}", "run", folder=run, truth=truth)
    else:
        yield from _generated(config.compare.monte_carlo)


def _generated(wanted: MonteCarlo) -> Iterator[Source]:
    for motion in wanted.motions:
        for frames in wanted.frames:
            for landmarks in wanted.landmarks:
                scene = replace(
                    SCENES[motion],
                    frames=frames,
                    landmarks=landmarks,
                    sigma_uv_px=wanted.noise_px,
                    sigma_d_px=wanted.noise_px,
                    outliers=wanted.outliers,
                    loop_closure=wanted.loop_closure,
                )
                # small problems keep their links between frames
                scene = replace(scene, min_inliers=min(scene.min_inliers, max(6, landmarks // 120)))
                name = f"{motion}-{frames}-{landmarks}"
                words = f"Monte Carlo, {motion}, seed {wanted.seed}"
                yield Source(name, words, "monte_carlo", scene=scene, seed=wanted.seed)


def synthetic_problem(name: str, scene: SyntheticScene, seed: int, backend: Backend) -> MeasuredProblem:
    """A Monte Carlo sequence as a problem, with its truth and the scene's process noise."""
    sequence = generate(scene, seed)
    config = backend.model_copy(
        update={"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd, "unknown_wrench": "none"}
    )
    return freeze(name, sequence.tracks, sequence.relative, config, sequence.truth)
