"""Wall-clock seconds of the dense model for each frame, by step.

    python -m benchmarks.mapping.frame_time [SEQ ...]          by default ts38 and asteroid, at voxels of 1 mm
    python -m benchmarks.mapping.frame_time --short            the shipped sample

One process, one core, true poses, images as they are on the disk. Columns, in seconds a frame:

    depth      images to a depth map: reading, rectifying, disparity, refinement
    fusion     a depth map into the field
    meshing    marching cubes and sigmas once at the end, shared by the frames
    finishing  holes, colours, coverage, lighter meshes, mass against volume, once, shared by the frames
    total      fusion, meshing and finishing, for which the limit of 0.25 s is; depth is given separately
    processor  the total in seconds of the processor, which other work on the machine does not affect

A few frames go through everything first, so that what is compiled or loaded does not count.
"""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import DEFAULT, Configuration, Sequences, Short, command
from benchmarks.mapping.mesh_quality import depth_maps, true_poses
from benchmarks.presentation import numbers, print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.frontend.rectification import make_rectifier
from polhode.lie import Array, inverse_pose
from polhode.mapping.fusion.field import Field
from polhode.pipeline.context import RunContext
from polhode.pipeline.finish_surface import finish_surface
from polhode.progress import Silent
from polhode.records import Identifiability, MassProperties
from polhode.truth import read_truth

LIMIT_S = 0.25
SEQUENCES = [Path("data/ts38"), Path("data/asteroid")]
WARM = 3
"""Frames that go first."""


@dataclass(frozen=True)
class FrameTimes:
    """Of so many frames: depth, fusion, meshing, finishing (4,) [s], on the wall's clock and of the core."""

    frames: int
    size: str
    wall_s: Array
    core_s: Array
    faces: int


def now() -> Array:
    """(2,) [s]: on the wall's clock, of this process."""
    return np.array([perf_counter(), process_time()])


def mass_of_nothing() -> MassProperties:
    """A motion that determines nothing: the finishing compares the mesh with it only for its report."""
    none = np.zeros(3, dtype=bool)
    known = Identifiability(False, False, False, False, {}, none, none, np.full(8, np.inf))
    return MassProperties(
        J_G=np.eye(3),
        moments=np.ones(3),
        k1=0.0,
        k2=0.0,
        cov_k=np.eye(2),
        cov_J=np.eye(5),
        R_GP=np.eye(3),
        cov_R_GP=np.eye(3),
        com_G=np.zeros(3),
        cov_com_G=np.eye(3),
        identifiable=known,
    )


def measure(folder: Path, config: Config, voxel_m: float, most: int | None = None) -> FrameTimes:
    """The true poses bound the disparities, as the sparse map does in a run."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    rectifier = make_rectifier(sequence.calibration)
    context = RunContext(sequence, rectifier, config, Silent())
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ true_poses(sequence, truth)
    count = len(sequence) if most is None else min(most, len(sequence))
    maps = depth_maps(sequence, rectifier, X_RG, np.asarray(truth.mesh.vertices), config)
    field = Field(rectifier.rig, config.mapping, voxel_m, 0.25 * config.mapping.memory_mib)
    depth, fusion = np.zeros(2), np.zeros(2)
    for X in X_RG[:count]:
        begin = now()
        frame = next(maps)
        between = now()
        field.add(frame, X)
        depth, fusion = depth + between - begin, fusion + now() - between
    begin = now()
    surface = field.surface()
    meshed = now()
    motion: Any = SimpleNamespace(X_RG=X_RG, estimate=SimpleNamespace(mass=mass_of_nothing()))
    finished = finish_surface(context, surface, motion).surface
    wall_s, core_s = np.stack([depth, fusion, meshed - begin, now() - meshed]).T
    size = f"{rectifier.rig.width_px}x{rectifier.rig.height_px}"
    return FrameTimes(count, size, wall_s, core_s, len(finished.mesh.faces))


def main(
    sequences: Sequences = (),
    short: Short = False,
    voxel_mm: Annotated[float, arg(help="Edge of a voxel [mm].")] = 1.0,
    config: Configuration = DEFAULT,
) -> None:
    """Print the table."""
    settings = load_config(config)
    folders = sequences or ([Path("sample")] if short else SEQUENCES)
    voxel_m = voxel_mm * 1e-3
    measure(folders[0], settings, voxel_m, WARM)
    head = (
        "sequence | frames | size | voxel mm | faces | depth | fusion | meshing | finishing | total "
        f"| processor | limit {LIMIT_S} s"
    )
    print_table(head, (row(measure(folder, settings, voxel_m), folder.name, voxel_mm) for folder in folders))


def row(t: FrameTimes, name: str, voxel_mm: float) -> list[object]:
    """Seconds per frame, and whether the limit is met."""
    total, core = t.wall_s[1:].sum() / t.frames, t.core_s[1:].sum() / t.frames
    seconds = numbers((*(t.wall_s / t.frames), total, core), ".3f")
    verdict = "met" if total <= LIMIT_S else "missed"
    return [name, t.frames, t.size, f"{voxel_mm:.2f}", t.faces, *seconds, verdict]


if __name__ == "__main__":
    command(main)
