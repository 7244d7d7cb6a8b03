"""Binary glTF 2.0 (Khronos, ISO/IEC 12113:2022): the model, at rest or tumbling.

A node ``target`` holds two meshes: ``surface`` and, if there is one, ``invented`` (faces that close small
holes). Vertices have the attribute ``_SIGMA_M`` (``_SIGMA_MM``); -1 stands for "not measured", because glTF
allows no infinity. A point cloud is drawn as points.
"""

import json
import struct
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

    def add(self, array: NDArray[Any], target: int | None = None, **more: Any) -> int:
        """Append an array (n,) or (n, k); the number of its accessor, which has the fields ``more``, too."""
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": array.nbytes}
        self.views.append(view if target is None else view | {"target": target})
        self.content += array.tobytes()
        self.content += b"\0" * (-len(self.content) % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": _TYPES[array.dtype.str],
            "count": len(array),
            "type": "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}",
        }
        self.accessors.append(accessor | more)
        return len(self.accessors) - 1

    def add_with_limits(self, array: NDArray[Any], target: int | None = None) -> int:
        """The same, with the least and the largest values."""
        limits = (np.atleast_1d(each).tolist() for each in (array.min(axis=0), array.max(axis=0)))
        return self.add(array, target, **dict(zip(("min", "max"), limits, strict=True)))


def glb(
    shape: ExportShape, extras: dict[str, Any], per_m: float, unit: str, animation: Animation | None = None
) -> bytes:
    """The file. ``extras`` stand in the asset; with an animation the target's node moves in N."""
    buffer, meshes = _Buffer(), list[dict[str, Any]]()
    parts = {"surface": shape.faces[~shape.invented], "invented": shape.faces[shape.invented]}
    parts = {name: faces for name, faces in parts.items() if len(faces)}
    for name, faces in parts.items() or [("landmarks", None)]:
        used = np.arange(len(shape.vertices))
        if faces is not None:
            used, index = np.unique(faces, return_inverse=True)
        attributes = dict[str, int]()
        position = (per_m * shape.vertices[used]).astype("<f4")
        attributes["POSITION"] = buffer.add_with_limits(position, _VERTICES)
        if faces is not None:
            n = shape.normals[used]
            length = np.linalg.norm(n, axis=1, keepdims=True)
            # the standard asks for unit length; a vertex of no area has none of its own
            n = np.where(length > 0.5, n / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
            attributes["NORMAL"] = buffer.add(n.astype("<f4"), _VERTICES)
        rgba = np.ascontiguousarray(shape.rgba[used])
        attributes["COLOR_0"] = buffer.add(rgba, _VERTICES, normalized=True)
        sigma = np.where(np.isfinite(shape.sigma_m), per_m * shape.sigma_m, -1.0)[used].astype("<f4")
        attributes[f"_SIGMA_{unit.upper()}"] = buffer.add(sigma, _VERTICES)
        primitive: dict[str, Any] = {"attributes": attributes}
        if faces is not None:
            primitive["indices"] = buffer.add(index.reshape(-1).astype("<u4"), _INDICES)
        primitive |= {"material": 0, "mode": _POINTS if faces is None else _TRIANGLES}
        meshes.append({"name": name, "primitives": [primitive]})
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
        # channels of the target's node, which is at its first pose; both have the same key times
        wxyz = continuous_wxyz(wxyz_from_matrix(animation.X_NF[:, :3, :3]))
        paths = {"rotation": wxyz[:, [1, 2, 3, 0]], "translation": per_m * animation.X_NF[:, :3, 3]}
        keys = buffer.add_with_limits(animation.time_s.astype("<f4"))
        samplers, channels = list[dict[str, Any]](), list[dict[str, Any]]()
        for k, (path, exact) in enumerate(paths.items()):
            values = exact.astype("<f4")
            target[path] = values[0].tolist()
            samplers.append({"input": keys, "interpolation": "LINEAR", "output": buffer.add(values)})
            channels.append({"sampler": k, "target": {"node": 0, "path": path}})
        content["animations"] = [{"name": "tumble", "samplers": samplers, "channels": channels}]
    content |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode("ascii")
    chunks = ((b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", bytes(buffer.content)))
    body = b"".join(struct.pack("<I", len(chunk)) + kind + chunk for kind, chunk in chunks)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body
