"""A surface over one closed loop of points: even triangles in its plane, else of least area."""

import numpy as np
from scipy.sparse import coo_matrix, eye_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay, QhullError

from polhode.lie import Array
from polhode.records import Bools, Ints

_SIMPLE_SHARE = 0.02
"""Area by which a triangulation in the plane may differ from the loop's own."""
_MOST_CORNERS = 90
"""A crooked loop with more corners is left open: the search for the least area grows with their cube."""


def fill_loop(loop: Array, taken: set[tuple[int, int]]) -> tuple[Array, Ints] | None:
    """New points (m, 3) and triangles (t, 3) over a loop (n, 3) [m], wound as the loop runs.

    Triangles index the loop, then the new points. ``taken``: pairs of corners (a < b) that other faces join
    already; no edge may be used a third time. None where no sound surface is found.
    """
    if len(loop) == 3:
        return np.zeros((0, 3)), np.array([[0, 1, 2]])
    flat = _even(loop)
    if flat is not None and not _inner_edges(flat[1], len(loop)) & taken:
        return flat
    faces = _least_area(loop, taken) if len(loop) <= _MOST_CORNERS else None
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
    """Delaunay triangles in the loop's plane, with points as far apart as the loop's; None: it overlaps."""
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
    faces = faces[_inside(points[faces].mean(axis=1), flat)]
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
    grid = grid[_inside(grid, flat)]
    following = np.roll(flat, -1, axis=0)
    side = following - flat
    share = np.einsum("gnk,nk->gn", grid[:, None] - flat, side) / np.maximum(np.sum(side**2, axis=1), 1e-30)
    nearest = flat + share.clip(0.0, 1.0)[..., None] * side
    away = np.linalg.norm(grid[:, None] - nearest, axis=2).min(axis=1, initial=np.inf)
    return np.asarray(grid[away > 0.6 * step])


def _membrane(loop: Array, inner: Array, faces: Ints) -> Array:
    """Inner points (m, 3) along the plane's axes: heights as of a skin, each the mean of its neighbours."""
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


def _least_area(loop: Array, taken: set[tuple[int, int]]) -> Ints | None:
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
    """Whether the triangles' border is the loop, each side once and in its direction."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ahead = {(int(a), int(b)) for a, b in edges}
    border = {(a, b) for a, b in ahead if (b, a) not in ahead}
    return border == {(k, (k + 1) % n) for k in range(n)}


def _area(flat: Array) -> float:
    """Of a polygon (n, 2) that runs to the left around it."""
    return 0.5 * float(_cross(flat, np.roll(flat, -1, axis=0)).sum())


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _inside(points: Array, flat: Array) -> Bools:
    """(g,) true inside a polygon (n, 2), by the parity of crossings."""
    following = np.roll(flat, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    crosses = (flat[:, 1] > y) != (following[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = flat[:, 0] + (y - flat[:, 1]) * (following[:, 0] - flat[:, 0]) / (following[:, 1] - flat[:, 1])
    return np.asarray(np.sum(crosses & (x < at), axis=1) % 2 == 1)
