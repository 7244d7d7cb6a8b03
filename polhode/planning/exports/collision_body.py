"""What the convex pieces are made of: the mesh alone, or with it what is known to be there beside the mesh.

Outlines show booms and panels that stereo never measured, and no frame excludes what lies in shadow. Where a
run has an occupancy, its cells belong to the body like the mesh: the pieces contain the triangles of the mesh
and the faces of the outermost cells, and the closed surface of both decides what is inside. It is that of a
keep-out volume, without any growth for the mesh's sigmas.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Ints
from polhode.planning.keep_out.measured_body import STATES, Cover, Covered, grown_body, what_to_cover
from polhode.records.occupancy import Occupancy
from polhode.records.surface import SurfaceModel

CELLS = 96
"""Of the closed surface's grid, along the body's longest side: one is as long as the pieces may protrude."""
HALF = 0.5
"""Probability of a miss; without sigmas it has no effect."""
WORDS: dict[Covered, str] = {
    "possible": "they cover the mesh, what the outlines of several frames show beside it, and what no frame "
    "excludes, without margins for sigmas",
    "outlines": "they cover the mesh and what the outlines of several frames show beside it, without margins "
    "for sigmas",
    "surface": "they cover the mesh alone",
    "hull": "they cover the convex hull of what was measured and of what outlines show",
}


@dataclass(frozen=True)
class CollisionBody:
    """What the pieces have to contain, in F."""

    surface: trimesh.Trimesh
    """All triangles that they have to contain"""
    closed: trimesh.Trimesh
    """Surface of the body that these belong to, from which the pieces should not protrude"""
    words: str
    """What is covered"""


def collision_body(
    surface: SurfaceModel, occupied: Occupancy | None, cover: Cover, X_FG: Array
) -> CollisionBody:
    """The body that a choice means, in F; X_FG (4, 4).

    occupied: None for a run without it. Raises InputError: the choice needs one.
    """
    is_old = cover == "auto" and occupied is None
    covers: Covered = "surface" if is_old else what_to_cover(surface.mesh, occupied, cover)
    mesh = trimesh.Trimesh(surface.mesh.vertices, surface.mesh.faces, process=False)
    whole = closed = mesh
    if occupied is not None and STATES[covers]:
        chosen = np.isin(occupied.state, STATES[covers])
        whole = _together(mesh, cell_faces(occupied, chosen))
    if covers == "hull":
        closed = whole.convex_hull
    elif covers != "surface":
        exact = replace(surface, sigma_m=np.zeros(len(mesh.vertices)))
        closed = grown_body(exact, HALF, CELLS, covers, occupied).grid.mesh()
    return CollisionBody(_moved(whole, X_FG), _moved(closed, X_FG), WORDS[covers])


def cell_faces(occupied: Occupancy, chosen: NDArray[np.bool_]) -> trimesh.Trimesh:
    """The faces of chosen cells (nx, ny, nz) that no other chosen cell shares, in G."""
    padded = np.pad(chosen, 1)
    corners = list[Array]()
    for axis in range(3):
        beside = np.roll(np.eye(3)[axis], 1), np.roll(np.eye(3)[axis], 2)
        for side in (-1, 1):
            shared = np.roll(padded, -side, axis)[1:-1, 1:-1, 1:-1]
            middle = np.argwhere(chosen & ~shared) + 0.5 * side * np.eye(3)[axis]
            around = [0.5 * (u * beside[0] + side * v * beside[1]) for u, v in _AROUND]
            corners.append(middle[:, None] + np.stack(around))
    quads = occupied.origin_G + occupied.step_m * np.concatenate(corners).reshape(-1, 3)
    first: Ints = 4 * np.arange(len(quads) // 4)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return trimesh.Trimesh(quads, faces, process=True)


_AROUND = (-1, -1), (1, -1), (1, 1), (-1, 1)


def _together(a: trimesh.Trimesh, b: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = np.concatenate([a.faces, len(a.vertices) + b.faces])
    return trimesh.Trimesh(np.concatenate([a.vertices, b.vertices]), faces, process=False)


def _moved(mesh: trimesh.Trimesh, X_FG: Array) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(X_FG)
