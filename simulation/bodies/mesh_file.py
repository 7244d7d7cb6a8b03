"""A body from any mesh file, with materials chosen for it."""

from pathlib import Path

import numpy as np
import trimesh

from polhode.errors import InputError
from simulation.bodies.part import Part, join
from simulation.materials import BRUSHED_METAL, PAINT_GREY, PAINT_WHITE, WORN_PANEL, Material

CHOICES = (WORN_PANEL, WORN_PANEL, PAINT_WHITE, PAINT_GREY, BRUSHED_METAL)
"""Materials of the separate pieces; the largest piece is always a worn panel, which has texture."""
LARGEST_PIECES = 40


def mesh_file_parts(path: Path, metres_per_unit: float, rng: np.random.Generator) -> list[Part]:
    """Parts of a mesh file, one per material; raises InputError when it holds nothing usable."""
    mesh = _load(path)
    mesh.apply_scale(metres_per_unit)
    pieces = sorted(mesh.split(only_watertight=False), key=lambda piece: -piece.area)
    if not pieces:
        return [Part(mesh, WORN_PANEL)]
    by_material: dict[Material, list[trimesh.Trimesh]] = {}
    for order, piece in enumerate(pieces):
        chosen = WORN_PANEL if order == 0 else CHOICES[int(rng.integers(len(CHOICES)))]
        by_material.setdefault(chosen if order < LARGEST_PIECES else PAINT_GREY, []).append(piece)
    return [Part(join(group), material) for material, group in by_material.items()]


def _load(path: Path) -> trimesh.Trimesh:
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file; give body.path relative to the working directory")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except (ValueError, TypeError, KeyError, IndexError, NotImplementedError) as error:
        raise InputError(f"{path}: cannot be read as a mesh ({error}); give OBJ, STL, PLY or GLB") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"{path}: the mesh has no faces; export it as triangles")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: the mesh has vertices that are not finite; repair it")
    # Exporters split vertices at seams of normals and textures; a piece is what hangs together in space.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    return mesh
