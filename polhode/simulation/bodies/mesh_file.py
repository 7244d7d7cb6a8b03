"""A body from a mesh file (OBJ, STL, PLY, GLB): with its colours, or with materials chosen for its pieces.

Materials are chosen by the names in the file, by the gloss that it states, or at random. Reflectance is
linear grey: sRGB is decoded (IEC 61966-2-1) and weighted as in Rec. ITU-R BT.709. Factors and vertex colours
of GLB are linear as its specification says; those of the other formats are taken as sRGB.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from polhode.files.foreign_meshes import MeshFile, open_mesh
from polhode.files.foreign_meshes.mesh_file import require_coordinates, unreadable
from polhode.files.foreign_meshes.textures import share_textures
from polhode.geometry.lie import Array, Ints
from polhode.runtime.errors import InputError
from polhode.simulation.bodies.part import FileColours, Part
from polhode.simulation.bodies.solids import flat_regions
from polhode.simulation.bodies.textures.part_builder import PartBuilder, charts_for_mesh, texel_size_for
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

MIN_RADIUS_M, MAX_RADIUS_M = 1e-3, 1e3
"""Range of plausible radii of a body."""


@dataclass(frozen=True)
class FilePiece:
    """One geometry of a file, in metres and in the file's common frame."""

    label: str
    """Name of the geometry in the file"""
    name: str
    """All names in the file that indicate its surface: node, geometry, group and material"""
    mesh: trimesh.Trimesh
    """Vertices merged where they coincide, no colours"""
    source: trimesh.Trimesh
    """As the file has it, with its colours; ``corners`` maps to its vertices"""
    corners: Ints
    """(F, 3) vertices of ``source`` at the faces' corners"""
    faces: Ints
    """(F,) faces of ``source``"""


def read_pieces(path: Path, metres_per_unit: float) -> list[FilePiece]:
    """Pieces of a mesh file, scaled to metres. Raises InputError if it contains nothing usable."""
    found = _geometries(path)
    if not found:
        raise InputError(f"{path}: the mesh has no faces; export it as triangles")
    pieces = []
    try:
        for _, _, source in found:
            require_coordinates(source)
        with np.errstate(all="ignore"):
            for label, name, source in found:
                source.apply_scale(metres_per_unit)
                mesh = trimesh.Trimesh(source.vertices, source.faces, process=False)
                # Exporters split vertices at seams of normals and textures; coincident ones are merged again.
                mesh.merge_vertices()
                whole = np.flatnonzero(mesh.nondegenerate_faces())
                mesh.update_faces(whole)
                mesh.remove_unreferenced_vertices()
                if len(whole) > 0:
                    corners = np.asarray(source.faces)[whole]
                    pieces.append(FilePiece(label, name, mesh, source, corners, whole))
    except Exception as error:  # noqa: BLE001  meshes that trimesh read and cannot handle
        raise unreadable(path, error) from None
    if not pieces:
        raise InputError(f"{path}: all faces of the mesh have no area; repair it")
    vertices: Array = np.concatenate([np.asarray(piece.mesh.vertices) for piece in pieces])
    sides = np.ptp(vertices, axis=0)
    if not MIN_RADIUS_M <= 0.5 * float(np.linalg.norm(sides)) <= MAX_RADIUS_M:
        size = " x ".join(f"{side:.3g}" for side in sides)
        raise InputError(f"{path}: the body is {size} m large; check body.metres_per_unit")
    return pieces


@np.errstate(all="ignore")
def _geometries(path: Path) -> list[tuple[str, str, trimesh.Trimesh]]:
    """All meshes of a file with their names, in the frame of the file's scene."""
    if not path.exists():
        raise InputError(f"{path}: no such mesh file; give body.path relative to the working directory")
    scene = _load(open_mesh(path))
    try:
        share_textures(scene)
        found = []
        for node in scene.graph.nodes_geometry:
            X, geometry = scene.graph[node]
            mesh = scene.geometry[geometry]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces) > 0:
                material = getattr(getattr(mesh.visual, "material", None), "name", None)
                name = " ".join(dict.fromkeys(str(n) for n in (node, geometry, material) if n))
                moved = mesh.copy()
                moved.remove_unreferenced_vertices()
                found.append((str(geometry), name, moved.apply_transform(X)))
        return found
    except Exception as error:  # noqa: BLE001  transforms and names of any kind
        raise unreadable(path, error) from None


