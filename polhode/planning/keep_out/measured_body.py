"""The body, grown by the uncertainty of its surface: a signed distance on a grid in G.

It is the union of three parts: what stereo measured with all that it encloses, cells that hold matter by the
outlines of several frames, and cells that no frame excludes (``mapping/occupancy.py``). Each point of its
surface knows to which of them it belongs.

The margin is a number of sigmas within which all points of the surface lie simultaneously: for Gaussian
errors independent from point to point the number follows from their count, and positive correlation makes the
event more likely (Slepian's inequality, Bell Syst. Tech. J. 41, 1962).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt, label, map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.special import ndtri
from skimage.measure import marching_cubes

from polhode.geometry.lie import Array
from polhode.planning.keep_out.distance_fields import closest
from polhode.records.occupancy import EMPTY, OUTLINED, POSSIBLE, Occupancy
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError

Floats = NDArray[np.float32]
Cover = Literal["auto", "possible", "outlines", "surface", "hull"]
Covered = Literal["possible", "outlines", "surface", "hull"]
MEASURED = 0
REASONS = ("measured", "seen in outlines", "not excluded")
"""Why a place belongs to the body: MEASURED, or by the state of its cell"""
STATES: dict[Covered, tuple[int, ...]] = {
    "possible": (OUTLINED, POSSIBLE), "outlines": (OUTLINED,),
    "surface": (), "hull": (OUTLINED,),
}  # fmt: skip
"""Cells of the occupancy that belong to the body, by what it covers"""
CERTAIN_SIGMAS = 2.0
"""Of the surface: what lies within them is never cut off"""
OPEN_SHARE = 0.01
"""Without an occupancy a mesh whose open boundaries span more than this share of its area is replaced by its
hull."""
MOST_GROWTH = 2.5
"""Of the grid by the margins, over the size of the body, without larger cells"""
HALF_DIAGONAL = 0.5 * 3.0**0.5
"""Of a cell, over its edge"""
SPARSE_CELLS = 4.0
"""Distance of points of the surface on which errors of the pose are looked at"""
CHUNK = 500
"""Points at a time, which fit into the processor's cache."""
PLANES = 600
"""Largest faces of the hull whose planes bound it, besides those in evenly spread directions."""


