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
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Annotated, Any

import cv2
import numpy as np
import trimesh
from tyro.conf import arg

from benchmarks.command import DEFAULT, Configuration, Sequences, Short, command
from benchmarks.mapping.mesh_quality import depth_maps, true_poses
from benchmarks.presentation import numbers, print_table
from polhode.camera import RectifiedRig
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.frontend.rectification import make_rectifier
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, wxyz_from_matrix
from polhode.mapping.fusion.block_grid import TRUNCATION_VOXELS
from polhode.mapping.fusion.field import Field, choose_voxel_m, fuse
from polhode.mesh_metrics import compare_surfaces
from polhode.pipeline.evaluation import seen_truth
from polhode.pipeline.run_directory.archives import load_archive, write_arrays
from polhode.records import DepthMap
from polhode.truth import read_truth

_STEP_PX = 2
"""Between the points whose differences make a normal."""
_MARKS = 60
"""Points of each frame that tell COLMAP which frames see the same."""
_OCTREE = 10
"""Depth: cells of a thousandth of the body"""
_AGREE = 0.02
"""Of the depth, within which another frame sees such a point."""


def write_workspace(folder: Path, frames: list[tuple[DepthMap, Array]], rig: RectifiedRig) -> None:
    """Images, sparse model, depth and normal maps of frames (depth, X_RG) as COLMAP reads them."""
    for name in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (folder / name).mkdir(parents=True)
    names = [f"{k:04d}.png" for k in range(len(frames))]
    for name, (depth, _) in zip(names, frames, strict=True):
        cv2.imwrite(str(folder / "images" / name), depth.intensity)
        z = np.where(np.isfinite(depth.depth_m) & (depth.depth_m > 0), depth.depth_m, 0.0)
        normals = normals_of(z, rig)
        z = np.where(np.any(normals != 0.0, axis=2), z, 0.0)
        _write_map(folder / "stereo" / "depth_maps" / f"{name}.geometric.bin", z[..., None])
        _write_map(folder / "stereo" / "normal_maps" / f"{name}.geometric.bin", normals)
    (folder / "stereo" / "fusion.cfg").write_text("".join(f"{name}\n" for name in names))
    _write_model(folder / "sparse", names, frames, rig)


