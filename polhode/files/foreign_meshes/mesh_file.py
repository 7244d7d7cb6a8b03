"""Opening a mesh file of others: limits, structure, then trimesh; what comes out is finite and sound."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
import trimesh
from trimesh.resolvers import Resolver

from polhode.files.foreign_files import MIB, amount, read_bytes
from polhode.files.foreign_meshes.structure import (
    FOREIGN,
    MeshLimits,
    Unsound,
    is_binary_stl,
    plain,
    require_sound_glb,
    require_sound_obj,
    require_sound_ply,
    require_sound_stl,
)
from polhode.runtime.errors import InputError, one_line

# It logs what it cannot make use of, such as colours; here a mesh is read or refused in one line.
logging.getLogger("trimesh").setLevel(logging.CRITICAL)

TEXT_BYTES = 16 * MIB
"""trimesh needs some thirty times as much memory to read a text; with this limit it stays below 1 GiB."""
MAX_COORDINATE = 1e12
"""In units of the file, whatever they are."""
KINDS = ("ply", "stl", "obj", "glb")


@dataclass(frozen=True)
class MeshFile:
    """A file whose structure was checked."""

    path: Path
    kind: str
    """ply, stl, obj or glb"""
    content: bytes
    resolver: Resolver
    limits: MeshLimits

    def scene(self, **options: Any) -> trimesh.Scene:
        """All geometries in their scene; ``options`` go to trimesh. Raises InputError."""
        return self._loaded(trimesh.load_scene, options)  # type: ignore[no-any-return]

    def mesh(self, **options: Any) -> trimesh.Trimesh:
        """All triangles as one mesh, without materials. Raises InputError; there may be no triangles."""
        return self._loaded(trimesh.load_mesh, {"skip_materials": True, **options})  # type: ignore[no-any-return]

    @np.errstate(all="ignore")
    def merged(self) -> trimesh.Trimesh:
        """All triangles as one mesh, the vertices of each piece merged where they coincide.

        Raises InputError, also for a vertex that is not finite.
        """
        scene = self.scene(process=False, skip_materials=True)
        try:
            for name, each in list(scene.geometry.items()):
                if not isinstance(each, trimesh.Trimesh):
                    scene.delete_geometry(name)
                    continue
                require_coordinates(each)
                each.process()
            mesh: trimesh.Trimesh = scene.to_mesh()
            require_coordinates(mesh)
            return mesh
        except Exception as error:  # noqa: BLE001  as above
            raise unreadable(self.path, error) from None

    @np.errstate(all="ignore")
    def _loaded(self, load: Callable[..., Any], options: dict[str, Any]) -> Any:
        try:
            loaded = load(BytesIO(self.content), file_type=self.kind, resolver=self.resolver, **options)
            meshes = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
            for mesh in meshes:
                _require_sound(mesh, self.limits.faces)
            return loaded
        except Exception as error:  # noqa: BLE001  readers of many formats raise many things
            raise unreadable(self.path, error) from None


def open_mesh(path: Path, limits: MeshLimits = FOREIGN) -> MeshFile:
    """Read the file and check its structure.

    Raises InputError: not one of the formats, no regular file, too large, or another structure than stated.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in KINDS:
        raise unreadable(path, Unsound("its name ends with none of .ply, .stl, .obj, .glb"))
    content = read_bytes(path, limits.binary_bytes, "a mesh")
    try:
        is_text = kind == "obj" or (kind == "ply" and b"format ascii" in content[:200])
        if is_text or (kind == "stl" and not is_binary_stl(content)):
            if len(content) > TEXT_BYTES:
                raise Unsound(f"a text of {amount(len(content))}, where {amount(TEXT_BYTES)} are allowed")
            content = plain(content)
        match kind:
            case "ply":
                require_sound_ply(content, limits.rows)
            case "stl":
                require_sound_stl(content)
            case "obj":
                require_sound_obj(content)
            case _:
                require_sound_glb(content, limits.faces)
    except Exception as error:  # noqa: BLE001  a document of another structure
        raise unreadable(path, error) from None
    return MeshFile(path, kind, content, FilesBeside(path), limits)


def _require_sound(mesh: Any, most_faces: int) -> None:
    """Raises Unsound for faces of vertices that do not exist, and for too many. Clouds of points may pass."""
    if not isinstance(mesh, trimesh.Trimesh):
        return
    for element in mesh.metadata.get("_ply_raw", {}).values():
        rows = element.get("data")
        for name in (rows.dtype.names or ()) if isinstance(rows, np.ndarray) else ():
            # trimesh takes the length of the first list of a binary PLY for that of all
            if rows[name].dtype.names == ("f0", "f1") and np.ptp(rows[name]["f0"].astype(np.int64)) != 0:
                raise Unsound("lists of several lengths in a binary PLY: save it as triangles")
    faces = np.asarray(mesh.faces)
    if np.shape(mesh.vertices)[1:] != (3,) or faces.shape[1:] != (3,):
        raise Unsound("vertices without three coordinates, or faces without three corners")
    if len(faces) > most_faces:
        raise Unsound(f"{len(faces)} triangles, where {most_faces} are allowed")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(mesh.vertices)):
        raise Unsound("faces refer to vertices that do not exist")


def require_coordinates(mesh: trimesh.Trimesh) -> None:
    """Raises Unsound: a vertex that is not finite, or farther out than any body."""
    vertices = np.asarray(mesh.vertices)
    if not np.isfinite(vertices).all():
        raise Unsound("a vertex is not finite")
    if len(vertices) and np.abs(vertices).max() > MAX_COORDINATE:
        raise Unsound(f"a coordinate of {np.abs(vertices).max():.1e}")


def unreadable(path: Path, error: Exception) -> InputError:
    """One line, with the reason; the error itself if it has one already."""
    if isinstance(error, InputError):
        return error
    reason = one_line(str(error) or type(error).__name__)[:120]
    return InputError(f"{path}: cannot be read as a mesh ({reason}); give PLY, STL, OBJ or GLB")


class FilesBeside(Resolver):
    """Files of a mesh's own folder: material libraries and textures, whatever the path that names them."""

    def __init__(self, mesh: Path) -> None:
        self._folder = mesh.parent

    def get(self, name: str) -> bytes:
        """Content of a file. Raises OSError for any that is not taken: the mesh has no colours then."""
        path = self._beside(name.strip())
        material = path.suffix.lower() == ".mtl"
        try:
            content = read_bytes(path, (MIB if material else 64 * MIB), "a file beside a mesh")
        except InputError as error:
            raise FileNotFoundError(str(error)) from None
        images = (b"\x89PNG\r\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*", b"RIFF")
        if not material and not content.startswith(images):
            raise OSError(f"{path}: not an image")
        return plain(content) if material else content

    def _beside(self, name: str) -> Path:
        """Where the path leads outside, the file of the same name in the folder itself."""
        folder = self._folder.resolve()
        wanted = PureWindowsPath(name).name
        named = [folder / plain(each.encode()).decode() for each in (name, wanted) if "\0" not in each]
        # ``plain`` was applied to the name in the mesh as well
        alike = (
            each for each in folder.iterdir() if plain(each.name.encode(errors="replace")).decode() == wanted
        )
        for path in (*named, *alike):
            if path.is_file() and path.resolve().is_relative_to(folder):
                return path
        raise FileNotFoundError(name)

    def write(self, name: str, data: Any) -> None:
        """Nothing is written."""
        raise OSError(name)

    def namespaced(self, namespace: str) -> "FilesBeside":
        """trimesh asks for it."""
        return self

    def keys(self) -> list[str]:
        """Names are not listed."""
        return []
