"""Binary glTF 2.0 (Khronos, ISO/IEC 12113:2022): the model, at rest or tumbling.

A node ``target`` holds two meshes: ``surface`` and, if there is one, ``invented`` (faces that close small
holes). Vertices have the attribute ``_SIGMA_M`` (``_SIGMA_MM``); -1 stands for "not measured", because glTF
allows no infinity. A point cloud is drawn as points.
"""

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array, continuous_wxyz, wxyz_from_matrix
from polhode.planning.exports.records import ExportShape

_VERTICES, _INDICES = 34962, 34963
_TYPES: dict[str, int] = {"<f4": 5126, "|u1": 5121, "<u4": 5125}
_POINTS, _TRIANGLES = 0, 4


@dataclass(frozen=True)
class Animation:
    """Poses of the target in N at T instants."""

    time_s: Array
    """(T,) from 0, increasing"""
    X_NF: Array
    """(T, 4, 4) [m]"""


@dataclass
class _Buffer:
    """The binary part, with the tables of the arrays in it."""

    content: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add(
        self, array: NDArray[Any], target: int | None = None, limits: bool = False, normalized: bool = False
    ) -> int:
        """Append an array (n,) or (n, k); the number of its accessor."""
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": array.nbytes}
        self.views.append(view if target is None else view | {"target": target})
        self.content += array.tobytes()
        self.content += b"\0" * (-len(self.content) % 4)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _TYPES[array.dtype.str],
            "count": len(array),
            "type": kind,
        }
        if normalized:
            accessor["normalized"] = True
        if limits:
            accessor["min"] = np.atleast_1d(array.min(axis=0)).tolist()
            accessor["max"] = np.atleast_1d(array.max(axis=0)).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def glb(
    shape: ExportShape, extras: dict[str, Any], per_m: float, unit: str, animation: Animation | None = None
) -> bytes:
    """The file. ``extras`` stand in the asset; with an animation the target's node moves in N."""
    buffer = _Buffer()
    meshes = []
    if len(shape.faces):
        parts = [("surface", shape.faces[~shape.invented]), ("invented", shape.faces[shape.invented])]
        for name, faces in parts:
            if len(faces):
                meshes.append({"name": name, "primitives": [_triangles(buffer, shape, faces, per_m, unit)]})
    else:
        every = np.arange(len(shape.vertices))
        attributes = _attributes(buffer, shape, every, per_m, unit, normals=False)
        primitive = {"attributes": attributes, "material": 0, "mode": _POINTS}
        meshes.append({"name": "landmarks", "primitives": [primitive]})
    target: dict[str, Any] = {"name": "target", "children": list(range(1, len(meshes) + 1))}
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "polhode", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [target, *({"name": mesh["name"], "mesh": k} for k, mesh in enumerate(meshes))],
        "meshes": meshes,
        "materials": [
            {
                "name": "measured colours",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            }
        ],
    }
    if animation is not None:
        content["animations"] = [_tumble(buffer, animation, per_m, target)]
    content |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    return _container(content, bytes(buffer.content))


def _triangles(
    buffer: _Buffer, shape: ExportShape, faces: NDArray[np.int64], per_m: float, unit: str
) -> dict[str, Any]:
    used, index = np.unique(faces, return_inverse=True)
    return {
        "attributes": _attributes(buffer, shape, used, per_m, unit, normals=True),
        "indices": buffer.add(index.reshape(-1).astype("<u4"), _INDICES),
        "material": 0,
        "mode": _TRIANGLES,
    }


def _attributes(
    buffer: _Buffer, shape: ExportShape, used: NDArray[np.int64], per_m: float, unit: str, normals: bool
) -> dict[str, int]:
    sigma = np.where(np.isfinite(shape.sigma_m), per_m * shape.sigma_m, -1.0)[used].astype("<f4")
    found = {"POSITION": buffer.add((per_m * shape.vertices[used]).astype("<f4"), _VERTICES, limits=True)}
    if normals:
        n = shape.normals[used]
        length = np.linalg.norm(n, axis=1, keepdims=True)
        # the standard asks for unit length; a vertex of no area has none of its own
        n = np.where(length > 0.5, n / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
        found["NORMAL"] = buffer.add(n.astype("<f4"), _VERTICES)
    found["COLOR_0"] = buffer.add(np.ascontiguousarray(shape.rgba[used]), _VERTICES, normalized=True)
    found[f"_SIGMA_{unit.upper()}"] = buffer.add(sigma, _VERTICES)
    return found


def _tumble(buffer: _Buffer, animation: Animation, per_m: float, target: dict[str, Any]) -> dict[str, Any]:
    """Channels of the target's node, which is at its first pose; both have the same key times."""
    wxyz = continuous_wxyz(wxyz_from_matrix(animation.X_NF[:, :3, :3]))
    xyzw = wxyz[:, [1, 2, 3, 0]].astype("<f4")
    position = (per_m * animation.X_NF[:, :3, 3]).astype("<f4")
    target["rotation"], target["translation"] = xyzw[0].tolist(), position[0].tolist()
    keys = buffer.add(animation.time_s.astype("<f4"), limits=True)
    samplers = [
        {"input": keys, "interpolation": "LINEAR", "output": buffer.add(values)}
        for values in (xyzw, position)
    ]
    channels = [
        {"sampler": k, "target": {"node": 0, "path": path}}
        for k, path in enumerate(("rotation", "translation"))
    ]
    return {"name": "tumble", "samplers": samplers, "channels": channels}


def _container(content: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode("ascii")
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    head = b"glTF" + np.array([2, length], dtype="<u4").tobytes()
    chunks = [
        np.array([len(chunk)], dtype="<u4").tobytes() + kind + chunk
        for kind, chunk in ((b"JSON", text), (b"BIN\0", binary))
    ]
    return head + b"".join(chunks)