@dataclass(frozen=True)
class ScalarGrid:
    """Values at the corners of cubes, interpolated linearly."""

    origin: Array
    """(3,) position of the first corner [m]"""
    step_m: float
    values: Floats
    """(nx, ny, nz)"""

    def at(self, points: Array) -> Array:
        """Values (n,) at points (n, 3); outside, a lower bound of a distance."""
        q = (np.asarray(points, dtype=np.float64) - self.origin) / self.step_m
        inside = np.clip(q, 0.0, np.array(self.values.shape) - 1.0)
        found = map_coordinates(self.values, inside.T, order=1, mode="nearest")
        away = self.step_m * np.linalg.norm(q - inside, axis=1)
        return np.asarray(np.where(away > 0.0, np.hypot(away, np.maximum(found, 0.0)), found))

    def corners(self) -> Array:
        """(nx ny nz, 3)"""
        axes = [o + self.step_m * np.arange(n) for o, n in zip(self.origin, self.values.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def mesh(self, level: float = 0.0) -> trimesh.Trimesh:
        """The surface at a level; closed when the level does not reach the border."""
        V, F, _, _ = marching_cubes(self.values, level)
        p = V * self.step_m + self.origin
        mesh = trimesh.Trimesh(p, F, process=True)
        # two vertices that nearly coincide, where the surface nearly touches itself, stay apart
        return mesh if mesh.is_watertight else trimesh.Trimesh(p, F, process=False)


@dataclass(frozen=True)
class MeasuredBody:
    """The volume to be kept out of, fixed to the target."""

    grid: ScalarGrid
    """signed distance to the grown surface [m]"""
    points_G: Array
    """(m, 3) points on the grown surface, about a cell apart"""
    sigmas: float
    """number of the surface's sigmas by which it was grown"""
    margin_m: float
    """median growth"""
    pad_m: float
    """added everywhere for what the grid cannot resolve"""
    covers: Covered
    open_share: float
    """area that open boundaries span, over the area of the surface"""
    reason: NDArray[np.uint8]
    """(nx, ny, nz) which of REASONS the place of the body nearest to a corner of the grid belongs to"""

    @cached_property
    def sparse_points_G(self) -> Array:
        """(m, 3) some of them, that stand for the others where errors of the pose are looked at"""
        return thinned_vertices(trimesh.Trimesh(self.points_G), SPARSE_CELLS * self.grid.step_m)

    @property
    def radius_m(self) -> float:
        """Of the smallest sphere about ``centre_G`` that contains it."""
        return float(np.linalg.norm(self.points_G - self.centre_G, axis=1).max())

    @property
    def centre_G(self) -> Array:
        """(3,) centre of its bounding box"""
        return np.asarray(0.5 * (self.points_G.min(axis=0) + self.points_G.max(axis=0)))


def simultaneous_sigmas(count: int, miss: float) -> float:
    """Sigmas below which ``count`` independent errors all stay with the probability 1 - ``miss``."""
    return float(-ndtri(-np.expm1(np.log1p(-miss) / max(count, 1))))


def what_to_cover(mesh: trimesh.Trimesh, occupied: Occupancy | None, cover: Cover) -> Covered:
    """What a choice means for a run. Raises InputError: a run without an occupancy."""
    if cover in ("possible", "outlines") and occupied is None:
        raise InputError(f"--cover {cover}: the run has no occupancy.npz; run it again, or --cover hull")
    if cover != "auto":
        return cover
    if occupied is not None:
        return "possible"
    return "hull" if rim_share(mesh) > OPEN_SHARE else "surface"


def grown_body(
    surface: SurfaceModel,
    miss: float,
    cells: int = 64,
    cover: Cover = "auto",
    occupied: Occupancy | None = None,
) -> MeasuredBody:
    """The body that contains the true surface with the probability 1 - ``miss``.

    ``cells`` along its longest side; ``occupied``: None for a run without it. Raises ValueError when the
    surface has no faces; InputError as ``what_to_cover``, and where it is hardly known.
    """
    mesh = surface.mesh
    if len(mesh.faces) == 0:
        raise ValueError("the mesh has no faces")
    covers = what_to_cover(mesh, occupied, cover)
    sigmas = simultaneous_sigmas(len(mesh.vertices), miss)
    margin = sigmas * continuous_sigma(surface)
    centres, radius_m = np.zeros((0, 3)), 0.0
    if occupied is not None:
        centres, radius_m = occupied.centres(*STATES[covers]), HALF_DIAGONAL * occupied.step_m
    known_m = float(np.median(margin))
    if known_m > mesh.extents.max():
        raise InputError(f"the surface is known to within {known_m:.3g} m only: no keep-out volume")
    ends = np.concatenate([np.asarray(mesh.vertices), centres])
    low, high = ends.min(axis=0), ends.max(axis=0)
    most_m, size_m = max(float(margin.max()), radius_m), float((high - low).max())
    # a surface that is hardly known is coarser
    step = max(size_m, (size_m + 2.0 * most_m) / MOST_GROWTH) / cells
    border = most_m + 4.0 * step
    shape = tuple(np.ceil((high - low + 2.0 * border) / step).astype(int) + 1)
    empty = ScalarGrid(low - border, step, np.zeros(shape, dtype=np.float32))
    q, normal, m = sample_surface(mesh, margin, 0.5 * step)
    few, certain = _thinned(q, m, 0.25 * step), CERTAIN_SIGMAS / sigmas
    reach, sky_m = m, None
    if occupied is not None and covers != "hull":
        sky_m = _depth_in_sky(occupied, empty.corners())
        reach = np.where(_depth_in_sky(occupied, q + m[:, None] * normal) > 0.0, certain * m, m)
    outermost = q + reach[:, None] * normal
    reason = np.full(shape, MEASURED, dtype=np.uint8)
    if covers == "hull":
        of_hull = np.concatenate([q[few], centres]), np.concatenate([m[few], np.full(len(centres), radius_m)])
        values = _hull_distance(empty.corners(), *of_hull)
        reason[:] = POSSIBLE
        reason[_grown_distance(empty, q[few], normal[few], m[few]).reshape(shape) < 2.0 * step] = MEASURED
        outermost = np.concatenate([outermost, centres])
    else:
        values = _grown_distance(empty, q[few], normal[few], m[few], sky_m, certain)
        for state in STATES[covers]:
            assert occupied is not None
            to_cells = _distance_to_cells(empty, occupied, state) - radius_m
            reason.reshape(-1)[to_cells < values] = state
            values = np.minimum(values, to_cells)
            outermost = np.concatenate([outermost, occupied.centres(state)])
    grid = ScalarGrid(empty.origin, step, values.reshape(shape).astype(np.float32))
    pad = max(0.0, float(grid.at(outermost).max()), float(grid.at(q).max()))
    grid = ScalarGrid(grid.origin, step, _fill_cavities(grid.values - np.float32(pad)))
    return MeasuredBody(
        *(grid, thinned_vertices(grid.mesh(), step), sigmas, known_m, pad),
        *(covers, rim_share(mesh), reason),
    )


def _depth_in_sky(occupied: Occupancy, p_G: Array) -> Array:
    """How deep (n,) places (n, 3) are in space before the sky, beyond the first of its cells [m]; below 0
    elsewhere, and outside of the grid, where nothing is known.
    """
    is_empty = occupied.state == EMPTY
    depth = distance_transform_edt(is_empty) - distance_transform_edt(~is_empty) - 1.0
    place = (p_G - occupied.origin_G) / occupied.step_m
    return np.asarray(occupied.step_m * map_coordinates(depth, place.T, order=1, cval=-np.inf))


def _distance_to_cells(grid: ScalarGrid, occupied: Occupancy, state: int) -> Array:
    """Distance (cells,) from the corners of a grid to the nearest cell of a state, 0 in one; inf: there is
    none.
    """
    chosen, corners = occupied.state == state, grid.corners()
    outermost = occupied.origin_G + occupied.step_m * np.argwhere(chosen & ~binary_erosion(chosen))
    if len(outermost) == 0:
        return np.full(grid.values.size, np.inf)
    nearest = closest(grid.origin, grid.step_m, grid.values.shape, outermost, np.zeros(len(outermost)))
    away = np.linalg.norm(corners - outermost[nearest.reshape(-1)], axis=1)
    return np.asarray(np.where(occupied.states_at(corners) == state, 0.0, away))


def continuous_sigma(surface: SurfaceModel) -> Array:
    """Sigma (V,) of each vertex, no larger than a neighbour's plus the distance to it [m].

    A vertex that few frames saw obliquely may have many times the sigma of vertices a millimetre away. The
    surface is continuous: at one sigma it deviates from the mesh by 45 degrees at most. Vertices without a
    sigma start from the 99th percentile of the others.
    """
    known = np.isfinite(surface.sigma_m)
    unknown = float(np.quantile(surface.sigma_m[known], 0.99)) if known.any() else 0.0
    sigma = np.where(known, surface.sigma_m, unknown)
    V, edges = np.asarray(surface.mesh.vertices), np.asarray(surface.mesh.edges_unique)
    count, length = len(V), np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    # shortest paths along edges from a node at the distance sigma from each vertex; no edge has length 0
    start = np.concatenate([edges[:, 0], np.full(count, count)])
    end = np.concatenate([edges[:, 1], np.arange(count)])
    lengths = np.maximum(np.concatenate([length, sigma]), 1e-12)
    graph = coo_matrix((lengths, (start, end)), shape=(count + 1, count + 1)).tocsr()
    return np.asarray(np.minimum(sigma, dijkstra(graph, directed=False, indices=count)[:count]))


def rim_share(mesh: trimesh.Trimesh) -> float:
    """Area that open boundaries span, by their vector areas, over the area of the surface."""
    unique = mesh.edges_unique_inverse
    rim = np.asarray(mesh.edges)[np.bincount(unique)[unique] == 1]
    if len(rim) == 0:
        return 0.0
    loops = trimesh.graph.connected_component_labels(rim, node_count=len(mesh.vertices))[rim[:, 0]]
    p = np.asarray(mesh.vertices)
    a, b = p[rim[:, 0]] - p.mean(axis=0), p[rim[:, 1]] - p.mean(axis=0)
    area = np.zeros((loops.max() + 1, 3))
    np.add.at(area, loops, 0.5 * np.cross(a, b))
    return float(np.linalg.norm(area, axis=1).sum() / mesh.area)


def sample_surface(mesh: trimesh.Trimesh, margin: Array, spacing_m: float) -> tuple[Array, Array, Array]:
    """Points (n, 3) at most this far apart, their normals (n, 3), the margin there (n,) [m].

    Vertices, and on faces that are larger a lattice.
    """
    V, F = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    N = trimesh.geometry.mean_vertex_normals(len(V), F, mesh.face_normals)
    corner = V[F]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    divisions = np.ceil(longest / spacing_m).astype(int)
    points, normals, margins = [V], [N], [margin]
    for n in np.unique(divisions[divisions > 1]):
        chosen = F[divisions == n]
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        weights = np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n
        points.append((weights @ V[chosen]).reshape(-1, 3))
        flat = np.repeat(mesh.face_normals[divisions == n], len(weights), axis=0)
        normals.append(flat)
        # the largest of a face's corners: conservative
        margins.append(np.repeat(margin[chosen].max(axis=1), len(weights)))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(margins)


def thinned_vertices(mesh: trimesh.Trimesh, cell_m: float) -> Array:
    """Vertices (m, 3), one in each cube of this size: the one farthest from the centre."""
    p = np.asarray(mesh.vertices, dtype=np.float64)
    far = np.linalg.norm(p - 0.5 * (p.min(axis=0) + p.max(axis=0)), axis=1)
    return p[_thinned(p, far, cell_m)]


def _thinned(q: Array, margin: Array, cell_m: float) -> NDArray[np.int64]:
    """One point (m,) of each cube of this size: that of the largest margin."""
    order = np.argsort(-margin, kind="stable")
    cell = np.floor((q[order] - q.min(axis=0)) / cell_m).astype(np.int64)
    size = cell.max(axis=0) + 1
    _, first = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True)
    return np.sort(order[first])


def _grown_distance(
    grid: ScalarGrid,
    q: Array,
    normal: Array,
    margin: Array,
    sky_m: Array | None = None,
    certain: float = 1.0,
) -> Array:
    """Minimum of distance minus margin over the points, negative inside (cells,); only a certain share of the
    margin is added to cells whose depth in the sky (cells,) is above 0.
    """
    corners, shape = grid.corners(), grid.values.shape
    nearest = closest(grid.origin, grid.step_m, shape, q, np.zeros(len(q))).reshape(-1)
    grown = closest(grid.origin, grid.step_m, shape, q, margin).reshape(-1)
    distance = np.linalg.norm(corners - q[nearest], axis=1)
    # cells that no path from the border reaches without crossing the surface
    inside = cavities(distance.reshape(shape) - 0.5 * grid.step_m).reshape(-1)
    behind = np.einsum("ij,ij->i", corners - q[nearest], normal[nearest]) < 0.0
    inside |= behind & (distance <= 0.87 * grid.step_m)
    to_grown = np.linalg.norm(corners - q[grown], axis=1)
    out = to_grown - margin[grown]
    if sky_m is not None:
        least = np.minimum(distance - certain * margin[nearest], to_grown - certain * margin[grown])
        out = np.maximum(out, np.minimum(sky_m, least))
    return np.asarray(np.where(inside, np.minimum(out, -distance - margin[nearest]), out))


def cavities(values: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Cells > 0 without a connection to the outside."""
    free, _ = label(values > 0.0)
    return np.asarray((free != free[0, 0, 0]) & (values > 0.0))


def _fill_cavities(values: Floats) -> Floats:
    """Cavities count as inside."""
    return np.where(cavities(values), -np.abs(values) - np.float32(1e-6), values)


def _hull_distance(corners: Array, q: Array, margin: Array) -> Array:
    """Distance to planes around the convex hull, a lower bound of that to the hull (cells,)."""
    u = np.asarray(trimesh.creation.icosphere(2).vertices)
    hull = trimesh.convex.convex_hull(q)
    large = np.argsort(-hull.area_faces)[:PLANES]
    u = np.concatenate([u, np.unique(np.round(hull.face_normals[large], 2), axis=0)])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    support = np.full(len(u), -np.inf)
    for part in np.array_split(np.arange(len(q)), max(1, len(q) // CHUNK)):
        support = np.maximum(support, (q[part] @ u.T + margin[part, None]).max(axis=0))
    out = np.empty(len(corners))
    for part in np.array_split(np.arange(len(corners)), max(1, len(corners) // CHUNK)):
        out[part] = (corners[part] @ u.T - support).max(axis=1)
    return out
