"""Our fusion against Open3D's with the same depth maps and the same poses: distances and time.

    python -m lab.mapping.fusion_peers [SEQ ...]      sequences with truth, by default four of them

Depth is ours (the default configuration), poses are true, the edge of a voxel is the same, and one core is
used. Seconds are of the processor, a frame: the faster of two runs, from depth in memory to the mesh in
memory. Distances are those of ``lab.mapping.mesh_quality``, on what was seen and lit in three
frames.

    ours         polhode/mapping/fusion/field.py, as a run uses it (with colours, sigmas and counts of views)
    ours again   poses of a tenth of the frames move by two voxels: only these are fused again
    open3d       VoxelBlockGrid (Dong et al. 2021), the same truncation, voxels of weight 3 and more;
                 ``pip install 'polhode[mapping-peers]'``, without it there is no row
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import trimesh
from tyro.conf import arg

from lab.command import DEFAULT, Configuration, Sequences, command
from lab.mapping.mesh_quality import depth_maps, true_poses
from lab.presentation import numbers, print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.config.mapping_settings import Mapping
from polhode.frontend.rectification import make_rectifier
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose, make_pose
from polhode.mapping.fusion.block_grid import TRUNCATION_VOXELS
from polhode.mapping.fusion.field import Field, choose_voxel_m, fuse
from polhode.records.dataset import open_sequence
from polhode.records.mesh_metrics import compare_surfaces
from polhode.records.read_truth import read_truth
from polhode.records.surface import DepthMap
from polhode.report.evaluation import seen_truth

SEQUENCES = tuple(Path("data") / name for name in ("ts38", "asteroid", "major_axis", "specular_mli"))
MIN_WEIGHT = 3.0
"""Of a voxel of Open3D; every frame adds one."""
HEAD = (
    "sequence | frames | voxel mm | fusion | chamfer | accuracy | completion | within 3 mm | faces | s/frame"
)
Frames = list[tuple[DepthMap, Array]]
Method = Callable[[Frames, RectifiedRig, Mapping, float], tuple[trimesh.Trimesh, float]]
"""Depth maps and poses X_RG, edge of a voxel [m] -> mesh, seconds"""


def _ours(
    frames: Frames, rig: RectifiedRig, mapping: Mapping, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    begin = process_time()
    mesh = fuse(frames, rig, mapping).mesh
    return mesh, process_time() - begin


def _ours_again(
    frames: Frames, rig: RectifiedRig, mapping: Mapping, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    """Seconds are those of the second fusion alone."""
    field, rng = Field(rig, mapping, voxel_m), np.random.default_rng(0)
    for k, (depth, X_RG) in enumerate(frames):
        off_m = rng.normal(0.0, 2.0 * voxel_m, 3) if k % 10 == 0 else np.zeros(3)
        field.add(depth, X_RG @ make_pose(np.eye(3), off_m))
    field.surface()
    begin = process_time()
    field.move(np.stack([X for _, X in frames]))
    return field.surface().mesh, process_time() - begin


def _open3d(
    frames: Frames, rig: RectifiedRig, mapping: Mapping, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    import open3d

    core, geometry = open3d.core, open3d.t.geometry
    K = core.Tensor(rig.K, dtype=core.float64)
    images = [np.nan_to_num(frame.depth_m, nan=0.0, posinf=0.0).astype(np.float32) for frame, _ in frames]
    far_m = 1.5 * max(float(image.max()) for image in images)
    given = {"depth_scale": 1.0, "depth_max": far_m, "trunc_voxel_multiplier": TRUNCATION_VOXELS}
    begin = process_time()
    grid = geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)),
        voxel_size=voxel_m, block_resolution=16, block_count=2_000,
    )  # fmt: skip
    for image, (_, X_RG) in zip(images, frames, strict=True):
        depth, pose = geometry.Image(core.Tensor(image)), core.Tensor(X_RG, dtype=core.float64)
        blocks = grid.compute_unique_block_coordinates(depth, K, pose, **given)
        grid.integrate(blocks, depth, K, pose, **given)
    found = grid.extract_triangle_mesh(weight_threshold=MIN_WEIGHT)
    seconds = process_time() - begin
    vertices, faces = found.vertex.positions.numpy(), found.triangle.indices.numpy()
    return trimesh.Trimesh(vertices.astype(np.float64), faces, process=False), seconds


def measure(folder: Path, config: Config, count: int | None) -> Iterator[list[object]]:
    """One row for each method, of the (first) frames of one sequence."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    rectifier, X_NG = make_rectifier(sequence.calibration), true_poses(sequence, truth)
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ X_NG
    maps = depth_maps(sequence, rectifier, X_RG, np.asarray(truth.mesh.vertices), config)
    frames = list(islice(zip(maps, X_RG, strict=True), count))
    voxel_m = choose_voxel_m([frame for frame, _ in frames[:5]], rectifier.rig, config.mapping)
    mapping = config.mapping.model_copy(update={"voxel_mm": 1e3 * voxel_m})
    points = seen_truth(truth.mesh, X_NG, sequence, 3)
    methods: dict[str, Method] = {"ours": _ours, "ours again": _ours_again}
    if find_spec("open3d") is not None:
        methods["open3d"] = _open3d
    for name, method in methods.items():
        run = partial(method, frames, rectifier.rig, mapping, voxel_m)
        (mesh, first_s), (_, second_s) = run(), run()
        m = compare_surfaces(mesh, truth.mesh, points)
        distances = numbers((m.chamfer_mm, m.accuracy_mm, m.completion_mm, m.completeness_3mm), ".3f")
        seconds = f"{min(first_s, second_s) / len(frames):.4f}"
        yield [folder.name, len(frames), f"{1e3 * voxel_m:.2f}", name, *distances, len(mesh.faces), seconds]


def main(
    sequences: Sequences = SEQUENCES,
    config: Configuration = DEFAULT,
    frames: Annotated[int | None, arg(help="So many of the first frames.")] = None,
) -> None:
    """Measure and print the table."""
    settings = load_config(config)
    print_table(HEAD, (row for folder in sequences for row in measure(folder, settings, frames)))


if __name__ == "__main__":
    command(main)