def _load(file: MeshFile) -> trimesh.Scene:
    if file.kind != "obj":
        return file.scene(process=False)
    objects = re.search(rb"^o\s", file.content, re.MULTILINE) is not None
    return file.scene(split_objects=objects, split_groups=not objects, process=False)


REC_709 = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class FileAppearance:
    """What a file says of a piece's surface; None: nothing."""

    colours: FileColours | None = None
    """Colours that differ over the piece"""
    reflectance: float | None = None
    """One colour for all of it"""
    metallic: float | None = None
    roughness: float | None = None


def linear_grey(rgb: Array, encoded: bool = True) -> Array:
    """Colours (..., 3) in [0, 1], sRGB when ``encoded`` -> reflectance (...,)."""
    colour = np.clip(np.asarray(rgb, dtype=np.float64), 0.0, 1.0)
    if encoded:
        colour = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return np.asarray(colour @ REC_709)


def file_appearance(piece: FilePiece, glb: bool) -> FileAppearance:
    """What the file says of a piece; ``glb``: colours beside images are linear."""
    visual = piece.source.visual
    if isinstance(visual, TextureVisuals):
        return _of_texture(piece, visual, glb)
    if isinstance(visual, ColorVisuals) and visual.kind is not None:
        if visual.kind == "face":
            values = np.repeat(_grey(visual.face_colors, not glb)[piece.faces, None], 3, axis=1)
        else:
            values = _grey(visual.vertex_colors, not glb)[piece.corners]
        return _varying(values)
    return FileAppearance()


def _varying(corners: Array) -> FileAppearance:
    if np.ptp(corners) < 1e-3:
        return FileAppearance(reflectance=float(corners.mean()))
    absent = FileColours.absent(len(corners))
    return FileAppearance(colours=FileColours(corners, absent.face_image, absent.corner_uv))


def _grey(colours: ArrayLike, encoded: bool) -> Array:
    """Colours (n, 3 or 4), bytes or numbers in [0, 1] -> reflectance (n,)."""
    values = np.asarray(colours)
    scale = 255.0 if values.dtype == np.uint8 else 65535.0 if values.dtype == np.uint16 else 1.0
    return linear_grey(np.atleast_2d(values)[:, :3] / scale, encoded)


def _of_texture(piece: FilePiece, visual: TextureVisuals, glb: bool) -> FileAppearance:
    material = visual.material
    if isinstance(material, PBRMaterial):
        image, factor = material.baseColorTexture, material.baseColorFactor
        base = None if factor is None else float(_grey(factor, not glb)[0])
        metallic, roughness = material.metallicFactor, material.roughnessFactor
    elif isinstance(material, SimpleMaterial):
        image, metallic, exponent = material.image, None, material.kwargs.get("ns")
        base = float(_grey(material.diffuse, True)[0]) if "kd" in material.kwargs else None
        roughness = None
        if isinstance(exponent, int | float) and exponent > 0:
            # GGX roughness of a Phong exponent n: alpha^2 = 2 / (n + 2) (Walter et al. 2007).
            roughness = float((2.0 / (exponent + 2.0)) ** 0.25)
    else:
        return FileAppearance()
    if image is not None and max(image.size) <= 2 and isinstance(material, SimpleMaterial):
        # trimesh supplies a tiny grey image if the file names none.
        image = None
    uv = None if visual.uv is None else np.asarray(visual.uv, dtype=np.float64)
    if image is None or uv is None or len(uv) != len(piece.source.vertices) or not np.isfinite(uv).all():
        vertex = visual.vertex_attributes.get("color") if hasattr(visual, "vertex_attributes") else None
        if vertex is not None and len(vertex) == len(piece.source.vertices):
            return _varying(_grey(vertex, not glb)[piece.corners])
        return FileAppearance(None, base, metallic, roughness)
    # Decoding a byte is a table look-up; the weights add up to 1.
    table = linear_grey(np.repeat(np.arange(256)[:, None] / 255.0, 3, axis=1))
    reflectance = np.asarray(table[np.asarray(image)] @ REC_709, dtype=np.float32)
    # A Kd that is zero or absent beside an image is an artefact of exporters, not a black surface.
    corners = np.full((len(piece.faces), 3), base if glb and base is not None else 1.0)
    first = np.zeros(len(piece.faces), dtype=np.int64)
    colours = FileColours(corners, first, uv[piece.corners], (reflectance,))
    return FileAppearance(colours, None, metallic, roughness)


