"""Our fusion against others' with the same depth maps and the same poses: chamfer, time, memory.

    python -m benchmarks.mapping.fusion_peers [SEQ ...]      sequences with truth, by default four of them
    python -m benchmarks.mapping.fusion_peers --short        the shipped sample

Depth is ours (the default configuration), poses are true. Every method runs in a process of its own, on
one core, with the same edge of a voxel. Seconds are of the processor, so that others on the machine do not
count: the faster of two runs after a warm-up of a few frames, from depth in memory to the mesh in memory.
MiB: by how much the process's peak exceeds what it held before. Distances are those of
``benchmarks.mesh_quality``, on what was seen and lit in three frames.

    ours         mapping/fusion/fuse.py, as a run uses it (with colours, sigmas and counts of views)
    ours again   poses of a tenth of the frames move by two voxels: only these are fused again
    open3d       VoxelBlockGrid (Dong et al. 2021), the same truncation, voxels of weight 3 and more
    colmap       its fusion of depth maps, points that 3 frames agree on, and its Poisson mesher, from depth
                 on the disk; its own depth (patch match, Schoenberger et al. 2016) needs CUDA

Open3D and pycolmap: ``pip install polhode[mapping-peers]``; a peer that is missing is a row that says so.
"""

import gc
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Annotated, Any

import numpy as np
import torch
import trimesh
from tyro.conf import arg

from benchmarks.command import Sequences, Short, command
from benchmarks.mapping.colmap_fusion import fuse_and_mesh, write_workspace
from benchmarks.mapping.mesh_quality import depth_maps, true_poses
from polhode.camera import RectifiedRig
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.frontend.rectification import make_rectifier
from polhode.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.mapping.fusion.field import TRUNCATION_VOXELS, Field, choose_voxel_m, fuse
from polhode.mesh_metrics import compare_surfaces
from polhode.pipeline.evaluation import seen_truth
from polhode.records import DepthMap
from polhode.truth import read_truth

SEQUENCES = [Path("data") / name for name in ("ts38", "asteroid", "major_axis", "specular_mli")]
MIN_WEIGHT = 3.0
"""Of a voxel of Open3D; every frame adds one."""
Frames = list[tuple[DepthMap, Array]]
Method = Callable[[Frames, RectifiedRig, Config, float], tuple[trimesh.Trimesh, float]]
"""Mesh, and seconds that the frames took"""


class NotHereError(Exception):
    """A peer that is not installed or does not run on this machine, in words."""


def _ours(frames: Frames, rig: RectifiedRig, config: Config, voxel_m: float) -> tuple[trimesh.Trimesh, float]:
    begin = process_time()
    mesh = fuse(frames, rig, _with_voxel(config, voxel_m).mapping).mesh
    return mesh, process_time() - begin


def _ours_again(
    frames: Frames, rig: RectifiedRig, config: Config, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    """Seconds are those of the second fusion alone."""
    field, rng = Field(rig, _with_voxel(config, voxel_m).mapping, voxel_m), np.random.default_rng(0)
    for k, (depth, X_RG) in enumerate(frames):
        off = rng.normal(0.0, 2.0 * voxel_m, 3) if k % 10 == 0 else np.zeros(3)
        field.add(depth, X_RG @ make_pose(exp_so3(np.zeros(3)), off))
    field.surface()
    begin = process_time()
    field.move(np.stack([X for _, X in frames]))
    return field.surface().mesh, process_time() - begin


def _with_voxel(config: Config, voxel_m: float) -> Config:
    return config.model_copy(
        update={"mapping": config.mapping.model_copy(update={"voxel_mm": voxel_m * 1e3, "device": "cpu"})}
    )


def _open3d(
    frames: Frames, rig: RectifiedRig, config: Config, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    try:
        import open3d
    except ImportError as error:
        raise NotHereError(f"missing ({error}); pip install polhode[mapping-peers]") from error
    core, geometry = open3d.core, open3d.t.geometry
    K = core.Tensor(rig.K, dtype=core.float64)
    images = [np.nan_to_num(frame.depth_m, nan=0.0, posinf=0.0).astype(np.float32) for frame, _ in frames]
    far = 1.5 * max(float(image.max()) for image in images)
    begin = process_time()
    grid = geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)),
        voxel_size=voxel_m, block_resolution=16, block_count=2_000,
    )  # fmt: skip
    for image, (_, X_RG) in zip(images, frames, strict=True):
        depth, pose = geometry.Image(core.Tensor(image)), core.Tensor(X_RG, dtype=core.float64)
        given = {
            "depth_scale": 1.0,
            "depth_max": far,
            "trunc_voxel_multiplier": TRUNCATION_VOXELS,
        }
        blocks = grid.compute_unique_block_coordinates(depth, K, pose, **given)
        grid.integrate(blocks, depth, K, pose, **given)
    found = grid.extract_triangle_mesh(weight_threshold=MIN_WEIGHT)
    seconds = process_time() - begin
    vertices, faces = found.vertex.positions.numpy(), found.triangle.indices.numpy()
    return trimesh.Trimesh(vertices.astype(np.float64), faces, process=False), seconds


