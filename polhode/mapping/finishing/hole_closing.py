"""Small holes of the surface are closed and every new face is flagged as invented; large holes stay open.

A hole is a closed loop of edges that have a face on one side only. It is closed when it is small and no frame
shows an opening there, such as a window between struts. The patch is a Delaunay triangulation in the
loop's plane, or the triangulation of least area where the loop is not nearly flat.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from scipy.sparse import coo_matrix, eye_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay, QhullError
from skimage.measure import points_in_poly
from trimesh.visual import ColorVisuals

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.mapping.mesh_geometry import boundary_edges, piece_areas
from polhode.mapping.visibility import MIN_COSINE, Caster, FrameView, pixels_of
from polhode.records.surface import SurfaceModel

_MAX_CORNERS = 400
_MIN_BODY = 2.0
"""Minimum area of the piece around a hole, over that of the hole: the outline of a scrap is no hole."""
_OUTSIDE_PX = 2.5
"""A pixel shows the background where the nearest pixel of the silhouette is farther away."""
_STEP_PX = np.arange(-int(_OUTSIDE_PX), int(_OUTSIDE_PX) + 1)
_OUTSIDE = (np.hypot(_STEP_PX, _STEP_PX[:, None]) <= _OUTSIDE_PX).astype(np.uint8)
"""The pixels within this distance"""
_MAX_THROUGH = 0.25
"""Maximum share of unoccluded views of a hole that see through it."""


@dataclass(frozen=True)
class ClosedHoles:
    """What was closed, and what was not."""

    surface: SurfaceModel
    closed: int
    left_open: int
    """Small enough, but frames see through them, or no sound patch was found"""


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
    With views and rig, holes that they see through stay open. ``caster``: of the surface's mesh, if any.
    """
    mesh = surface.mesh
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) == 0 or largest_m <= 0.0:
        return ClosedHoles(surface, 0, 0)
    small = [loop for loop in _holes(faces) if _across(vertices[loop]) <= largest_m]
    patches = list(_patches(vertices, faces, small))
    if patches and views and rig is not None:
        patches = _not_seen_through(mesh, patches, views, rig, caster or Caster(mesh))
    return ClosedHoles(_with(surface, patches), len(patches), len(small) - len(patches))


def _holes(faces: Ints) -> list[Ints]:
    """The loops, except outlines of single faces that touch the rest at corners only."""
    loops = boundary_loops(faces)
    lone = np.array([np.sort(loop) for loop in loops if len(loop) == 3], dtype=np.int64).reshape(-1, 3)
    near = np.isin(faces, lone).all(axis=1)
    there = {tuple(face) for face in np.sort(faces[near], axis=1).tolist()}
    return [loop for loop in loops if len(loop) > 3 or tuple(sorted(loop.tolist())) not in there]


def boundary_loops(faces: Ints) -> list[Ints]:
    """Loops of vertices along the edges with one face, against the faces' winding, so that a face wound as
    the loop runs continues the surface. A loop that touches itself is split."""
    after: dict[int, list[int]] = {}
    for a, b in boundary_edges(np.asarray(faces, dtype=np.int64)).tolist():
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
    """The largest distance between two points of a loop [m]; infinite for loops of too many corners."""
    if len(points) > _MAX_CORNERS:
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
        if trimesh.triangles.area(corner).sum() * _MIN_BODY < piece_area[piece[loop[0]]]:
            rim = triangles[(triangles < len(loop)).all(axis=1)]
            for a, b in loop[rim[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)].tolist():
                around[a].add(b)
                around[b].add(a)
            yield _Patch(loop, points, triangles)


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


