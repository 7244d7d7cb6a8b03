"""The solids of an STL file, binary or text."""

import struct

from polhode.files.foreign_meshes.unsound import Unsound, require_pieces

_HEAD_BYTES, _FACE_BYTES = 84, 50


def is_binary_stl(content: bytes) -> bool:
    """Whether the stated number of triangles is that of the file's size."""
    if len(content) < _HEAD_BYTES:
        return False
    (count,) = struct.unpack_from("<I", content, 80)
    return bool(len(content) == _HEAD_BYTES + _FACE_BYTES * count)


def require_sound_stl(content: bytes) -> None:
    """Raises Unsound: neither binary nor text, or too many solids."""
    if is_binary_stl(content):
        return
    lower = content.lower()
    if not lower.lstrip().startswith(b"solid"):
        raise Unsound("neither a text that begins with 'solid' nor as many triangles as stated")
    require_pieces(lower.count(b"endsolid"))
