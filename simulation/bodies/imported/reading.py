"""Reading mesh files (OBJ, STL, PLY, GLB): named pieces in one frame, or an error of one line."""

import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from trimesh.resolvers import FilePathResolver

from polhode.errors import InputError
from polhode.lie import Array
from polhode.records import Ints

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
    """Pieces of a mesh file, scaled to metres. Raises InputError with one line if it contains nothing
    usable.
    """
    found = _geometries(path)
    if not found:
        raise InputError(f"{path}: the mesh has no faces; export it as triangles")
    if not all(np.isfinite(mesh.vertices).all() for _, _, mesh in found):
        raise InputError(f"{path}: the mesh has vertices that are not finite; repair it")
    pieces = [_piece(label, name, mesh, metres_per_unit) for label, name, mesh in found]
    pieces = [piece for piece in pieces if len(piece.mesh.faces) > 0]
    if not pieces:
        raise InputError(f"{path}: all faces of the mesh have no area; repair it")
    _require_sensible_size(path, pieces)
    return pieces


def _geometries(path: Path) -> list[tuple[str, str, trimesh.Trimesh]]:
    """All meshes of a file with their names, in the frame of the file's scene."""
    if not path.exists():
        raise InputError(f"{path}: no such mesh file; give body.path relative to the working directory")
    if not path.is_file():
        raise InputError(f"{path}: not a file; give body.path of an OBJ, STL, PLY or GLB")
    try:
        scene = _load(path)
        found = []
        for node in scene.graph.nodes_geometry:
            X, geometry = scene.graph[node]
            mesh = scene.geometry[geometry]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces) > 0:
                if mesh.faces.max() >= len(mesh.vertices) or mesh.faces.min() < 0:
                    raise ValueError("faces refer to vertices that do not exist")
                material = getattr(getattr(mesh.visual, "material", None), "name", None)
                name = " ".join(dict.fromkeys(str(n) for n in (node, geometry, material) if n))
                moved = mesh.copy()
                moved.remove_unreferenced_vertices()
                found.append((str(geometry), name, moved.apply_transform(X)))
        return found
    # Parsers of arbitrary files raise exceptions of any type.
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: cannot be read as a mesh ({reason}); give OBJ, STL, PLY or GLB") from error


def _load(path: Path) -> trimesh.Scene:
    content = path.read_bytes()
    kind = path.suffix.lower().lstrip(".")
    beside = FilePathResolver(str(path))
    if kind != "obj":
        return trimesh.load_scene(BytesIO(content), file_type=kind, resolver=beside, process=False)
    names = list(dict.fromkeys(re.findall(rb"^usemtl[ \t]+(.+?)\s*$", content, re.MULTILINE)))
    objects = re.search(rb"^o\s", content, re.MULTILINE) is not None
    if names and not re.search(rb"^mtllib\s", content, re.MULTILINE):
        content = b"mtllib absent.mtl\n" + content
    return trimesh.load_scene(
        BytesIO(content),
        file_type="obj",
        resolver=_MaterialNames(path, names),
        split_objects=objects,
        split_groups=not objects,
        process=False,
    )


class _MaterialNames(FilePathResolver):
    """Files beside an OBJ; if its material library is absent, one with the names that the OBJ uses."""

    def __init__(self, path: Path, names: list[bytes]) -> None:
        super().__init__(str(path))
        self._names = names

    def get(self, name: str) -> bytes:
        """Content of a file by its name."""
        try:
            return bytes(super().get(name))
        except OSError:
            if not name.strip().lower().endswith(".mtl"):
                raise
            return b"\n".join(b"newmtl " + own for own in self._names)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)


def _piece(label: str, name: str, source: trimesh.Trimesh, metres_per_unit: float) -> FilePiece:
    source.apply_scale(metres_per_unit)
    mesh = trimesh.Trimesh(source.vertices, source.faces, process=False)
    # Exporters split vertices at seams of normals and textures; coincident vertices are merged again.
    mesh.merge_vertices()
    whole = np.flatnonzero(mesh.nondegenerate_faces())
    mesh.update_faces(whole)
    mesh.remove_unreferenced_vertices()
    return FilePiece(label, name, mesh, source, np.asarray(source.faces)[whole], whole)


def _require_sensible_size(path: Path, pieces: list[FilePiece]) -> None:
    corners: Array = np.concatenate([np.asarray(piece.mesh.vertices) for piece in pieces])
    low, high = corners.min(axis=0), corners.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low))
    if not MIN_RADIUS_M <= radius <= MAX_RADIUS_M:
        size = " x ".join(f"{side:.3g}" for side in high - low)
        raise InputError(f"{path}: the body is {size} m large; check body.metres_per_unit")
