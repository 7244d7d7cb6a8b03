"""A simulated sequence, from the description of a scene to the dataset on disk."""

from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np

import polhode
from polhode.config import Config
from polhode.config.loader import dump_config
from polhode.config.scene_settings import Scene
from polhode.records.calibration_prior import CalibrationPrior, changed, default_prior, exact_prior
from polhode.records.dataset_writer import (
    write_camera_csv,
    write_inspector,
    write_prior,
    write_range_sensor,
    write_sensor,
    write_truth,
    write_wrench,
)
from polhode.records.range_images import RANGE_FOLDER
from polhode.records.rig_calibration import StereoCalibration
from polhode.runtime.program_digest import versions_of
from polhode.runtime.progress import Progress
from polhode.simulation.dataset.frame_renderer import render_frames
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence, truth_of
from polhode.simulation.dataset.resumable_dataset import SCENE_FILE, require_free, staged_dataset
from polhode.simulation.motion.forces import known_wrench
from polhode.simulation.motion.inspector import reported_inspector
from polhode.simulation.stereo_camera import mount_pose

__all__ = [
    "SCENE_FILE",
    "SequencePlan",
    "plan_sequence",
    "require_free",
    "sequence_digest",
    "simulate",
    "truth_of",
    "write_sequence",
]

LIBRARIES = ("embreex", "numba", "numpy", "opencv-python-headless", "scipy", "trimesh")
"""Those that the images depend on"""
MESH_SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".mtl", ".png", ".jpg", ".jpeg")


def simulate(
    scene: Scene, seed: int, folder: Path, progress: Progress, workers: int = 1, overwrite: bool = False
) -> SequencePlan:
    """Render a scene into the dataset ``folder``, with truth. The bytes do not depend on ``workers``.

    Raises InputError if the folder exists (``overwrite`` replaces a dataset), or the scene cannot be
    rendered.
    """
    require_free(folder, overwrite)
    plan = plan_sequence(scene, seed)
    write_sequence(plan, folder, progress, workers, overwrite)
    return plan


def write_sequence(
    plan: SequencePlan, folder: Path, progress: Progress, workers: int = 1, overwrite: bool = False
) -> None:
    """Render a plan into the dataset ``folder``, resuming where the same plan was interrupted.

    Raises InputError like ``simulate``, RunFailure if a worker is killed, KeyboardInterrupt with a message.
    """
    description = describe_scene(plan.scene, plan.seed)
    # What the images depend on: the scene, the program's sources, files of the mesh by size and date.
    files = "".join(
        f"# {f.name}: {f.stat().st_size} {f.stat().st_mtime_ns}\n"
        for f in _files_of_mesh(plan.scene.body.path)
    )
    fingerprint = f"{description}# program: {_program_digest()}\n{files}"
    with staged_dataset(folder, overwrite, fingerprint, len(plan.frames)) as staged:
        missing = staged.missing(plan.frames)
        there = len(plan.frames) - len(missing)
        title = f"rendering ({there} of {len(plan.frames)} were there)" if there else "rendering"
        with progress.stage(title, len(missing)) as advance:
            render_frames(plan, staged, missing, workers, advance)
        write_estimator_inputs(plan, staged.mav0)
        write_truth(staged.mav0, truth_of(plan))
        (staged.path / SCENE_FILE).write_text(description, encoding="utf-8")


def describe_scene(scene: Scene, seed: int) -> str:
    """The configuration that makes the dataset as YAML, with every default of the scene written out."""
    return dump_config(Config(seed=seed, scene=scene), keys=("seed", "scene"))


def sequence_digest(scene: Scene, seed: int) -> str:
    """SHA-256, hexadecimal, of all that the images and the truth depend on: scene, content of its mesh file
    and of those beside it, sources of the program, libraries."""
    program = f"{_program_digest()} {versions_of(LIBRARIES)}"
    digest = sha256(f"{describe_scene(scene, seed)}{program}".encode())
    for file in _files_of_mesh(scene.body.path):
        digest.update(f"{file.name} {sha256(file.read_bytes()).hexdigest()}".encode())
    return digest.hexdigest()


@cache
def _program_digest() -> str:
    """Digest of the sources that the images depend on."""
    home = Path(polhode.__path__[0])
    sources = [*home.glob("*.py"), *(home / "config").rglob("*.py"), *(home / "simulation").rglob("*.py")]
    return sha256(b"".join(file.read_bytes() for file in sorted(sources))).hexdigest()


def _files_of_mesh(path: str | None) -> list[Path]:
    if path is None:
        return []
    beside = Path(path).resolve().parent.iterdir()
    return sorted(file for file in beside if file.suffix.lower() in MESH_SUFFIXES)


def write_estimator_inputs(plan: SequencePlan, mav0: Path) -> None:
    """Write what the estimator may read: calibration, times, inspector poses, known forces and torques."""
    scene, X_BC = plan.scene, mount_pose(plan.scene.rig)
    all_ns = plan.target.timestamps_ns[: scene.frames]
    stated, prior = stated_calibration(plan)
    lenses = (stated.K0, stated.dist0, stated.X_BC0), (stated.K1, stated.dist1, stated.X_BC1)
    for index, (c, lens) in enumerate(zip(plan.recording_cameras, lenses, strict=False)):
        path, rate_hz, bits = mav0 / f"cam{index}", 1.0 / scene.interval_s, scene.sensor.bits
        size_px = c.width_px, c.height_px
        write_sensor(path, *lens, size_px, rate_hz=rate_hz, bits=bits, fisheye=c.fisheye)
        write_camera_csv(path, all_ns[list(plan.frames)])
    write_prior(mav0, prior)
    if (ranges := scene.ranges) is not None:
        write_range_sensor(mav0 / RANGE_FOLDER, ranges.scale_m, ranges.sigma_m, ranges.growth_per_m)
        write_camera_csv(mav0 / RANGE_FOLDER, all_ns[list(plan.frames)])
    if (known := known_wrench(scene.motion, plan.target.timestamps_ns)) is not None:
        write_wrench(mav0, *known)
    if scene.inspector.moves and scene.inspector.reported:
        X_NB = reported_inspector(scene, plan.X_NC, X_BC, np.random.default_rng([plan.seed, 0x1]))
        sigma_theta_rad = float(np.deg2rad(scene.inspector.sigma_theta_deg))
        write_inspector(mav0, all_ns, X_NB, scene.inspector.sigma_p_m, sigma_theta_rad)


def stated_calibration(plan: SequencePlan) -> tuple[StereoCalibration, CalibrationPrior]:
    """What sensor.yaml says of the cameras, wrong by as much as the scene asks for, and its sigmas."""
    (left, right), X_BC = plan.cameras, mount_pose(plan.scene.rig)
    true = StereoCalibration(
        left.K, right.K, left.dist, right.dist, X_BC @ left.X_CK, X_BC @ right.X_CK,
        left.width_px, left.height_px, None, left.fisheye, right.fisheye, (right.width_px, right.height_px),
    )  # fmt: skip
    factor = plan.scene.rig.calibration_errors
    if factor == 0.0:
        return true, exact_prior(true)
    default = default_prior(true)
    prior = replace(default, covariance=factor**2 * default.covariance)
    drawn = prior.draw(np.random.default_rng([plan.seed, 0x7]))
    return changed(true, {name: -error for name, error in drawn.items()}), prior