def _not_seen_through(
    mesh: trimesh.Trimesh,
    patches: list[_Patch],
    views: Sequence[FrameView],
    rig: RectifiedRig,
    caster: Caster,
) -> list[_Patch]:
    """The patches that the frames do not see through.

    An unoccluded view of a patch sees through it when the image shows the background there, or when the next
    surface behind it faces the camera: behind the skin of a body is the inner side of the opposite wall.
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
    seen, through = np.zeros(len(patches)), np.zeros(len(patches))
    for view in views:
        ray = p_G - view.eye_G
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / distance[:, None]
        row, column, inside = pixels_of(view, p_G, rig)
        towards = np.flatnonzero(inside & (np.einsum("nk,nk->n", direction, normal_G) < -MIN_COSINE))
        direction, distance = direction[towards], distance[towards]
        first, face = caster.first(view.eye_G, direction)
        clear = first > distance
        near = cv2.dilate(view.silhouette.astype(np.uint8), _OUTSIDE, borderValue=0)
        sky = near[row[towards], column[towards]] == 0
        a, b, c = vertices[faces[face]].transpose(1, 0, 2)
        behind = np.isfinite(first) & (np.einsum("nk,nk->n", direction, np.cross(b - a, c - a)) < 0.0)
        seen += np.bincount(of[towards[clear]], minlength=len(patches))
        through += np.bincount(of[towards[clear & (sky | behind)]], minlength=len(patches))
    kept = through <= _MAX_THROUGH * seen
    return [patch for patch, keep in zip(patches, kept, strict=True) if keep]


def _with(surface: SurfaceModel, patches: list[_Patch]) -> SurfaceModel:
    """The surface with the patches joined to it."""
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


_SIMPLE_SHARE = 0.02
"""Area by which a triangulation in the plane may differ from the loop's own."""
_MAX_LEAST_AREA_CORNERS = 90
"""A loop out of plane with more corners is left open: the search for the least area is cubic in them."""


def fill_loop(loop: Array, taken: set[tuple[int, int]]) -> tuple[Array, Ints] | None:
    """New points (m, 3) and triangles (t, 3) over a loop (n, 3) [m], wound as the loop runs.

    Triangles index the loop, then the new points. ``taken``: pairs of corners (a < b) that are edges of other
    faces: no edge may have three faces. None where no valid surface is found.
    """
    if len(loop) == 3:
        return np.zeros((0, 3)), np.array([[0, 1, 2]])
    flat = _even(loop)
    if flat is not None and not _inner_edges(flat[1], len(loop)) & taken:
        return flat
    faces = _min_area(loop, taken) if len(loop) <= _MAX_LEAST_AREA_CORNERS else None
    return None if faces is None else (np.zeros((0, 3)), faces)


def plane_of(loop: Array) -> tuple[Array, Array]:
    """Middle (3,) and axes (3, 3) of a loop; the third axis is its normal, around which it runs."""
    middle = loop.mean(axis=0)
    following = np.roll(loop, -1, axis=0)
    normal = 0.5 * np.cross(loop - middle, following - middle).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length < 1e-30:
        return middle, np.eye(3)
    normal /= length
    x = loop[0] - middle - normal * (normal @ (loop[0] - middle))
    if np.linalg.norm(x) < 1e-12:
        x = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    x /= np.linalg.norm(x)
    return middle, np.stack([x, np.cross(normal, x), normal], axis=1)


def _even(loop: Array) -> tuple[Array, Ints] | None:
    """Delaunay triangles in the loop's plane, with inner points at the loop's spacing; None: it overlaps."""
    middle, axes = plane_of(loop)
    flat = (loop - middle) @ axes[:, :2]
    area = _area(flat)
    step = float(np.mean(np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1)))
    if area < 0.05 * step**2:
        return None
    inner = _grid_inside(flat, step)
    points = np.concatenate([flat, inner])
    try:
        faces = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    except QhullError:
        return None
    faces = faces[points_in_poly(points[faces].mean(axis=1), flat)]
    corner = points[faces]
    twice = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    faces = np.where((twice < 0.0)[:, None], faces[:, ::-1], faces)
    faces, twice = faces[np.abs(twice) > 1e-9 * step**2], np.abs(twice)
    if abs(0.5 * twice.sum() - area) > _SIMPLE_SHARE * area or not _borders(faces, len(loop)):
        return None
    used = np.zeros(len(points), dtype=bool)
    used[faces] = True
    if not used.all():
        return None
    return middle + _membrane((loop - middle) @ axes, inner, faces) @ axes.T, faces


