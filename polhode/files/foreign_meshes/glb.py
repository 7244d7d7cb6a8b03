"""A binary glTF: chunks, views, accessors, primitives and nodes must fit the file and each other."""

import json
import struct
from typing import Any

from polhode.files.foreign_meshes.unsound import Unsound, require_pieces

_JSON_BYTES = 8 << 20
_BYTES = 128 << 20
"""Of all views, and of all accessors"""
_COMPONENT = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MAX_NODES, _MAX_DEPTH, _MAX_VERTICES = 20_000, 200, 4_000_000
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
    document, binary = _chunks(content)
    for name in document.get("extensionsRequired", []):
        if not str(name).startswith(_EXTENSIONS):
            raise Unsound(f"the extension {str(name)[:60]} is required: save it without compression")
    if any("uri" in item for item in (*document.get("buffers", []), *document.get("images", []))):
        raise Unsound("data in other files or in addresses: embed them")
    counts = _accessors(document, binary)
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
    require_pieces(most[0])
    if most[1] > most_faces:
        raise Unsound(f"more than {most_faces} triangles")
    if most[2] > _MAX_VERTICES:
        raise Unsound(f"more than {_MAX_VERTICES} vertices")
    _require_trees([[_count(child) for child in node.get("children", [])] for node in nodes])


def _chunks(content: bytes) -> tuple[dict[str, Any], int]:
    """The document, and the length of the binary chunk."""
    if len(content) < 20:
        raise Unsound("no header of a GLB")
    magic, version, length, size, kind = struct.unpack_from("<5I", content)
    if (magic, version, kind) != (0x46546C67, 2, 0x4E4F534A):
        raise Unsound("no header of a GLB of version 2")
    if length > len(content) or 20 + size > length:
        raise Unsound(f"{length} bytes stated, {len(content)} there")
    if size > _JSON_BYTES:
        raise Unsound(f"a description of {size} bytes, where {_JSON_BYTES} are allowed")
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


def _accessors(document: dict[str, Any], binary: int) -> list[int]:
    """Number of items of each accessor, each within its view, and that within the binary chunk."""
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
        item = _COMPONENT[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
        step = max(_count(views[index].get("byteStride", item)), 1)
        needed = _count(accessor.get("byteOffset", 0)) + (step * (count - 1) + item if count else 0)
        if needed > lengths[index]:
            raise Unsound(
                f"an accessor of {count} items that needs {needed} of the {lengths[index]} bytes there"
            )
        total += count * item
        counts.append(count)
    # trimesh copies each
    for what, size in (("views", sum(lengths)), ("accessors", total)):
        if size > _BYTES:
            raise Unsound(f"{what} of {size} bytes together")
    return counts


def _require_trees(children: list[list[int]]) -> None:
    """Every node has at most one parent, none is its own ancestor, and the depth is limited."""
    if len(children) > _MAX_NODES:
        raise Unsound(f"{len(children)} nodes, where {_MAX_NODES} are allowed")
    listed = [child for each in children for child in each]
    if len(listed) != len(set(listed)) or any(child >= len(children) for child in listed):
        raise Unsound("a node with two parents, or a missing one")
    level, seen = sorted(set(range(len(children))) - set(listed)), 0
    for _ in range(_MAX_DEPTH):
        seen += len(level)
        level = [child for node in level for child in children[node]]
    if seen != len(children):
        raise Unsound(f"nodes that are their own ancestors, or nested deeper than {_MAX_DEPTH}")


def _count(value: Any) -> int:
    """A whole number >= 0. Raises Unsound."""
    if type(value) is not int or not 0 <= value < 2**40:
        raise Unsound(f"{str(value)[:40]} where a count or an index belongs")
    return value
