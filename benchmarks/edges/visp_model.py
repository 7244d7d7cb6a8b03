"""A mesh as a model of ViSP's: its flat faces as polygons, and the text of a CAO file of them.

The format is described in ViSP's documentation (vpMbTracker::loadCAOModel). ViSP takes every side of every
polygon for an edge, hides edges behind polygons, and polygons that are wound clockwise as seen.
"""

from collections.abc import Sequence

import numpy as np
import trimesh

from polhode.errors import InputError
from polhode.lie import Array
from polhode.records import Ints

FLAT_DEG = 0.5
"""Neighbouring triangles that meet at less than this are one face."""


def polygons_of(mesh: trimesh.Trimesh) -> list[Array]:
    """Outlines (n, 3) of the mesh's flat faces [m], counter-clockwise from outside.

    Holes in a face are left out: the face is closed over them. Curved surfaces come as their facets, each an
    edge for ViSP: it is for bodies with flat sides.
    """
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    merged.merge_vertices()
    same = np.abs(merged.face_adjacency_angles) < np.deg2rad(FLAT_DEG)
    labels = trimesh.graph.connected_component_labels(
        merged.face_adjacency[same], node_count=len(merged.faces)
    )
    vertices, faces = np.asarray(merged.vertices), np.asarray(merged.faces)
    outlines = []
    for label in range(labels.max() + 1):
        loops = [vertices[loop] for loop in _loops(faces[labels == label])]
        outlines.append(max(loops, key=lambda loop: float(np.linalg.norm(_area_vector(loop)))))
    return outlines


def _loops(faces: Ints) -> list[list[int]]:
    """Rims of a patch of triangles (n, 3): vertices in order, closed."""
    sides = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in sides}
    after: dict[int, list[int]] = {}
    for a, b in sorted(there):
        if (b, a) not in there:
            after.setdefault(a, []).append(b)
    loops = []
    while after:
        first = here = next(iter(after))
        loop = []
        while here in after:
            loop.append(here)
            ahead = after[here].pop()
            if not after[here]:
                del after[here]
            here = ahead
            if here == first:
                break
        loops.append(loop)
    return loops


def _area_vector(loop: Array) -> Array:
    """Normal (3,) of a polygon (n, 3), as long as its area."""
    return np.asarray(0.5 * np.cross(loop, np.roll(loop, -1, axis=0)).sum(axis=0))


def cao_text(polygons: Sequence[Array]) -> str:
    """The text of a CAO file: polygons (n, 3) of three and more points; two points are a line, always seen.

    Raises InputError: no polygon, or one of a single point.
    """
    if not polygons or any(len(polygon) < 2 for polygon in polygons):
        raise InputError("a model of ViSP needs polygons, or lines of two points")
    points, index = np.unique(np.vstack(polygons).round(9), axis=0, return_inverse=True)
    each = np.split(index.reshape(-1), np.cumsum([len(polygon) for polygon in polygons])[:-1])
    lines = [corners for corners in each if len(corners) == 2]
    faces = [corners for corners in each if len(corners) > 2]
    rows = ["V1", "# points", str(len(points)), *(f"{x:.9f} {y:.9f} {z:.9f}" for x, y, z in points)]
    rows += ["# lines", str(len(lines)), *(f"{a} {b}" for a, b in lines)]
    rows += ["# faces of lines", "0", "# faces of points", str(len(faces))]
    rows += [" ".join(str(k) for k in [len(corners), *corners]) for corners in faces]
    return "\n".join([*rows, "# cylinders", "0", "# circles", "0", ""])
