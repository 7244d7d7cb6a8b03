"""Small holes of the surface are closed, and every face that is invented so is flagged; large ones stay open.

A hole is a closed loop of edges that have a face on one side only. It is closed when it is small, and when
no frame looked through it: a window between struts is no hole in the knowledge of the surface.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from trimesh.visual import ColorVisuals

from polhode.camera import RectifiedRig
from polhode.lie import Array
from polhode.mapping.hole_filling import fill_loop
from polhode.mapping.mesh_loops import neighbours, piece_areas, rim_edges
from polhode.mapping.visibility import LEAST_COSINE, Caster, FrameView, pixels_of
from polhode.records import Bools, Ints, SurfaceModel

_MOST_CORNERS = 400
_LEAST_BODY = 2.0
"""A hole must have this many times its own area of surface around it: a scrap's outline is no hole."""
_OUTSIDE_PX = 2.5
"""A frame looks past the body where the nearest pixel of its silhouette is further."""
_STEP_PX = np.arange(-int(_OUTSIDE_PX), int(_OUTSIDE_PX) + 1)
_OUTSIDE = (np.hypot(_STEP_PX, _STEP_PX[:, None]) <= _OUTSIDE_PX).astype(np.uint8)
"""The pixels so near"""
_LOOKED_THROUGH = 0.25
"""Share of a hole's sights that may look through it."""


@dataclass(frozen=True)
class ClosedHoles:
    """What was closed, and what was not."""

    surface: SurfaceModel
    closed: int
    left_open: int
    """Small enough, but looked through or too crooked"""


@dataclass(frozen=True)
class _Patch:
    loop: Ints
    points: Array
    faces: Ints
    """into the loop, then the points"""


def close_small_holes(
    surface: SurfaceModel,
    largest_m: float,
    views: Sequence[FrameView] = (),
    rig: RectifiedRig | None = None,
    caster: Caster | None = None,
) -> ClosedHoles:
    """Close the holes that are at most ``largest_m`` across.

    New vertices have no views and an infinite sigma, and the grey of the rim; new faces are ``invented``.
    With views and rig, holes through which they looked stay open. ``caster``: of the surface's mesh, if there
    is one already.
    """
    mesh = surface.mesh
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) == 0 or largest_m <= 0.0:
        return ClosedHoles(surface, 0, 0)
    small = [loop for loop in _holes(faces) if _across(vertices[loop]) <= largest_m]
    patches = list(_patches(vertices, faces, small))
    if patches and views and rig is not None:
        patches = _not_looked_through(mesh, patches, views, rig, caster or Caster(mesh))
    return ClosedHoles(_with(surface, patches), len(patches), len(small) - len(patches))


def _holes(faces: Ints) -> list[Ints]:
    """The loops but for outlines of single faces, which hang on the rest by their corners."""
    loops = boundary_loops(faces)
    lone = np.array([np.sort(loop) for loop in loops if len(loop) == 3], dtype=np.int64).reshape(-1, 3)
    near = np.isin(faces, lone).all(axis=1)
    there = {tuple(face) for face in np.sort(faces[near], axis=1).tolist()}
    return [loop for loop in loops if len(loop) > 3 or tuple(sorted(loop.tolist())) not in there]


def boundary_loops(faces: Ints) -> list[Ints]:
    """Loops of vertices along the edges with one face, against the faces' winding, so that a face wound as
    the loop runs continues the surface. Where a loop touches itself it falls into several."""
    whole = np.asarray(faces, dtype=np.int64)
    near = neighbours(whole, int(whole.max()) + 1 if len(whole) else 0)
    rim: list[list[int]] = rim_edges(whole, *near).tolist()
    after: dict[int, list[int]] = {}
    for a, b in rim:
        after.setdefault(b, []).append(a)
    loops: list[Ints] = []
    for start in sorted(after):
        path, place = [start], {start: 0}
        while after.get(path[-1]):
            following = after[path[-1]].pop(0)
            if following not in place:
                place[following] = len(path)
                path.append(following)
                continue
            loop = path[place[following] :]
            for vertex in loop[1:]:
                del place[vertex]
            del path[place[following] + 1 :]
            if len(loop) >= 3:
                loops.append(np.array(loop, dtype=np.int64))
    return loops


def _across(points: Array) -> float:
    """The largest extent of a loop [m]: the diagonal of its box about its own axes."""
    if len(points) > _MOST_CORNERS:
        return float("inf")
    return float(np.linalg.norm(points[:, None] - points[None, :], axis=2).max())