def _colmap(
    frames: Frames, rig: RectifiedRig, config: Config, voxel_m: float
) -> tuple[trimesh.Trimesh, float]:
    try:
        import pycolmap
    except ImportError as error:
        raise NotHereError(f"missing ({error}); pip install polhode[mapping-peers]") from error
    with TemporaryDirectory() as scratch:
        write_workspace(Path(scratch), frames, rig)
        begin = process_time()
        mesh = trimesh.load_mesh(fuse_and_mesh(pycolmap, Path(scratch), int(MIN_WEIGHT)), process=False)
        seconds = process_time() - begin
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False), seconds


METHODS: dict[str, Method] = {
    "ours": _ours,
    "ours again": _ours_again,
    "open3d": _open3d,
    "colmap": _colmap,
}


def run_method(method: str, inputs: Path, output: Path) -> None:
    """One method in a process of its own: mesh and figures to ``output``."""
    torch.set_num_threads(1)
    frames, rig, config, voxel_m = pickle.loads(inputs.read_bytes())
    run = METHODS[method]
    try:
        # each three times, so that every method makes a surface
        run([frame for frame in frames[:3] for _ in range(3)], rig, config, voxel_m)
        gc.collect()
        # writing 5 forgets the peak (man 5 proc)
        Path("/proc/self/clear_refs").write_text("5")
        before = memory_mib("VmRSS")
        mesh, seconds = run(frames, rig, config, voxel_m)
        peak = memory_mib("VmHWM") - before
        seconds = min(seconds, run(frames, rig, config, voxel_m)[1])
    except NotHereError as error:
        output.write_bytes(pickle.dumps({"missing": str(error)}))
        return
    output.write_bytes(
        pickle.dumps(
            {
                "vertices": np.asarray(mesh.vertices),
                "faces": np.asarray(mesh.faces),
                "seconds": seconds,
                "mib": peak,
            }
        )
    )


def memory_mib(name: str) -> float:
    """Of this process, as Linux counts it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024.0


def measure(folder: Path, config: Config) -> list[dict[str, Any]]:
    """One row a method, of one sequence."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    rectifier, X_NG = make_rectifier(sequence.calibration), true_poses(sequence, truth)
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ X_NG
    maps = depth_maps(sequence, rectifier, X_RG, np.asarray(truth.mesh.vertices), config)
    frames = list(zip(maps, X_RG, strict=True))
    voxel_m = choose_voxel_m([frame for frame, _ in frames[:5]], rectifier.rig, config.mapping)
    points = seen_truth(truth.mesh, X_NG, sequence, 3)
    rows = []
    with TemporaryDirectory() as scratch:
        inputs, output = Path(scratch, "inputs"), Path(scratch, "output")
        inputs.write_bytes(pickle.dumps((frames, rectifier.rig, config, voxel_m)))
        for method in METHODS:
            command = [
                sys.executable,
                "-m",
                "benchmarks.mapping.fusion_peers",
                "--worker",
                method,
                str(inputs),
                str(output),
            ]
            subprocess.run(command, check=True, env=_one_core())
            found = pickle.loads(output.read_bytes())
            row = {
                "sequence": folder.name,
                "frames": len(frames),
                "voxel_mm": voxel_m * 1e3,
                "method": method,
            }
            if "missing" in found:
                rows.append(row | {"missing": found["missing"]})
                continue
            mesh = trimesh.Trimesh(found["vertices"], found["faces"], process=False)
            metrics = compare_surfaces(mesh, truth.mesh, points)
            rows.append(
                row
                | {
                    "chamfer_mm": metrics.chamfer_mm,
                    "accuracy_mm": metrics.accuracy_mm,
                    "completion_mm": metrics.completion_mm,
                    "within_3mm": metrics.completeness_3mm,
                    "faces": len(mesh.faces),
                    "frame_s": found["seconds"] / len(frames),
                    "mib": found["mib"],
                }
            )
    return rows


def _one_core() -> dict[str, str]:
    return os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TBB_NUM_THREADS"), "1")


def print_rows(rows: list[dict[str, Any]]) -> None:
    """One line a method."""
    for r in rows:
        head = f"{r['sequence']:<16}{r['frames']:>7}{r['voxel_mm']:>10.2f}  {r['method']:<12}"
        if "missing" in r:
            print(f"{head}{r['missing']}", flush=True)
            continue
        print(
            f"{head}{r['chamfer_mm']:>9.3f}{r['accuracy_mm']:>10.3f}{r['completion_mm']:>12.3f}"
            f"{r['within_3mm']:>9.3f}{r['faces']:>10}{r['frame_s']:>12.4f}{r['mib']:>8.0f}",
            flush=True,
        )


def main(
    sequences: Sequences = (),
    short: Short = False,
    config: Annotated[Path, arg(help="Configuration.")] = Path("configs/default.yaml"),
    worker: Annotated[
        tuple[str, str, str] | None,
        arg(metavar="METHOD IN OUT", help="One method; for the process of its own."),
    ] = None,
) -> None:
    """Command line."""
    if worker:
        run_method(worker[0], Path(worker[1]), Path(worker[2]))
        return
    torch.set_num_threads(1)
    settings = load_config(config)
    folders = sequences or ([Path("sample")] if short else SEQUENCES)
    print(
        f"{'sequence':<16}{'frames':>7}{'voxel mm':>10}  {'method':<12}{'chamfer':>9}{'accuracy':>10}"
        f"{'completion':>12}{'3 mm':>9}{'faces':>10}{'s/frame':>12}{'MiB':>8}"
    )
    for folder in folders:
        print_rows(measure(folder, settings))


if __name__ == "__main__":
    command(main)
