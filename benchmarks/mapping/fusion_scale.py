"""The field's memory and time over sizes: a 0.3 m body at 1 mm, a craft of 10 m with panels at 5 mm.

    python -m benchmarks.mapping.fusion_scale              both
    python -m benchmarks.mapping.fusion_scale --short      the small one, 20 frames

Depth maps of 640x480 are cast from the solids, with independent noise of half a voxel; the camera looks from
close by at places spread over the surface, so no frame holds the whole of the large one. Each runs in a
process of its own. Field: the blocks of voxels; peak: by how much the process's peak, with the frames that
wait, the mesh and what makes it, exceeds what it held before.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import trimesh
from tyro.conf import arg

from benchmarks.command import command, in_process
from benchmarks.mapping.fusion_peers import memory_mib
from benchmarks.presentation import print_table
from polhode.camera import RectifiedRig
from polhode.config.mapping_settings import Mapping
from polhode.lie import Array, inverse_pose, make_pose
from polhode.mapping.fusion.field import Field
from polhode.mapping.visibility import Caster
from polhode.mesh_metrics import distance_to_surface, sample_surface
from polhode.records import DepthMap

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)


@dataclass(frozen=True)
class FusionCase:
    """A solid, the edge of a voxel and how it is looked at."""

    voxel_m: float
    distance_m: float
    frames: int
    memory_mib: float


CASES = {"0.3 m": FusionCase(1e-3, 0.5, 60, 1024.0), "10 m": FusionCase(5e-3, 3.0, 300, 4096.0)}


def solid(name: str) -> trimesh.Trimesh:
    """A box of 0.3 m across; or a bus with two panels, 10 m from tip to tip."""
    if name == "0.3 m":
        box: trimesh.Trimesh = trimesh.creation.box((0.2, 0.18, 0.14))
        return box
    parts = [trimesh.creation.box((3.0, 2.0, 2.0))]
    for side in (-1.0, 1.0):
        panel = trimesh.creation.box((3.5, 1.6, 0.04))
        panel.apply_translation([side * 3.25, 0.0, 0.0])
        parts.append(panel)
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + 8 * k for k, part in enumerate(parts)])
    return trimesh.Trimesh(vertices, faces, process=False)


def view(
    mesh: trimesh.Trimesh,
    caster: Caster,
    place: Array,
    normal: Array,
    case: FusionCase,
    rng: np.random.Generator,
) -> tuple[DepthMap, Array]:
    """Depth from above a place of the surface, somewhat to the side, with the pose of the body."""
    away = normal + 0.4 * rng.normal(size=3)
    eye = place + case.distance_m * away / np.linalg.norm(away)
    z = (place - eye) / np.linalg.norm(place - eye)
    x = np.cross(np.roll(np.abs(z), 1) + 1e-3, z)
    x /= np.linalg.norm(x)
    X_GR = make_pose(np.stack([x, np.cross(z, x), z], axis=1), eye)
    v, u = np.mgrid[: RIG.height_px, : RIG.width_px]
    rays = np.stack(
        [(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones(u.shape)], axis=-1
    ).reshape(-1, 3)
    length = np.linalg.norm(rays, axis=1)
    found, _ = caster.first(eye, (rays / length[:, None]) @ X_GR[:3, :3].T)
    sigma_m = 0.5 * case.voxel_m
    depth = (found / length + rng.normal(0.0, sigma_m, len(found))).reshape(v.shape)
    seen = np.isfinite(depth)
    return DepthMap(
        depth_m=np.where(seen, depth, np.nan).astype(np.float32),
        sigma_m=np.where(seen, sigma_m, np.nan).astype(np.float32),
        intensity=np.where(seen, 150, 0).astype(np.uint8),
        target=seen,
    ), inverse_pose(X_GR)


def measure(name: str, frames: int) -> list[object]:
    """One row of the table."""
    case, mesh = CASES[name], solid(name)
    caster, rng = Caster(mesh), np.random.default_rng(0)
    places, normals = sample_surface(mesh, frames)
    config = Mapping(voxel_mm=case.voxel_m * 1e3, memory_mib=case.memory_mib, device="cpu")
    # a little one first, so that what is compiled does not count
    warm = Field(RIG, config, case.voxel_m)
    warm.add(*view(mesh, caster, places[0], normals[0], case, rng))
    warm.surface()
    del warm
    Path("/proc/self/clear_refs").write_text("5")
    before, seconds = memory_mib("VmRSS"), 0.0
    field = Field(RIG, config, case.voxel_m, kept_mib=256.0)
    for place, normal in zip(places, normals, strict=True):
        frame = view(mesh, caster, place, normal, case, rng)
        begin = process_time()
        field.add(*frame)
        seconds += process_time() - begin
    begin = process_time()
    surface = field.surface()
    seconds += process_time() - begin
    peak = memory_mib("VmHWM") - before
    points, _ = sample_surface(surface.mesh, 20_000)
    off = distance_to_surface(mesh, points) / case.voxel_m
    warnings = "; ".join(surface.warnings) or "none"
    sizes = (f"{field.bytes / 2**20:.0f}", f"{peak:.0f}", len(surface.mesh.faces))
    errors = (f"{np.mean(off):.2f}", f"{seconds / frames:.3f}", warnings)
    return [name, f"{case.voxel_m * 1e3:.1f}", frames, *sizes, *errors]


def main(
    short: Annotated[bool, arg(help="The small one, 20 frames.")] = False,
    worker: Annotated[
        tuple[str, int] | None, arg(metavar="NAME FRAMES", help="One body; for the process of its own.")
    ] = None,
) -> None:
    """Command line."""
    if worker:
        print(json.dumps(measure(*worker)))
        return
    frames = {"0.3 m": 20} if short else {name: case.frames for name, case in CASES.items()}
    head = "body | voxel mm | frames | field MiB | peak MiB | faces | error in voxels | s/frame | warnings"
    worker_module = "benchmarks.mapping.fusion_scale"
    print_table(head, (in_process(worker_module, "--worker", *each) for each in frames.items()))


if __name__ == "__main__":
    command(main)
