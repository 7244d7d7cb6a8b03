"""What a mesh file states (PLY, STL, OBJ, GLB) against what it holds, before anything is made of it."""

import json
import re
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from polhode.files.foreign_files import MIB

MAX_PIECES = 2_000
"""Meshes in one file; each costs trimesh a fraction of a millisecond."""


@dataclass(frozen=True)
class MeshLimits:
    """How large a file of triangles may be."""

    binary_bytes: int
    rows: int
    """Of a binary PLY: vertices, faces and all else"""
    faces: int


FOREIGN = MeshLimits(64 * MIB, 4_000_000, 2_000_000)
"""Of a file that anybody may have written"""
OF_A_RUN = MeshLimits(1024 * MIB, 60_000_000, 30_000_000)
"""Of what a run wrote: more than a field of the default size (``mapping.memory_mib``) can give"""


class Unsound(Exception):
    """The reason, as part of a sentence."""


def _require_pieces(count: int) -> None:
    if count > MAX_PIECES:
        raise Unsound(f"{count} pieces, where {MAX_PIECES} are allowed: join some")


_PLY_SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "float16": 2, "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8,
    "float64": 8, "int64": 8, "uint64": 8,
}  # fmt: skip
"""Bytes of each type of a property."""
MAX_TEXT_ROWS = 400_000
"""Of a PLY as text"""


def require_sound_ply(content: bytes, most_rows: int) -> None:
    """Raises Unsound: no PLY, an unknown type, or more rows than are allowed or fit the file."""
    end = content.find(b"end_header", 0, 1 << 18)
    body = content.find(b"\n", end, end + 100) + 1
    if not content.startswith(b"ply") or end < 0 or body < 1:
        raise Unsound("no header of a PLY")
    lines = [line.split() for line in content[:end].decode("ascii", errors="replace").splitlines()]
    if len(lines) > 2_000:
        raise Unsound(f"a header of {len(lines)} lines, where 2000 are allowed")
    formats = ("ascii", "binary_little_endian", "binary_big_endian")
    if len(lines) < 2 or len(lines[1]) != 3 or lines[1][0] != "format" or lines[1][1] not in formats:
        raise Unsound("no format that is ascii or binary")
    counts, sizes = _ply_elements(lines[2:])
    is_text, rows = lines[1][1] == "ascii", sum(counts.values())
    if rows > (MAX_TEXT_ROWS if is_text else most_rows):
        raise Unsound(f"{rows} rows, where {most_rows} are allowed, and {MAX_TEXT_ROWS} as text")
    there = content.count(b"\n", body) + 1 if is_text else len(content) - body
    least = sum(count * sum(sizes[name].values()) for name, count in counts.items())
    if is_text and not rows <= there <= rows + 1_000:
        raise Unsound(f"{rows} rows stated, {there} lines there")
    if not is_text and least > there:
        raise Unsound(f"{rows} rows stated, which need {least} bytes or more; {there} are there")


def _ply_elements(lines: list[list[str]]) -> tuple[dict[str, int], dict[str, dict[str, int]]]:
    """By element, the rows and the bytes of each property that the lines of a header state; of a list, those
    of its count."""
    counts: dict[str, int] = {}
    sizes: dict[str, dict[str, int]] = {}
    for line in lines:
        match line:
            case ["comment" | "obj_info", *_]:
                pass
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                if name in counts or len(counts) == 20:
                    raise Unsound("too many elements, or two of one name")
                counts[name], sizes[name] = int(count), {}
            case ["property", *kinds, name] if counts and _first_size(kinds):
                properties = sizes[next(reversed(counts))]
                if name in properties:
                    raise Unsound(f"two properties {name[:40]}")
                properties[name] = _first_size(kinds)
            case _:
                raise Unsound(f"a header with the line '{' '.join(line)[:60]}'")
    return counts, sizes


def _first_size(kinds: list[str]) -> int:
    """Bytes of a value, or of the count of a list; 0: no such types."""
    if len(kinds) == 3 and kinds[0] == "list" and kinds[2] in _PLY_SIZES and "float" not in kinds[1]:
        return _PLY_SIZES.get(kinds[1], 0) if kinds[1] != "double" else 0
    return _PLY_SIZES.get(kinds[0], 0) if len(kinds) == 1 else 0


def is_binary_stl(content: bytes) -> bool:
    """Whether the stated number of triangles is that of the file's size: 50 bytes each, after 84."""
    return len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")


def require_sound_stl(content: bytes) -> None:
    """Raises Unsound: neither binary nor text, or too many solids."""
    if is_binary_stl(content):
        return
    lower = content.lower()
    if not lower.lstrip().startswith(b"solid"):
        raise Unsound("neither a text that begins with 'solid' nor as many triangles as stated")
    _require_pieces(lower.count(b"endsolid"))


def plain(content: bytes) -> bytes:
    """The text with ``_`` for what is not ASCII, since trimesh keeps several copies of it as characters."""
    return content if content.isascii() else content.translate(bytes(range(128)) + b"_" * 128)


def require_sound_obj(content: bytes) -> None:
    """Raises Unsound: a line without end, or so many groups that each passes over all vertices for long."""
    ends = np.flatnonzero(np.frombuffer(content, np.uint8) == ord("\n"))
    if np.diff(ends, prepend=-1, append=len(content)).max() > 16_384:
        raise Unsound("a line of more than 16384 bytes")
    words = content.count(b" ") + content.count(b"\t")
    if words > 1_200_000:
        raise Unsound(f"{words} numbers, where 1200000 are allowed: save it as GLB or binary PLY")
    changes = re.findall(rb"^(?:o|g|usemtl)[ \t]+(.*)$", content, re.MULTILINE)
    groups = len(set(changes))
    _require_pieces(groups)
    vertices = len(re.findall(rb"^v[ \t]", content, re.MULTILINE))
    if min(len(changes), 2 * groups) * vertices > 1_000_000_000:
        raise Unsound(f"{groups} groups over {vertices} vertices: split the file, or save it as GLB")


