"""Eight lengths of the free flyer, measured on a mesh and on the true one (as table 6.3 of the thesis).

    python -m lab.mapping.lengths [RUN SEQ]      a run of configs/ts38.yaml (runs/ts38, data/ts38)

A length is the distance between two parallel faces of the body. On the true mesh a face is what lies in one
plane and is free of other parts within 2 mm. On the estimated mesh, which the motion alone brings into the
true frame, a plane is fitted to where rays onto that face meet the surface; the length is the distance of the
two planes at the middle of the faces.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from tyro.conf import Positional

from lab.command import command
from lab.mapping.mesh_quality import run_poses, true_poses
from lab.presentation import print_table
from polhode.geometry.lie import Array
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.visibility import Caster
from polhode.records.dataset import open_sequence
from polhode.records.read_truth import read_truth
from polhode.report.evaluation import between_target_frames
from polhode.runtime.errors import InputError

SAMPLES = 4000
"""Points drawn on a face."""
CLEAR_M = 2e-3
"""Nearer to another part no point of a face is used."""
REACH_M = 4e-3
"""The estimated surface is looked for so far on either side of the true face."""
FLAT_M = 5e-5
"""Points of a face are so near to its plane."""
MIN_RAYS = 60
"""Rays that must meet the estimated surface."""


@dataclass(frozen=True)
class Face:
    """A plane of the body, by a point on it and its outward normal, in the true G, lengths in mm."""

    point_mm: tuple[float, float, float]
    normal: tuple[float, float, float]


@dataclass(frozen=True)
class Length:
    """Between two faces that look away from each other."""

    name: str
    one: Face
    other: Face


S = 0.5**0.5
LENGTHS = (
    Length("largest extent along x", Face((114, 22, -14), (1, 0, 0)), Face((-114, -18, 20), (-1, 0, 0))),
    Length("largest extent along y", Face((4, 117, 8), (0, 1, 0)), Face((0, -110, 0), (0, -1, 0))),
    Length("shell across z", Face((0, 0, 110), (0, 0, 1)), Face((0, 0, -110), (0, 0, -1))),
    Length("shell across x", Face((110, 0, 0), (1, 0, 0)), Face((-110, 0, 0), (-1, 0, 0))),
    Length("bevels across x + y", Face((84.8, 84.8, 0), (S, S, 0)), Face((-84.8, -84.8, 0), (-S, -S, 0))),
    Length("bevels across y + z", Face((0, 84.8, 84.8), (0, S, S)), Face((0, -84.8, -84.8), (0, -S, -S))),
    Length("port, width", Face((26, 113.5, 8), (1, 0, 0)), Face((-18, 113.5, 8), (-1, 0, 0))),
    Length("port, height", Face((4, 113.5, 43), (0, 0, 1)), Face((4, 113.5, -27), (0, 0, -1))),
)


@dataclass(frozen=True)
class MeasuredLength:
    """One line of the table [mm]."""

    name: str
    true_mm: float
    found_mm: float | None
    """None: too little of a face is in the mesh"""
    points: int
    """of the face with fewer of them"""


def measure(estimate: trimesh.Trimesh, truth: trimesh.Trimesh) -> list[MeasuredLength]:
    """All lengths on a mesh in the true frame G, both in metres."""
    true, found = Caster(truth), Caster(estimate)
    rows = []
    for length in LENGTHS:
        ends = [_offset(true, found, truth, face) for face in (length.one, length.other)]
        along = np.array(length.one.normal)
        true_mm = float(along @ (np.array(length.one.point_mm) - np.array(length.other.point_mm)))
        points = min(count for _, count in ends)
        known = points >= MIN_RAYS
        rows.append(
            MeasuredLength(
                length.name, true_mm, true_mm + sum(off for off, _ in ends) / 1e-3 if known else None, points
            )
        )
    return rows


def _offset(true: Caster, found: Caster, truth: trimesh.Trimesh, face: Face) -> tuple[float, int]:
    """How far outside of the true face the estimated one is, at its middle [m], and the rays that met it."""
    normal = np.array(face.normal) / np.linalg.norm(face.normal)
    points = _clear_points(true, truth, np.array(face.point_mm) * 1e-3, normal)
    distance, _ = found.first(points + REACH_M * normal, np.broadcast_to(-normal, points.shape))
    off = REACH_M - distance
    met = np.abs(off) < REACH_M
    if met.sum() < MIN_RAYS:
        return np.nan, int(met.sum())
    across = np.linalg.svd(normal[None])[2][1:]
    design = np.column_stack([np.ones(len(points)), (points - points.mean(axis=0)) @ across.T])
    kept = met.copy()
    for _ in range(5):
        plane = np.linalg.lstsq(design[kept], off[kept], rcond=None)[0]
        rest = np.abs(off - design @ plane)
        kept = met & (rest < 3.0 * 1.4826 * np.median(rest[kept]) + 1e-6)
    return float(plane[0]), int(kept.sum())


def _clear_points(true: Caster, truth: trimesh.Trimesh, point: Array, normal: Array) -> Array:
    """Points (n, 3) of the face that holds ``point``, away from its rims and from other parts."""
    corners = np.asarray(truth.triangles)
    flat = (np.asarray(truth.face_normals) @ normal > 0.999) & (
        np.abs((corners - point) @ normal).max(axis=1) < FLAT_M
    )
    if not flat.any():
        raise InputError(
            "the true mesh has no such face: these lengths are those of configs/ts38.yaml's body"
        )
    face = truth.submesh([np.flatnonzero(flat)], append=True)
    points = np.asarray(trimesh.sample.sample_surface(face, SAMPLES, seed=0)[0])
    across = np.linalg.svd(normal[None])[2][1:]
    clear = np.ones(len(points), dtype=bool)
    for angle in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        beside = points + CLEAR_M * (np.cos(angle) * across[0] + np.sin(angle) * across[1])
        # from far outside: what stands on the face is met first
        far = 2.0 * true.radius_m
        distance, _ = true.first(beside + far * normal, np.broadcast_to(-normal, points.shape))
        clear &= np.abs(distance - far) < FLAT_M
    return points[clear]


def in_true_frame(run: Path, folder: Path) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A run's mesh, brought into the true G by the motion, and the true mesh."""
    sequence, truth = open_sequence(folder), read_truth(folder)
    if truth.mesh is None:
        raise InputError(f"{folder}: this sequence has no true surface")
    mesh = read_ply(run / "mesh.ply").mesh
    mesh.apply_transform(between_target_frames(run_poses(run), true_poses(sequence, truth), mesh.centroid))
    return mesh, truth.mesh


def print_lengths(rows: list[MeasuredLength]) -> None:
    """One line for each length, and the mean of the errors."""
    cells: list[list[object]] = []
    errors = []
    for row in rows:
        found = ["not in the mesh", ""]
        if row.found_mm is not None:
            errors.append(row.found_mm - row.true_mm)
            found = [f"{row.found_mm:.2f}", f"{errors[-1]:+.2f}"]
        cells.append([row.name, f"{row.true_mm:.2f}", *found, row.points])
    print_table("length | true mm | mesh mm | error mm | points", cells)
    if errors:
        size = np.abs(errors)
        print(
            f"mean absolute error {size.mean():.2f} mm, standard deviation {size.std():.2f} mm, "
            f"largest {size.max():.2f} mm, of {len(size)} lengths (thesis: 1.83, 1.13 mm)"
        )


def main(run: Positional[Path] = Path("runs/ts38"), sequence: Positional[Path] = Path("data/ts38")) -> None:
    """Measure and print the table."""
    print_lengths(measure(*in_true_frame(run, sequence)))


if __name__ == "__main__":
    command(main)
