"""What each stage of a run writes into the run directory (docs/run_directory.md).

A stage writes its files as it ends, so that they stand if a later stage fails. The bytes of every file but
summary.json (timings), log.txt and report.html depend on the content alone.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polhode.config import Config
from polhode.config.loader import dump_config
from polhode.files.atomic import write_bytes, write_text
from polhode.mapping.finishing.detail_levels import DetailLevel
from polhode.mapping.mesh_files import write_glb, write_ply
from polhode.records.estimate import Disturbances, MotionEstimate, OnlineEstimate
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.run_directory.archives import (
    write_covariance,
    write_hypotheses,
    write_measurements,
    write_online,
)
from polhode.run_directory.point_cloud_file import write_landmarks
from polhode.run_directory.summary import build_summary, write_summary
from polhode.run_directory.trajectory_file import trajectory_of, write_trajectory

PUSHES_COLUMNS: tuple[str, ...] = (
    "push",
    "start_ns",
    "end_ns",
    *(f"{prefix}{name}_{axis}" for name in ("accel_N", "angular_accel_P") for prefix in ("", "sigma_")
      for axis in "xyz"),
)  # fmt: skip
"""Header line of pushes.csv. Mean accelerations over the step [m/s^2, rad/s^2]; steps of one push share its
number."""


def write_config(folder: Path, config: Config) -> None:
    """config.yaml with every default written out: running it repeats the run."""
    write_text(folder / "config.yaml", dump_config(config))


def write_estimate(
    folder: Path, tracks: StereoTracks, estimate: MotionEstimate, relative: RelativePoses | None = None
) -> None:
    """trajectory.csv, covariance.npz and landmarks.ply; measurements.npz again, now with the residuals;
    pushes.csv where unknown forces or torques were estimated, hypotheses.npz where the rotation is ambiguous.

    Also a preliminary summary.json, so that a run that fails later has all the numbers known by then.
    """
    write_trajectory(trajectory_of(estimate), folder / "trajectory.csv")
    write_covariance(estimate, folder / "covariance.npz")
    write_landmarks(estimate.landmarks, folder / "landmarks.ply")
    write_measurements(tracks, folder / "measurements.npz", relative, estimate)
    for name in ("pushes.csv", "hypotheses.npz"):
        (folder / name).unlink(missing_ok=True)
    if estimate.hypotheses:
        write_hypotheses(estimate.hypotheses, folder / "hypotheses.npz")
    if estimate.disturbances is not None:
        write_disturbances(estimate.disturbances, folder / "pushes.csv")
    write_summary(build_summary(tracks, estimate, None, {}), folder / "summary.json")


def write_disturbances(found: Disturbances, path: Path) -> None:
    """pushes.csv: one row for each step in which unknown forces and torques may act; an undetermined sigma is
    ``inf``."""
    first = np.array([impulse.start_ns for impulse in found.impulses])
    number = np.searchsorted(first, found.start_ns, side="right")
    values = np.hstack(
        [found.accel_N, found.sigma_accel_N, found.angular_accel_P, found.sigma_angular_accel_P]
    )
    lines = [",".join(PUSHES_COLUMNS)]
    for k, row in enumerate(values.tolist()):
        stamps = (int(number[k]), int(found.start_ns[k]), int(found.end_ns[k]))
        lines.append(",".join([*map(str, stamps), *map(repr, row)]))
    write_text(path, "\n".join(lines) + "\n")


def write_online_estimate(folder: Path, online: OnlineEstimate) -> None:
    """trajectory_online.csv and online.npz: the estimate as each frame arrived."""
    write_trajectory(trajectory_of(online), folder / "trajectory_online.csv")
    write_online(online, folder / "online.npz")


def write_surface(folder: Path, surface: SurfaceModel, levels: Sequence[DetailLevel] = ()) -> None:
    """mesh.ply, mesh.glb and the lighter meshes; nothing when the surface is empty."""
    if len(surface.mesh.faces) == 0:
        return
    write_ply(path=folder / "mesh.ply", surface=surface)
    write_glb(path=folder / "mesh.glb", surface=surface)
    for number, level in enumerate(levels, start=1):
        write_glb(path=folder / f"mesh_lod{number}.glb", surface=level.surface)


def write_picture(folder: Path, name: str, content: bytes, caption: str) -> None:
    """One image of the report in RUN/pictures, with its caption in captions.json beside it."""
    target = folder / "pictures"
    target.mkdir(exist_ok=True)
    write_bytes(target / name, content)
    file = target / "captions.json"
    captions = json.loads(file.read_text()) if file.is_file() else {}
    write_text(file, json.dumps(captions | {name: caption}, indent=2) + "\n")