NAMES: tuple[tuple[str, Material], ...] = (
    (r"radiator|osr", mat.PAINT_WHITE),
    (r"asteroid|comet|rock|regolith|terrain|lunar|moon|eros|itokawa|bennu|ryugu|67p", mat.REGOLITH),
    (r"nozzle|engine|thruster|thr_|bell", mat.DARK_METAL),
    (r"silver.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*silver", mat.FOIL_SILVER),
    (r"black.*(mli|foil|kapton|blanket)|(mli|foil|kapton|blanket).*black", mat.FOIL_BLACK),
    (r"mli|foil|kapton|gold|blanket|insulat", mat.FOIL_GOLD),
    (r"white|dish|antenna|reflector", mat.PAINT_WHITE),
    (r"solar|cell|panel|array", mat.SOLAR_CELL),
    (r"glass|lens|optic|camera|window", mat.GLASS),
    (r"black", mat.PAINT_BLACK),
    (r"gr[ae]y|paint", mat.PAINT_GREY),
    (r"metal|alumin|steel|titan|strut|truss|boom|mast|hinge|rail|bolt", mat.BRUSHED_METAL),
)
"""The first pattern found in a piece's name, regardless of case, decides."""
CHOICES = (mat.WORN_PANEL, mat.WORN_PANEL, mat.PAINT_WHITE, mat.PAINT_GREY, mat.BRUSHED_METAL)
"""Materials of pieces whose names match no pattern; the largest is a worn panel, which has texture."""


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
    """Parts of a mesh file: of each piece by its colours or its name, otherwise one for each connected
    component. Raises InputError with one line if it contains nothing usable."""
    pieces = read_pieces(path, metres_per_unit)
    builder = replace(builder, texel_m=texel_size_for(sum(float(piece.mesh.area) for piece in pieces)))
    parts: list[Part] = []

    def add(mesh: trimesh.Trimesh, material: Material, appearance: FileAppearance, label: str) -> None:
        """A part in a material with the file's appearance."""
        material = material_with_appearance(material, appearance)
        parts.append(Part(mesh, material, charts_for_mesh(mesh, material, builder), name=label))

    for piece in sorted(pieces, key=lambda piece: -piece.mesh.area):
        appearance = file_appearance(piece, path.suffix.lower() in (".glb", ".gltf"))
        named = material_by_name(piece.name) or material_by_name(path.stem)
        mesh, first = piece.mesh, not parts
        if appearance.colours is not None:
            # The colours of the file are the texture; none is added.
            plain = replace(named or mat.PAINT_GREY, grain=0.0, patch=0.0)
            material = material_with_appearance(plain, appearance)
            parts.append(Part(mesh, material, name=piece.label, colours=appearance.colours))
            continue
        if named is not None:
            add(mesh, named, appearance, piece.label)
            continue
        labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
        area = np.bincount(labels, weights=mesh.area_faces)
        # The largest component first.
        for order, label in enumerate(np.argsort(-area, kind="stable")):
            component = trimesh.Trimesh(mesh.vertices, mesh.faces[labels == label], process=False)
            component.remove_unreferenced_vertices()
            many_faces = len(component.faces) > ROCK_FACES and component.is_watertight
            if many_faces and not flat_regions(component, 0.002 * component.area):
                material = mat.REGOLITH
            elif first and order == 0:
                material = mat.WORN_PANEL
            elif order < MAX_PIECES:
                material = CHOICES[int(builder.rng.integers(len(CHOICES)))]
            else:
                material = mat.PAINT_GREY
            add(component, material, appearance, piece.label)
    return parts