def _grid_inside(flat: Array, step: float) -> Array:
    """Points (m, 2) of a triangular grid inside a polygon (n, 2), not near its border."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    rows = np.arange(low[1] + step, high[1], step * 0.75**0.5)
    columns = np.arange(low[0], high[0] + step, step)
    x, y = np.meshgrid(columns, rows)
    x = x + 0.5 * step * (np.arange(len(rows)) % 2)[:, None]
    grid = np.stack([x.reshape(-1), y.reshape(-1)], axis=1)
    if len(grid) == 0:
        return grid
    grid = grid[points_in_poly(grid, flat)]
    following = np.roll(flat, -1, axis=0)
    side = following - flat
    share = np.einsum("gnk,nk->gn", grid[:, None] - flat, side) / np.maximum(np.sum(side**2, axis=1), 1e-30)
    nearest = flat + share.clip(0.0, 1.0)[..., None] * side
    away = np.linalg.norm(grid[:, None] - nearest, axis=2).min(axis=1, initial=np.inf)
    return np.asarray(grid[away > 0.6 * step])


def _membrane(loop: Array, inner: Array, faces: Ints) -> Array:
    """Inner points (m, 3) along the plane's axes; the height of each is the mean of its neighbours'."""
    n, m = len(loop), len(inner)
    if m == 0:
        return np.zeros((0, 3))
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    i, j = np.concatenate([edges, edges[:, ::-1]]).T
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(n + m, n + m)).tocsr()
    degree = np.asarray(graph.sum(axis=1)).reshape(-1)
    mean = graph.multiply(1.0 / degree[:, None]).tocsr()[n:]
    system = (eye_array(m) - mean[:, n:]).tocsc()
    height = np.atleast_1d(spsolve(system, mean[:, :n] @ loop[:, 2]))
    return np.column_stack([inner, height])


def _min_area(loop: Array, taken: set[tuple[int, int]]) -> Ints | None:
    """Triangles between the corners of a loop with the least area in sum (Barequet and Sharir 1995)."""
    n = len(loop)
    side = loop[None, :] - loop[:, None]
    cost = np.zeros((n, n))
    split = np.zeros((n, n), dtype=np.int64)
    closed = np.zeros((n, n), dtype=bool)
    for a, b in taken:
        closed[a, b] = b - a not in (1, n - 1)
    for width in range(2, n):
        low = np.arange(n - width)[:, None]
        high = low + width
        between = low + np.arange(1, width)[None, :]
        area = 0.5 * np.linalg.norm(np.cross(side[low, between], side[low, high]), axis=2)
        total = cost[low, between] + cost[between, high] + area
        best = np.argmin(total, axis=1)
        low, high = low[:, 0], high[:, 0]
        cost[low, high] = np.where(closed[low, high], np.inf, total[low, best])
        split[low, high] = low + 1 + best
    if not np.isfinite(cost[0, n - 1]):
        return None
    faces, stack = [], [(0, n - 1)]
    while stack:
        first, last = stack.pop()
        if last - first > 1:
            middle = int(split[first, last])
            faces.append((first, middle, last))
            stack += [(first, middle), (middle, last)]
    return np.array(faces, dtype=np.int64)


def _inner_edges(faces: Ints, n: int) -> set[tuple[int, int]]:
    """Edges between two corners of the loop that are not its own sides."""
    pairs = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    pairs = pairs[(pairs[:, 1] < n) & (pairs[:, 1] - pairs[:, 0] != 1) & (pairs[:, 1] - pairs[:, 0] != n - 1)]
    return {(int(a), int(b)) for a, b in pairs}


def _borders(faces: Ints, n: int) -> bool:
    """Whether the boundary of the triangles is the loop, each side once and in its direction."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ahead = {(int(a), int(b)) for a, b in edges}
    border = {(a, b) for a, b in ahead if (b, a) not in ahead}
    return border == {(k, (k + 1) % n) for k in range(n)}


def _area(flat: Array) -> float:
    """Area of a polygon (n, 2), positive if counterclockwise."""
    return 0.5 * float(_cross(flat, np.roll(flat, -1, axis=0)).sum())


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
