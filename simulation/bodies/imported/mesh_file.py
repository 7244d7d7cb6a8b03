"""A body from a mesh file: with the colours of the file, or with materials and charts chosen for its pieces.

Materials are chosen by the names in the file, by the gloss that it states, or at random.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from polhode.records import Ints
from polhode.simulation.bodies.imported.colours import Look, look_of
from polhode.simulation.bodies.imported.reading import FilePiece, read_pieces
from polhode.simulation.bodies.parts.facets import flat_regions
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.textures.by_material import dressed, texel_for
from polhode.simulation.bodies.textures.part_builder import Studio
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    DARK_METAL,
    FOIL_BLACK,
    FOIL_GOLD,
    FOIL_SILVER,
    GLASS,
    PAINT_BLACK,
    PAINT_GREY,
    PAINT_WHITE,
    REGOLITH,
    SOLAR_CELL,
    WORN_PANEL,
    Material,
)

NAMES: tuple[tuple[str, Material], ...] = (
    (r"radiator|osr", PAINT_WHITE),
    (r"asteroid|comet|rock|regolith|terrain|lunar|moon|eros|itokawa|bennu|ryugu|67p", REGOLITH),
    (r"nozzle|engine|thruster|thr_|bell", DARK_METAL),
    (r"silver.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*silver", FOIL_SILVER),
    (r"black.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*black", FOIL_BLACK),
    (r"mli|foil|kapton|gold|blanket|insulat", FOIL_GOLD),
    (r"white|dish|antenna|reflector", PAINT_WHITE),
    (r"solar|cell|panel|array", SOLAR_CELL),
    (r"glass|lens|optic|camera|window", GLASS),
    (r"black", PAINT_BLACK),
    (r"gr[ae]y|paint", PAINT_GREY),
    (r"metal|alumin|steel|titan|strut|truss|boom|mast|hinge|rail|bolt", BRUSHED_METAL),
)
"""The first pattern that is found in a piece's name, in any case of letters, decides."""
CHOICES = (WORN_PANEL, WORN_PANEL, PAINT_WHITE, PAINT_GREY, BRUSHED_METAL)
"""Materials of separate pieces without a telling name; the largest is a worn panel, which has texture."""


MOST_PIECES = 40
"""Separate pieces with a material of their own; smaller ones are grey."""
ROCK_FACES = 2000
"""A closed piece of more faces than this and no flat side is taken for a rock."""


def material_by_name(name: str) -> Material | None:
    """The material that a name tells of, or none."""
    for pattern, material in NAMES:
        if re.search(pattern, name, re.IGNORECASE):
            return material
    return None


def material_by_chance(largest: bool, rng: np.random.Generator) -> Material:
    """One of ``CHOICES``."""
    return WORN_PANEL if largest else CHOICES[int(rng.integers(len(CHOICES)))]


def material_with_look(material: Material, look: Look) -> Material:
    """The material with the file's own colour, metalness and roughness where it gives them.

    Metals reflect their colour at normal incidence and have little diffuse reflectance, as in glTF's model.
    """
    if look.roughness is not None:
        material = replace(material, roughness=float(np.clip(look.roughness, 0.1, 1.0)))
    if look.metallic is not None:
        metal = float(np.clip(look.metallic, 0.0, 1.0))
        colour = 0.5 if look.reflectance is None else look.reflectance
        specular = 0.04 * (1.0 - metal) + colour * metal
        return replace(material, specular=specular, albedo=max(colour * (1.0 - metal), 0.01), patch=0.0)
    if look.reflectance is None:
        return material
    if material.specular > 0.2:
        # A shiny material by its name: the colour is that of its reflection.
        return replace(material, specular=float(np.clip(look.reflectance, 0.2, 0.9)))
    return replace(material, albedo=float(np.clip(look.reflectance, 0.01, 0.95)), patch=0.0)


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