def _patches(vertices: Array, faces: Ints, loops: list[Ints]) -> Iterator[_Patch]:
    piece, piece_area = piece_areas(vertices, faces)
    around = _neighbours(faces, np.unique(np.concatenate(loops)) if loops else np.zeros(0, dtype=np.int64))
    for loop in loops:
        place = {int(vertex): k for k, vertex in enumerate(loop)}
        taken = {
            (k, place[other])
            for vertex, k in place.items()
            for other in around.get(vertex, ())
            if other in place and k < place[other]
        }
        found = fill_loop(vertices[loop], taken)
        if found is None:
            continue
        points, triangles = found
        corner = np.concatenate([vertices[loop], points])[triangles]
        if _areas(corner).sum() * _LEAST_BODY < piece_area[piece[loop[0]]]:
            rim = triangles[(triangles < len(loop)).all(axis=1)]
            for a, b in loop[rim[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)].tolist():
                around[a].add(b)
                around[b].add(a)
            yield _Patch(loop, points, triangles)


def _areas(corner: Array) -> Array:
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def _neighbours(faces: Ints, of: Ints) -> dict[int, set[int]]:
    """The vertices that share a face with each of the given ones."""
    wanted = np.zeros(int(faces.max()) + 1, dtype=bool)
    wanted[of] = True
    near: dict[int, set[int]] = {}
    for face in faces[wanted[faces].any(axis=1)].tolist():
        for vertex in face:
            if wanted[vertex]:
                near.setdefault(vertex, set()).update(face)
    return near


def _not_looked_through(
    mesh: trimesh.Trimesh,
    patches: list[_Patch],
    views: Sequence[FrameView],
    rig: RectifiedRig,
    caster: Caster,
) -> list[_Patch]:
    """The patches that stay when the frames are asked.

    A sight of a patch that nothing hides looks through it when the image shows sky there, or when the next
    surface behind it faces the camera: behind the skin of a body comes the inside of its other side.
    """
    vertices = np.asarray(mesh.vertices)
    middles, normals, owner = [], [], []
    for k, patch in enumerate(patches):
        corner = np.concatenate([vertices[patch.loop], patch.points])[patch.faces]
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        middles.append(corner.mean(axis=1))
        normals.append(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30))
        owner.append(np.full(len(corner), k))
    p_G, normal_G, of = np.concatenate(middles), np.concatenate(normals), np.concatenate(owner)
    faces = np.asarray(mesh.faces)
    sights, through = np.zeros(len(patches)), np.zeros(len(patches))
    for view in views:
        ray = p_G - view.eye_G
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / distance[:, None]
        row, column, inside = pixels_of(view, p_G, rig)
        towards = np.flatnonzero(inside & (np.einsum("nk,nk->n", direction, normal_G) < -LEAST_COSINE))
        direction, distance = direction[towards], distance[towards]
        first, face = caster.first(view.eye_G, direction)
        clear = first > distance
        near = cv2.dilate(view.silhouette.astype(np.uint8), _OUTSIDE, borderValue=0)
        sky = near[row[towards], column[towards]] == 0
        a, b, c = vertices[faces[face]].transpose(1, 0, 2)
        behind = np.isfinite(first) & (np.einsum("nk,nk->n", direction, np.cross(b - a, c - a)) < 0.0)
        sights += np.bincount(of[towards[clear]], minlength=len(patches))
        through += np.bincount(of[towards[clear & (sky | behind)]], minlength=len(patches))
    kept = through <= _LOOKED_THROUGH * sights
    return [patch for patch, keep in zip(patches, kept, strict=True) if keep]


def _with(surface: SurfaceModel, patches: list[_Patch]) -> SurfaceModel:
    """The surface with the patches sewn in."""
    mesh = surface.mesh
    colours = mesh.visual.vertex_colors if isinstance(mesh.visual, ColorVisuals) else None
    vertices, faces = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)]
    rgba = [np.full((len(mesh.vertices), 4), 128, np.uint8) if colours is None else np.asarray(colours)]
    count = len(mesh.vertices)
    for patch in patches:
        index = np.concatenate([patch.loop, count + np.arange(len(patch.points))])
        vertices.append(patch.points)
        faces.append(index[patch.faces])
        rim = np.round(rgba[0][patch.loop].mean(axis=0)).astype(np.uint8)
        rgba.append(np.tile(rim, (len(patch.points), 1)))
        count += len(patch.points)
    new, new_faces = count - len(mesh.vertices), sum(map(len, faces)) - len(mesh.faces)
    flags: Bools = np.concatenate([surface.is_invented, np.ones(new_faces, dtype=bool)])
    closed = trimesh.Trimesh(
        np.concatenate(vertices), np.concatenate(faces), vertex_colors=np.concatenate(rgba), process=False
    )
    return replace(
        surface,
        mesh=closed,
        sigma_m=np.append(surface.sigma_m, np.full(new, np.inf)),
        views=np.append(surface.views, np.zeros(new, dtype=np.int64)),
        invented=flags,
    )
