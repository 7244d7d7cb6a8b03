"""The lines of an OBJ file, and the files beside it that it may name."""

import re
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from trimesh.resolvers import Resolver

from polhode.files.foreign_files import MIB, read_bytes
from polhode.files.foreign_meshes.unsound import Unsound, require_pieces
from polhode.runtime.errors import InputError

_DIRECTIVE = re.compile(rb"^(?:o|g|usemtl)[ \t]+(.*)$", re.MULTILINE)
_VERTEX = re.compile(rb"^v[ \t]", re.MULTILINE)
_MAX_LINE_BYTES, _MAX_WORDS = 16_384, 1_200_000
_MATERIAL_BYTES, _TEXTURE_BYTES = MIB, 64 * MIB
_ASCII = bytes(range(128)) + b"_" * 128


def plain(content: bytes) -> bytes:
    """The text with ``_`` for what is not ASCII, since trimesh keeps several copies of it as characters."""
    return content if content.isascii() else content.translate(_ASCII)


def require_sound_obj(content: bytes) -> None:
    """Raises Unsound: a line without end, or so many groups that each passes over all vertices for long."""
    ends = np.flatnonzero(np.frombuffer(content, np.uint8) == ord("\n"))
    if np.diff(ends, prepend=-1, append=len(content)).max() > _MAX_LINE_BYTES:
        raise Unsound(f"a line of more than {_MAX_LINE_BYTES} bytes")
    words = content.count(b" ") + content.count(b"\t")
    if words > _MAX_WORDS:
        raise Unsound(f"{words} numbers, where {_MAX_WORDS} are allowed: save it as GLB or binary PLY")
    groups = len(set(_DIRECTIVE.findall(content)))
    require_pieces(groups)
    changes = sum(1 for _ in _DIRECTIVE.finditer(content))
    vertices = sum(1 for _ in _VERTEX.finditer(content))
    if min(changes, 2 * groups) * vertices > 1_000_000_000:
        raise Unsound(f"{groups} groups over {vertices} vertices: split the file, or save it as GLB")


class FilesBeside(Resolver):
    """Files of a mesh's own folder: material libraries and textures, whatever the path that names them."""

    def __init__(self, mesh: Path) -> None:
        self._folder = mesh.parent

    def get(self, name: str) -> bytes:
        """Content of a file. Raises OSError for any that is not taken: the mesh has no colours then."""
        path = self._beside(name.strip())
        material = path.suffix.lower() == ".mtl"
        try:
            content = read_bytes(
                path, _MATERIAL_BYTES if material else _TEXTURE_BYTES, "a file beside a mesh"
            )
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
