"""Binary PLY files: the surface of a run with the properties of its vertices and faces, and point clouds.

The same content gives the same bytes. trimesh reads these files; it writes no properties of our own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polhode.geometry.lie import Array

_TYPES = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<i4": "int"}
_FACE = np.dtype([("count", "u1"), ("index", "<i4", (3,)), ("invented", "u1")])


@dataclass(frozen=True)
class VertexColumns:
    """What is known of V vertices."""

    position: Array
    """(V, 3)"""
    normal: Array
    """(V, 3)"""
    rgba: NDArray[np.uint8]
    """(V, 4)"""
    sigma: Array
    """(V,) in the unit of the positions"""
    views: ArrayLike
    """(V,)"""
    coverage: ArrayLike
    """(V,)"""


def surface_ply(
    columns: VertexColumns,
    faces: ArrayLike,
    invented: ArrayLike,
    comments: Sequence[str],
    more_comments: Sequence[str] = (),
    unit: str = "m",
) -> bytes:
    """Position, normal, colour, sigma, views and coverage of V vertices; T triangles with ``invented``.

    faces (T, 3), invented (T,). The property of sigma is named with its unit, ``sigma_m`` or ``sigma_mm``.
    Between ``comments`` and ``more_comments`` one explains the properties.
    """
    sigma_name = f"sigma_{unit}"
    axes, channels = ("x", "y", "z"), ("red", "green", "blue", "alpha")
    fields = [*((name, "<f4") for name in axes), *((f"n{name}", "<f4") for name in axes)]
    fields += [
        *((name, "u1") for name in channels),
        (sigma_name, "<f4"),
        ("views", "<i4"),
        ("coverage", "u1"),
    ]
    vertex = np.zeros(len(columns.position), dtype=fields)
    for column, name in enumerate(axes):
        vertex[name], vertex[f"n{name}"] = columns.position[:, column], columns.normal[:, column]
    for column, name in enumerate(channels):
        vertex[name] = columns.rgba[:, column]
    vertex[sigma_name], vertex["views"] = columns.sigma, columns.views
    vertex["coverage"] = columns.coverage
    face = np.zeros(len(np.asarray(faces)), dtype=_FACE)
    face["count"], face["index"], face["invented"] = 3, faces, invented
    legend = f"{sigma_name} inf, views 0: not measured; coverage 0 unseen, 1 seen but never lit, 2 seen lit"
    return binary_ply(vertex, [*comments, legend, *more_comments], face)


def binary_ply(
    vertex: NDArray[np.void], comments: Sequence[str], face: NDArray[np.void] | None = None
) -> bytes:
    """A little-endian PLY of structured arrays: a property per field.

    The first two fields of ``face`` are the count, 3, and the three indices of vertices.
    """
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {len(vertex)}", *_properties(vertex.dtype)]
    if face is not None:
        lines += [f"element face {len(face)}", "property list uchar int vertex_indices"]
        lines += _properties(face.dtype, skipped=2)
    header = ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
    return header + vertex.tobytes() + (b"" if face is None else face.tobytes())


def _properties(dtype: np.dtype[Any], skipped: int = 0) -> list[str]:
    return [f"property {_TYPES[dtype[name].str]} {name}" for name in (dtype.names or ())[skipped:]]