MAX_GLB_BYTES = 128 << 20
"""Of all views, and of all accessors; trimesh copies each"""
MAX_NODES, MAX_DEPTH, MAX_GLB_VERTICES = 20_000, 200, 4_000_000
_EXTENSIONS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
)
"""Beginnings of the names of those that a file may require."""


def require_sound_glb(content: bytes, most_faces: int) -> None:
    """Raises Unsound, or KeyError, TypeError and the like for a document that is not glTF at all."""
    document, binary = _glb_chunks(content)
    for name in document.get("extensionsRequired", []):
        if not str(name).startswith(_EXTENSIONS):
            raise Unsound(f"the extension {str(name)[:60]} is required: save it without compression")
    if any("uri" in item for item in (*document.get("buffers", []), *document.get("images", []))):
        raise Unsound("data in other files or in addresses: embed them")
    counts = _glb_accessors(document, binary)
    meshes = []
    for mesh in document.get("meshes", []):
        primitives = mesh["primitives"]
        if any("KHR_draco_mesh_compression" in each.get("extensions", {}) for each in primitives):
            raise Unsound("compressed by Draco: save it without compression")
        vertices = sum(counts[_count(each["attributes"]["POSITION"])] for each in primitives)
        indices = sum(counts[_count(each["indices"])] for each in primitives if "indices" in each)
        meshes.append((len(primitives), (indices + vertices) // 3, vertices))
    nodes = document.get("nodes", [])
    used = [meshes[_count(node["mesh"])] for node in nodes if "mesh" in node]
    most = [max(sum(each[k] for each in some) for some in (meshes, used)) for k in range(3)]
    _require_pieces(most[0])
    for found, allowed, what in ((most[1], most_faces, "triangles"), (most[2], MAX_GLB_VERTICES, "vertices")):
        if found > allowed:
            raise Unsound(f"more than {allowed} {what}")
    _require_trees([[_count(child) for child in node.get("children", [])] for node in nodes])


def _glb_chunks(content: bytes) -> tuple[dict[str, Any], int]:
    """The document, and the length of the binary chunk."""
    if len(content) < 20:
        raise Unsound("no header of a GLB")
    magic, version, length, size, kind = struct.unpack_from("<5I", content)
    if (magic, version, kind) != (0x46546C67, 2, 0x4E4F534A):
        raise Unsound("no header of a GLB of version 2")
    if length > len(content) or 20 + size > length:
        raise Unsound(f"{length} bytes stated, {len(content)} there")
    if size > 8 << 20:
        raise Unsound(f"a description of {size} bytes, where {8 << 20} are allowed")
    document = json.loads(content[20 : 20 + size])
    if not isinstance(document, dict):
        raise Unsound("no document of glTF")
    position, binary = 20 + size, []
    while position + 8 <= length:
        size, kind = struct.unpack_from("<2I", content, position)
        position += 8 + size
        if position > length:
            raise Unsound("a chunk that is longer than the file")
        binary += [size] if kind == 0x004E4942 else []
    if len(binary) > 1 or len(document.get("buffers", [])) > 1:
        raise Unsound("more than one buffer")
    return document, sum(binary)


def _glb_accessors(document: dict[str, Any], binary: int) -> list[int]:
    """Number of items of each accessor, each within its view, and that within the binary chunk."""
    component = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    components = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
    views = document.get("bufferViews", [])
    lengths = [_count(view["byteLength"]) for view in views]
    for view, length in zip(views, lengths, strict=True):
        if view["buffer"] != 0 or _count(view.get("byteOffset", 0)) + length > binary:
            raise Unsound(f"a view of {length} bytes that is not within the {binary} of the file")
    counts, total = [], 0
    for accessor in document.get("accessors", []):
        if "sparse" in accessor or "bufferView" not in accessor:
            raise Unsound("an accessor without values of its own (sparse or compressed): save it plainly")
        count, index = _count(accessor["count"]), _count(accessor["bufferView"])
        item = component[accessor["componentType"]] * components[accessor["type"]]
        step = max(_count(views[index].get("byteStride", item)), 1)
        needed = _count(accessor.get("byteOffset", 0)) + (step * (count - 1) + item if count else 0)
        if needed > (there := lengths[index]):
            raise Unsound(f"an accessor of {count} items that needs {needed} of the {there} bytes there")
        total += count * item
        counts.append(count)
    for what, size in (("views", sum(lengths)), ("accessors", total)):
        if size > MAX_GLB_BYTES:
            raise Unsound(f"{what} of {size} bytes together")
    return counts


def _require_trees(children: list[list[int]]) -> None:
    """Every node has at most one parent, none is its own ancestor, and the depth is limited."""
    if len(children) > MAX_NODES:
        raise Unsound(f"{len(children)} nodes, where {MAX_NODES} are allowed")
    listed = [child for each in children for child in each]
    if len(listed) != len(set(listed)) or any(child >= len(children) for child in listed):
        raise Unsound("a node with two parents, or a missing one")
    level, seen = sorted(set(range(len(children))) - set(listed)), 0
    for _ in range(MAX_DEPTH):
        seen += len(level)
        level = [child for node in level for child in children[node]]
    if seen != len(children):
        raise Unsound(f"nodes that are their own ancestors, or nested deeper than {MAX_DEPTH}")


def _count(value: Any) -> int:
    """A whole number >= 0. Raises Unsound."""
    if type(value) is not int or not 0 <= value < 2**40:
        raise Unsound(f"{str(value)[:40]} where a count or an index belongs")
    return value
