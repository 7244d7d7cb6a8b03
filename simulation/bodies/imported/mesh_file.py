"""A body from any mesh file: its own colours where it has them, else materials and drawings chosen for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from polhode.records import Ints
from polhode.simulation.bodies.imported.mesh_colours import Look, look_of
from polhode.simulation.bodies.imported.mesh_materials import (
    material_by_chance,
    material_by_name,
    material_with_look,
)
from polhode.simulation.bodies.imported.mesh_reading import FilePiece, read_pieces
from polhode.simulation.bodies.parts.facets import flat_regions
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.textures.dressing import dressed, texel_for
from polhode.simulation.bodies.textures.studio import Studio
from polhode.simulation.surface.materials import PAINT_GREY, REGOLITH, Material

MOST_PIECES = 40
"""Separate pieces with a material of their own; smaller ones are grey."""
ROCK_FACES = 2000
"""A closed piece of more faces than this and no flat side is taken for a rock."""


def mesh_file_parts(path: Path, metres_per_unit: float, studio: Studio) -> list[Part]:
    """Parts of a mesh file. Raises InputError, one line, when it holds nothing usable."""
    pieces = read_pieces(path, metres_per_unit)
    studio = replace(studio, texel_m=texel_for(sum(float(piece.mesh.area) for piece in pieces)))
    glb = path.suffix.lower() in (".glb", ".gltf")
    parts: list[Part] = []
    for piece in sorted(pieces, key=lambda piece: -piece.mesh.area):
        parts += _parts_of_piece(piece, look_of(piece, glb), path.stem, not parts, studio)
    return parts


def _parts_of_piece(piece: FilePiece, look: Look, stem: str, first: bool, studio: Studio) -> list[Part]:
    """A piece by its name, by its own colours, or torn into what hangs together."""
    named = material_by_name(piece.name) or material_by_name(stem)
    if look.colours is not None:
        # The file's colours are the texture: none of ours on top.
        plain = replace(named or PAINT_GREY, grain=0.0, patch=0.0)
        material = material_with_look(plain, look)
        return [Part(piece.mesh, material, name=piece.label, colours=look.colours)]
    if named is not None:
        return [_dressed_part(piece.mesh, material_with_look(named, look), piece.label, studio)]
    parts = []
    for order, faces in enumerate(_islands(piece.mesh)):
        island = trimesh.Trimesh(piece.mesh.vertices, piece.mesh.faces[faces], process=False)
        island.remove_unreferenced_vertices()
        if _is_rock(island):
            material = REGOLITH
        elif order < MOST_PIECES:
            material = material_by_chance(first and order == 0, studio.rng)
        else:
            material = PAINT_GREY
        parts.append(_dressed_part(island, material_with_look(material, look), piece.label, studio))
    return parts


def _dressed_part(mesh: trimesh.Trimesh, material: Material, name: str, studio: Studio) -> Part:
    return Part(mesh, material, dressed(mesh, material, studio, studio.texel_m), name=name)


def _islands(mesh: trimesh.Trimesh) -> list[Ints]:
    """Faces that hang together, one array an island, the largest first."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    order = np.argsort(labels, kind="stable")
    islands = np.split(order, np.cumsum(np.bincount(labels))[:-1])
    return [islands[label] for label in np.argsort(-area, kind="stable")]


def _is_rock(mesh: trimesh.Trimesh) -> bool:
    return len(mesh.faces) > ROCK_FACES and mesh.is_watertight and not flat_regions(mesh, 0.002 * mesh.area)