def normals_of(z: Array, rig: RectifiedRig) -> Array:
    """(H, W, 3) unit normals towards the camera, in its axes, of depth (H, W), 0 where unknown."""
    v, u = np.mgrid[: z.shape[0], : z.shape[1]]
    ray = np.stack(
        [(u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones(z.shape)], axis=-1
    )
    inverse = np.where(z > 0, 1.0 / np.maximum(z, 1e-9), np.nan)
    n, out = _STEP_PX, np.zeros((*z.shape, 3))
    # 1/z is linear in the pixels of a plane, and its slope and value are the normal
    du = np.full(z.shape, np.nan)
    dv = du.copy()
    du[:, n:-n] = (inverse[:, 2 * n :] - inverse[:, : -2 * n]) / (2 * n)
    dv[n:-n] = (inverse[2 * n :] - inverse[: -2 * n]) / (2 * n)
    f = rig.focal_px
    normal = np.stack([du * f, dv * f, inverse - du * (u - rig.cx_px) - dv * (v - rig.cy_px)], axis=-1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal *= -np.sign(np.sum(normal * ray, axis=2, keepdims=True))
    known = np.isfinite(normal).all(axis=2)
    out[known] = normal[known]
    return out


def _write_map(path: Path, values: Array) -> None:
    """(H, W, C): a line with the sizes, then floats, one channel after the other."""
    h, w, c = values.shape
    content = np.ascontiguousarray(values.transpose(2, 0, 1), dtype="<f4").tobytes()
    path.write_bytes(f"{w}&{h}&{c}&".encode("ascii") + content)


def _write_model(
    folder: Path, names: list[str], frames: list[tuple[DepthMap, Array]], rig: RectifiedRig
) -> None:
    # COLMAP counts from the corner of a pixel
    camera = f"{rig.focal_px} {rig.focal_px} {rig.cx_px + 0.5} {rig.cy_px + 0.5}"
    (folder / "cameras.txt").write_text(f"1 PINHOLE {rig.width_px} {rig.height_px} {camera}\n")
    seen: list[list[str]] = [[] for _ in frames]
    points, number = [], 0
    rng = np.random.default_rng(0)
    for depth, X_RG in frames:
        v, u = np.nonzero(np.isfinite(depth.depth_m) & (depth.depth_m > 0))
        some = rng.permutation(len(v))[:_MARKS]
        z = depth.depth_m[v[some], u[some]].astype(np.float64)
        p_R = np.stack(
            [(u[some] - rig.cx_px) / rig.focal_px * z, (v[some] - rig.cy_px) / rig.focal_px * z, z], 1
        )
        X_GR = inverse_pose(X_RG)
        p_G = p_R @ X_GR[:3, :3].T + X_GR[:3, 3]
        tracks: list[list[tuple[int, int]]] = [[] for _ in p_G]
        for other, pixels in enumerate(_sights(frames, p_G, rig)):
            for point, (column, row) in pixels.items():
                tracks[point].append((other + 1, len(seen[other])))
                seen[other].append(f"{column + 0.5} {row + 0.5} {number + point + 1}")
        for point, track in enumerate(tracks):
            at = " ".join(str(float(x)) for x in p_G[point])
            points.append(
                f"{number + point + 1} {at} 128 128 128 1 {' '.join(f'{i} {j}' for i, j in track)}\n"
            )
        number += len(p_G)
    (folder / "points3D.txt").write_text("".join(points))
    lines = []
    for k, (name, (_, X_RG)) in enumerate(zip(names, frames, strict=True)):
        q = " ".join(str(float(x)) for x in wxyz_from_matrix(X_RG[:3, :3]))
        t = " ".join(str(float(x)) for x in X_RG[:3, 3])
        lines.append(f"{k + 1} {q} {t} 1 {name}\n{' '.join(seen[k])}\n")
    (folder / "images.txt").write_text("".join(lines))


def _sights(
    frames: list[tuple[DepthMap, Array]], p_G: Array, rig: RectifiedRig
) -> list[dict[int, tuple[int, int]]]:
    """For each frame, the points (n, 3) that its depth agrees with, and their pixels (column, row)."""
    found = []
    for depth, X_RG in frames:
        p = p_G @ X_RG[:3, :3].T + X_RG[:3, 3]
        u = np.rint(rig.focal_px * p[:, 0] / p[:, 2] + rig.cx_px).astype(int)
        v = np.rint(rig.focal_px * p[:, 1] / p[:, 2] + rig.cy_px).astype(int)
        h, w = depth.depth_m.shape
        inside = (p[:, 2] > 0) & (u >= 0) & (u < w) & (v >= 0) & (v < h)
        z = np.where(inside, depth.depth_m[np.where(inside, v, 0), np.where(inside, u, 0)], np.nan)
        near = np.abs(z - p[:, 2]) < _AGREE * p[:, 2]
        found.append({int(n): (int(u[n]), int(v[n])) for n in np.flatnonzero(near)})
    return found


def fuse_and_mesh(pycolmap: Any, folder: Path, least_pixels: int) -> Path:
    """The mesh that COLMAP makes of a workspace: points on which ``least_pixels`` frames agree, then Poisson.

    Of so few points its default, which trims what is sparser than an octree of depth 10, leaves nothing. So
    nothing is trimmed, and the mesh is closed over what nobody saw, too.
    """
    options = pycolmap.StereoFusionOptions()
    options.num_threads, options.min_num_pixels = 1, least_pixels
    points, mesh = folder / "fused.ply", folder / "mesh.ply"
    pycolmap.stereo_fusion(points, folder, input_type="geometric", output_type="ply", options=options)
    poisson = pycolmap.PoissonMeshingOptions()
    poisson.num_threads, poisson.depth, poisson.trim = 1, _OCTREE, 0.0
    pycolmap.poisson_meshing(points, mesh, poisson)
    return mesh


SEQUENCES = [Path("data") / name for name in ("ts38", "asteroid", "major_axis", "specular_mli")]
MIN_WEIGHT = 3.0
"""Of a voxel of Open3D; every frame adds one."""
Frames = list[tuple[DepthMap, Array]]
Method = Callable[[Frames, RectifiedRig, Config, float], tuple[trimesh.Trimesh, float]]
"""Mesh, and seconds that the frames took"""


_DEPTH = tuple(each.name for each in fields(DepthMap))


class NotHereError(Exception):
    """A peer that is not installed or does not run on this machine."""


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
    frames, rig, config, voxel_m = read_inputs(inputs)
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
        write_arrays(output, {"missing": np.asarray(str(error))})
        return
    found = {"vertices": mesh.vertices, "faces": mesh.faces, "seconds": seconds, "mib": peak}
    write_arrays(output, {name: np.asarray(value) for name, value in found.items()})


def write_inputs(path: Path, frames: Frames, rig: RectifiedRig, config: Config, voxel_m: float) -> None:
    """What a method gets, as named arrays, so that the process that reads them executes nothing."""
    stacked = {name: np.stack([getattr(depth, name) for depth, _ in frames]) for name in _DEPTH}
    numbers = {f"rig_{each.name}": np.asarray(getattr(rig, each.name)) for each in fields(rig)}
    stacked |= {"X_RG": np.stack([X_RG for _, X_RG in frames]), "voxel_m": np.asarray(voxel_m)}
    write_arrays(path, {**stacked, **numbers, "config": np.asarray(config.model_dump_json())})


def read_inputs(path: Path) -> tuple[Frames, RectifiedRig, Config, float]:
    """What ``write_inputs`` wrote."""
    arrays = load_archive(path, path.name).arrays
    frames = [
        (DepthMap(*maps), X_RG)
        for *maps, X_RG in zip(*(arrays[name] for name in (*_DEPTH, "X_RG")), strict=True)
    ]
    rig = RectifiedRig(**{each.name: arrays[f"rig_{each.name}"].item() for each in fields(RectifiedRig)})
    return frames, rig, Config.model_validate_json(str(arrays["config"])), float(arrays["voxel_m"])


def read_result(path: Path) -> dict[str, Any]:
    """Mesh and figures of a method, or under ``missing`` why there are none."""
    return load_archive(path, path.name).arrays


def memory_mib(name: str) -> float:
    """Of this process, as Linux counts it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024.0


def measure(folder: Path, config: Config) -> Iterator[list[object]]:
    """One row for each method, of one sequence."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise SystemExit(f"{folder}: this sequence has no true surface")
    rectifier, X_NG = make_rectifier(sequence.calibration), true_poses(sequence, truth)
    X_RG = inverse_pose(sequence.X_NC @ rectifier.X_CR) @ X_NG
    maps = depth_maps(sequence, rectifier, X_RG, np.asarray(truth.mesh.vertices), config)
    frames = list(zip(maps, X_RG, strict=True))
    voxel_m = choose_voxel_m([frame for frame, _ in frames[:5]], rectifier.rig, config.mapping)
    points = seen_truth(truth.mesh, X_NG, sequence, 3)
    with TemporaryDirectory() as scratch:
        inputs, output = Path(scratch, "inputs.npz"), Path(scratch, "output.npz")
        write_inputs(inputs, frames, rectifier.rig, config, voxel_m)
        for method in METHODS:
            words = [sys.executable, "-m", "benchmarks.mapping.fusion_peers", "--worker", method]
            subprocess.run([*words, str(inputs), str(output)], check=True, env=_one_core())
            found = read_result(output)
            name = [folder.name, len(frames), f"{voxel_m * 1e3:.2f}", method]
            yield [*name, *cells(found, truth.mesh, points, len(frames))]


def cells(found: dict[str, Any], truth: trimesh.Trimesh, points: Array, frames: int) -> list[object]:
    """Of the result of a method, or why there is none."""
    if "missing" in found:
        return [str(found["missing"]), *[""] * 6]
    mesh = trimesh.Trimesh(found["vertices"], found["faces"], process=False)
    m = compare_surfaces(mesh, truth, points)
    distances = numbers((m.chamfer_mm, m.accuracy_mm, m.completion_mm, m.completeness_3mm), ".3f")
    seconds, mib = float(found["seconds"]) / frames, float(found["mib"])
    return [*distances, len(mesh.faces), f"{seconds:.4f}", f"{mib:.0f}"]


def _one_core() -> dict[str, str]:
    return os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TBB_NUM_THREADS"), "1")


def main(
    sequences: Sequences = (),
    short: Short = False,
    config: Configuration = DEFAULT,
    worker: Annotated[
        tuple[str, str, str] | None,
        arg(metavar="METHOD IN OUT", help="One method; for the process of its own."),
    ] = None,
) -> None:
    """Measure and print the table."""
    if worker:
        run_method(worker[0], Path(worker[1]), Path(worker[2]))
        return
    settings = load_config(config)
    folders = sequences or ([Path("sample")] if short else SEQUENCES)
    head = (
        "sequence | frames | voxel mm | method | chamfer | accuracy | completion | within 3 mm "
        "| faces | s/frame | MiB"
    )
    print_table(head, (row for folder in folders for row in measure(folder, settings)))


if __name__ == "__main__":
    command(main)
