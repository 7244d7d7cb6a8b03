"""A body from a mesh file: with the colours of the file, or with materials and charts chosen for its pieces.

Materials are chosen by the names in the file, by the gloss that it states, or at random.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from polhode.records import Ints
from polhode.simulation.bodies.imported.colours import FileAppearance, file_appearance
from polhode.simulation.bodies.imported.reading import FilePiece, read_pieces
from polhode.simulation.bodies.parts.facets import flat_regions
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.textures.by_material import charts_for_mesh, texel_size_for
from polhode.simulation.bodies.textures.part_builder import PartBuilder
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
"""The first pattern found in a piece's name, regardless of case, decides."""
CHOICES = (WORN_PANEL, WORN_PANEL, PAINT_WHITE, PAINT_GREY, BRUSHED_METAL)
"""Materials of separate pieces whose names match no pattern; the largest is a worn panel, which has
texture.
"""


MAX_PIECES = 40
"""Maximum number of connected pieces with a material of their own; smaller ones are grey."""
ROCK_FACES = 2000
"""A closed piece with more faces than this and no flat side is taken for a rock."""


def material_by_name(name: str) -> Material | None:
    """The material that a name indicates, or None."""
    for pattern, material in NAMES:
        if re.search(pattern, name, re.IGNORECASE):
            return material
    return None


def random_material(largest: bool, rng: np.random.Generator) -> Material:
    """One of ``CHOICES``."""
    return WORN_PANEL if largest else CHOICES[int(rng.integers(len(CHOICES)))]


def material_with_appearance(material: Material, appearance: FileAppearance) -> Material:
    """The material with the colour, metalness and roughness of the file, as far as given.

    Metals reflect their colour at normal incidence and have little diffuse reflectance, as in glTF's model.
    """
    if appearance.roughness is not None:
        material = replace(material, roughness=float(np.clip(appearance.roughness, 0.1, 1.0)))
    if appearance.metallic is not None:
        metal = float(np.clip(appearance.metallic, 0.0, 1.0))
        colour = 0.5 if appearance.reflectance is None else appearance.reflectance
        specular = 0.04 * (1.0 - metal) + colour * metal
        return replace(material, specular=specular, albedo=max(colour * (1.0 - metal), 0.01), patch=0.0)
    if appearance.reflectance is None:
        return material
    if material.specular > 0.2:
        # A shiny material according to its name: the colour is that of its specular reflection.
        return replace(material, specular=float(np.clip(appearance.reflectance, 0.2, 0.9)))
    return replace(material, albedo=float(np.clip(appearance.reflectance, 0.01, 0.95)), patch=0.0)


def mesh_file_parts(path: Path, metres_per_unit: float, builder: PartBuilder) -> list[Part]:
    """Parts of a mesh file. Raises InputError with one line if it contains nothing usable."""
    pieces = read_pieces(path, metres_per_unit)
    builder = replace(builder, texel_m=texel_size_for(sum(float(piece.mesh.area) for piece in pieces)))
    glb = path.suffix.lower() in (".glb", ".gltf")
    parts: list[Part] = []
    for piece in sorted(pieces, key=lambda piece: -piece.mesh.area):
        parts += _parts_of_piece(piece, file_appearance(piece, glb), path.stem, not parts, builder)
    return parts


def _parts_of_piece(
    piece: FilePiece, appearance: FileAppearance, stem: str, first: bool, builder: PartBuilder
) -> list[Part]:
    """Parts of a piece: by its colours or its name, otherwise one for each connected component."""
    named = material_by_name(piece.name) or material_by_name(stem)
    if appearance.colours is not None:
        # The colours of the file are the texture; none is added.
        plain = replace(named or PAINT_GREY, grain=0.0, patch=0.0)
        material = material_with_appearance(plain, appearance)
        return [Part(piece.mesh, material, name=piece.label, colours=appearance.colours)]
    if named is not None:
        return [
            _part_with_charts(piece.mesh, material_with_appearance(named, appearance), piece.label, builder)
        ]
    parts = []
    for order, faces in enumerate(_connected_pieces(piece.mesh)):
        piece_mesh = trimesh.Trimesh(piece.mesh.vertices, piece.mesh.faces[faces], process=False)
        piece_mesh.remove_unreferenced_vertices()
        if _is_rock(piece_mesh):
            material = REGOLITH
        elif order < MAX_PIECES:
            material = random_material(first and order == 0, builder.rng)
        else:
            material = PAINT_GREY
        parts.append(
            _part_with_charts(
                piece_mesh, material_with_appearance(material, appearance), piece.label, builder
            )
        )
    return parts


def _part_with_charts(mesh: trimesh.Trimesh, material: Material, name: str, builder: PartBuilder) -> Part:
    return Part(mesh, material, charts_for_mesh(mesh, material, builder, builder.texel_m), name=name)


def _connected_pieces(mesh: trimesh.Trimesh) -> list[Ints]:
    """Faces of each connected component, the largest first."""
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    order = np.argsort(labels, kind="stable")
    islands = np.split(order, np.cumsum(np.bincount(labels))[:-1])
    return [islands[label] for label in np.argsort(-area, kind="stable")]


def _is_rock(mesh: trimesh.Trimesh) -> bool:
    return len(mesh.faces) > ROCK_FACES and mesh.is_watertight and not flat_regions(mesh, 0.002 * mesh.area)
