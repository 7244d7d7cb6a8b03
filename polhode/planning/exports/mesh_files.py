"""PLY, STL, OBJ and binary glTF. Lengths are multiplied by ``per_m`` (1000: millimetres).

Comments are lines of ASCII. glTF 2.0 (Khronos, ISO/IEC 12113:2022): a node ``target``
holds two meshes: ``surface`` and, if there is one, ``invented`` (faces that close small holes). Vertices have
the attribute ``_SIGMA_M`` (``_SIGMA_MM``); -1 stands for "not measured", because glTF allows no infinity. A
point cloud is drawn as points.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.files.ply import VertexColumns, surface_ply
from polhode.planning.exports.job import ExportShape


def ply(shape: ExportShape, comments: Sequence[str], per_m: float, unit: str) -> bytes:
    """Binary PLY: position, normal, colour, sigma, views, coverage; triangles with ``invented``.

    The property of sigma is ``sigma_m`` or ``sigma_mm``: its unit is in its name.
    """
    return surface_ply(
        VertexColumns(
            *(per_m * shape.vertices, shape.normals, shape.rgba),
            *(per_m * shape.sigma_m, shape.views, shape.coverage),
        ),
        faces=shape.faces,
        invented=shape.invented,
        comments=[ascii_line(text) for text in comments],
        unit=unit,
    )


def stl(shape: ExportShape, comment: str, per_m: float) -> bytes:
    """Binary STL: triangles alone; the header holds the first 80 bytes of the comment."""
    corners = (per_m * shape.vertices)[shape.faces].astype("<f4")
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
    facets["normal"] = normal / np.where(length > 0.0, length, 1.0)
    facets["corner"] = corners
    # a binary file that begins with "solid" would be taken for a text one
    header = f"binary STL; {ascii_line(comment)}".encode("ascii")[:80].ljust(80)
    return header + np.uint32(len(facets)).tobytes() + facets.tobytes()


def obj(shape: ExportShape, comments: Sequence[str], per_m: float) -> bytes:
    """Wavefront OBJ with normals; vertex lines end with red, green, blue in 0..1, as is common."""
    lines = [f"# {ascii_line(text)}" for text in comments]
    positions = (per_m * shape.vertices).tolist()
    colours = np.round(shape.rgba[:, :3] / 255.0, 4).tolist()
    lines += [
        f"v {x:.9g} {y:.9g} {z:.9g} {r:g} {g:g} {b:g}"
        for (x, y, z), (r, g, b) in zip(positions, colours, strict=True)
    ]
    if len(shape.faces):
        lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in shape.normals.tolist()]
        for name, chosen in (("surface", ~shape.invented), ("invented", shape.invented)):
            if chosen.any():
                lines.append(f"g {name}")
            lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (shape.faces[chosen] + 1).tolist()]
    else:
        lines += [f"p {k + 1}" for k in range(len(positions))]
    return ("\n".join(lines) + "\n").encode("ascii")


def ascii_line(text: str) -> str:
    """One line of ASCII; other characters become question marks."""
    return " ".join(text.split()).encode("ascii", "replace").decode("ascii")


_VERTICES, _INDICES = 34962, 34963
_TYPES: dict[str, int] = {"<f4": 5126, "|u1": 5121, "<u4": 5125}
_POINTS, _TRIANGLES = 0, 4


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


def glb(shape: ExportShape, extras: dict[str, Any], per_m: float, unit: str) -> bytes:
    """The file. ``extras`` stand in the asset."""
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
    content |= {
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode("ascii")
    chunks = ((b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", bytes(buffer.content)))
    body = b"".join(struct.pack("<I", len(chunk)) + kind + chunk for kind, chunk in chunks)
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body
