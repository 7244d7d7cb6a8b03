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
from scipy.spatial.distance import pdist
from skimage.measure import points_in_poly
from trimesh.visual import ColorVisuals

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.mapping.mesh_geometry import boundary_edges, piece_areas
from polhode.mapping.visibility import MIN_COSINE, Caster, FrameView, pixels_of
from polhode.records.surface import SurfaceModel

_OUTSIDE_PX = 2.5
"""A pixel shows the background where the nearest pixel of the silhouette is farther away."""


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
    loops = boundary_loops(faces)
    # outlines of single faces that touch the rest at corners only are no holes
    lone = np.array([np.sort(loop) for loop in loops if len(loop) == 3], dtype=np.int64).reshape(-1, 3)
    near = np.isin(faces, lone).all(axis=1)
    there = {tuple(face) for face in np.sort(faces[near], axis=1).tolist()}
    loops = [loop for loop in loops if len(loop) > 3 or tuple(sorted(loop.tolist())) not in there]
    small = [loop for loop in loops if len(loop) <= 400 and pdist(vertices[loop]).max() <= largest_m]
    patches = list(_patches(vertices, faces, small))
    if patches and views and rig is not None:
        patches = _not_seen_through(mesh, patches, views, rig, caster or Caster(mesh))
    return ClosedHoles(_with(surface, patches), len(patches), len(small) - len(patches))


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


def _patches(vertices: Array, faces: Ints, loops: list[Ints]) -> Iterator[_Patch]:
    piece, piece_area = piece_areas(vertices, faces)
    # the vertices that share a face with each one of a loop
    around: dict[int, set[int]] = {vertex: set() for loop in loops for vertex in loop.tolist()}
    wanted = np.zeros(len(vertices), dtype=bool)
    wanted[list(around)] = True
    for face in faces[wanted[faces].any(axis=1)].tolist():
        for vertex in face:
            if wanted[vertex]:
                around[vertex].update(face)
    for loop in loops:
        place = {int(vertex): k for k, vertex in enumerate(loop)}
        taken = {
            (k, place[other])
            for vertex, k in place.items()
            for other in around[vertex]
            if other in place and k < place[other]
        }
        found = fill_loop(vertices[loop], taken)
        if found is None:
            continue
        points, triangles = found
        corner = np.concatenate([vertices[loop], points])[triangles]
        # the outline of a scrap, whose area is not twice that of the hole, is none
        if trimesh.triangles.area(corner).sum() * 2.0 < piece_area[piece[loop[0]]]:
            rim = triangles[(triangles < len(loop)).all(axis=1)]
            for a, b in loop[_edges(rim)].tolist():
                around[a].add(b)
                around[b].add(a)
            yield _Patch(loop, points, triangles)


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
    step_px = np.arange(-int(_OUTSIDE_PX), int(_OUTSIDE_PX) + 1)
    disc = (np.hypot(step_px, step_px[:, None]) <= _OUTSIDE_PX).astype(np.uint8)
    for view in views:
        ray = p_G - view.eye_G
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / distance[:, None]
        row, column, inside = pixels_of(view, p_G, rig)
        towards = np.flatnonzero(inside & (np.einsum("nk,nk->n", direction, normal_G) < -MIN_COSINE))
        direction, distance = direction[towards], distance[towards]
        first, face = caster.first(view.eye_G, direction)
        clear = first > distance
        near = cv2.dilate(view.silhouette.astype(np.uint8), disc, borderValue=0)
        sky = near[row[towards], column[towards]] == 0
        a, b, c = vertices[faces[face]].transpose(1, 0, 2)
        behind = np.isfinite(first) & (np.einsum("nk,nk->n", direction, np.cross(b - a, c - a)) < 0.0)
        seen += np.bincount(of[towards[clear]], minlength=len(patches))
        through += np.bincount(of[towards[clear & (sky | behind)]], minlength=len(patches))
    # at most a quarter of the unoccluded views may see through it
    return [patch for patch, kept in zip(patches, through <= 0.25 * seen, strict=True) if kept]


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


def fill_loop(loop: Array, taken: set[tuple[int, int]]) -> tuple[Array, Ints] | None:
    """New points (m, 3) and triangles (t, 3) over a loop (n, 3) [m], wound as the loop runs.

    Triangles index the loop, then the new points. ``taken``: pairs of corners (a < b) that are edges of other
    faces: no edge may have three faces. None where no valid surface is found.
    """
    if len(loop) == 3:
        return np.zeros((0, 3)), np.array([[0, 1, 2]])
    n, flat = len(loop), _even(loop)
    # edges between two corners of the loop that are not its own sides
    a, b = _edges(flat[1]).T if flat is not None else np.zeros((2, 0), dtype=np.int64)
    inner = (np.maximum(a, b) < n) & (np.abs(a - b) != 1) & (np.abs(a - b) != n - 1)
    if (
        flat is not None
        and not {(min(e), max(e)) for e in zip(a[inner].tolist(), b[inner].tolist(), strict=True)} & taken
    ):
        return flat
    # out of plane, the search for the least area is cubic in the corners
    faces = _min_area(loop, taken) if n <= 90 else None
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
    # of the polygon, positive if counterclockwise
    area = 0.5 * float(_cross(flat, np.roll(flat, -1, axis=0)).sum())
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
    # the triangles fill the loop, their boundary is the loop, and they use all points
    ahead = {(a, b) for a, b in _edges(faces).tolist()}
    border = {(a, b) for a, b in ahead if (b, a) not in ahead}
    sides = {(k, (k + 1) % len(loop)) for k in range(len(loop))}
    if abs(0.5 * twice.sum() - area) > 0.02 * area or border != sides:
        return None
    if len(np.unique(faces)) < len(points):
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
    edges = np.unique(np.sort(_edges(faces), axis=1), axis=0)
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


def _edges(faces: Ints) -> Ints:
    """(n, 2) sides of triangles, as they are wound."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
