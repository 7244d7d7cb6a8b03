"""Measurements without images for the whole command: a sequence on disk, its features from a simulation.

The pictures on disk show nothing of the motion, and are not judged; features, matches and surface take the
place of what front end and mapping make. All else, from the command line to the report, is the program's own.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.cli.main import main
from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.geometry.lie import make_pose
from polhode.records.dataset_writer import write_png, write_sensor
from polhode.records.surface import SurfaceModel
from polhode.simulation.monte_carlo import RIG, SyntheticScene, SyntheticSequence, generate

FRAMES = 14
SCENE = SyntheticScene(
    frames=FRAMES, landmarks=120, detection=0.7, sigma_uv_px=0.3, sigma_d_px=0.3,
    J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.2, 0.8, 0.1),
)  # fmt: skip
NO_WINDOW = ("--backend.window.enabled", "false", "--backend.bounds.intervals", "false")
"""Neither live states nor intervals: what follows when the motion has been found"""
NOTHING = StereoFeatures(
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 4), dtype=np.float32)
)
"""What the second method of the front end finds."""


class Outcome:
    """What ``polhode run`` left of the measurements of a scene, and what it said.

    ``second``: the scene that the second method of the front end measures, of the same motion.
    """

    def __init__(
        self,
        place: Path,
        patch: pytest.MonkeyPatch,
        capture: pytest.CaptureFixture[str],
        scene: SyntheticScene,
        *options: str,
        seed: int = 1,
        second: SyntheticScene | None = None,
    ) -> None:
        other = None if second is None else generate(second, seed)
        put_in_place(generate(scene, seed), place / "sequence", patch, other)
        self.folder = place / f"run{len(list(place.iterdir()))}"
        words = ["run", "configs/default.yaml", "--data", str(place / "sequence"), "-o", str(self.folder)]
        pictures = ("--outputs", "motion", "surface")
        self.code = main([*words, "--runtime.workers", "1", *pictures, *options])
        self.summary: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        self.warnings: list[str] = self.summary["warnings"]
        self.files = {path.name for path in self.folder.iterdir()}
        self.log = (self.folder / "log.txt").read_text()
        captured = capture.readouterr()
        self.out, self.errors = captured.out.splitlines(), captured.err.strip().splitlines()

    def says(self, words: str) -> bool:
        return any(words in warning for warning in self.warnings)


def put_in_place(
    sequence: SyntheticSequence, folder: Path, patch: pytest.MonkeyPatch, second: SyntheticSequence | None
) -> None:
    """Write the sequence to the folder; from now on a run sees these measurements."""
    _write(sequence, folder)
    features, matches = _features(sequence), _matches(sequence)
    others, joined = [NOTHING] * len(features), list[PairMatch]()
    if second is not None:
        others, joined = _features(second), _matches(second)
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    surface = SurfaceModel(box, np.full(8, 1e-3), np.full(8, 3, dtype=np.int64))

    def found(images: Any, rectifier: Any, config: Frontend, *_: Any) -> list[StereoFeatures]:
        return features if config.features.method == "rootsift" else others

    def matched(frames: Any, partners: Any, rig: Any, config: Frontend, *_: Any) -> list[list[PairMatch]]:
        these = matches if config.features.method == "rootsift" else joined
        return [[match for match in these if match.i == i] for i in range(len(features))]

    patch.setattr("polhode.pipeline.correspondences.extract_features", found)
    patch.setattr("polhode.pipeline.correspondences.match_rows", matched)
    patch.setattr("polhode.pipeline.build_surface.fuse", lambda *_, **__: surface)
    # of the pictures on disk
    patch.setattr("polhode.pipeline.build_surface.views_of_pairs", lambda *_: [])
    patch.setattr("polhode.pipeline.open_run.warn_before_run", lambda *_: None)


def _write(sequence: SyntheticSequence, folder: Path) -> None:
    """The picture of each frame is a bright patch before a dark sky, with other noise in one row."""
    rng = np.random.default_rng(1)
    picture = np.zeros((RIG.height_px, RIG.width_px), dtype=np.uint8)
    picture[200:280, 280:360] = rng.integers(60, 250, (80, 80))
    names = [f"{stamp}.png" for stamp in sequence.tracks.timestamps_ns]
    for index in (0, 1):
        camera = folder / "mav0" / f"cam{index}"
        X_BC = make_pose(np.eye(3), np.array([index * RIG.baseline_m, 0.0, 0.0]))
        write_sensor(camera, RIG.K, np.zeros(4), X_BC, (RIG.width_px, RIG.height_px), rate_hz=2.0)
        for name in names:
            picture[200, 280:360] = rng.integers(60, 250, 80)
            write_png(camera / "data" / name, picture)
        (camera / "data.csv").write_text("".join(f"{Path(name).stem},{name}\n" for name in names))


def _features(sequence: SyntheticSequence) -> list[StereoFeatures]:
    """One a measurement; a landmark has the same descriptor wherever it is seen."""
    tracks = sequence.tracks
    name = np.random.default_rng(2).normal(size=(tracks.n_landmarks, 32))
    name /= np.linalg.norm(name, axis=1, keepdims=True)
    features = []
    for k in range(tracks.n_frames):
        rows = np.flatnonzero(tracks.frame == k)
        uvd_px, descriptors = tracks.uvd_px[rows], name[tracks.landmark[rows]].astype(np.float32)
        seen = uvd_px, tracks.sigma_px[rows], RIG.triangulate(uvd_px), np.ones(len(rows))
        features.append(StereoFeatures(*seen, descriptors))
    return features


def _matches(sequence: SyntheticSequence) -> list[PairMatch]:
    """Every landmark that two frames of a link share."""
    tracks, links = sequence.tracks, sequence.relative
    marks = [tracks.landmark[tracks.frame == k] for k in range(tracks.n_frames)]
    matches = []
    for i, j, X_RiRj in zip(links.i.tolist(), links.j.tolist(), links.X_RiRj, strict=True):
        _, in_i, in_j = np.intersect1d(marks[i], marks[j], return_indices=True)
        matches.append(PairMatch(i, j, X_RiRj, np.stack([in_i, in_j], axis=1)))
    return matches
