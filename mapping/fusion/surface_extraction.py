"""The zero level of the field as a triangle mesh, with colour, standard deviation and views per vertex.

Marching cubes (Lewiner et al. 2003, scikit-image) runs over cubes of 64^3 voxels that share one layer;
vertices on shared layers have the same coordinates and are merged, so there are no seams and memory
follows the surface.

A voxel is known where enough frames saw it, agree, and few frames look through it. The number of frames alone
is a poor criterion: two frames that agree confirm each other, while many that disagree, as matching windows
do on a slanted surface without texture, confirm nothing.

A vertex's sigma has three parts: what independent noise leaves after averaging over the frames, a share of a
single view's sigma, and a share of the roughness. The last two do not average out: disparities are matched in
windows, so relief finer than a window is lost in every view alike, and all views share a part of their other
errors (texture, light, calibration). Both shares were tuned on four simulated bodies
(``benchmarks/mapping/mesh_quality.py``).
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from polhode.config.mapping import Mapping
from polhode.lie import Array
from polhode.mapping.fusion.block_grid import (
    COLOUR,
    COLOUR_WEIGHT,
    DISTANCE,
    EDGE,
    FREE,
    SQUARE,
    VIEWS,
    VOXELS,
    WEIGHT,
    BlockGrid,
    pack_keys,
    unpack_keys,
)
from polhode.mapping.mesh_geometry import min_spread, neighbour_sums, piece_areas
from polhode.records import Bools, Ints, SurfaceModel

_CHUNK = 8
"""Blocks along the edge of a chunk."""
_EDGE = _CHUNK * EDGE + 1
"""Voxels along it: one layer is shared with the next chunk."""
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class KnownVoxelCriteria:
    """What a voxel must show to count."""

    views: int
    """Frames that saw it"""
    agreeing: float
    """Two frames are enough where they scatter by less [voxels]"""
    scatter: float
    """Frames that scatter by more say nothing [voxels]"""
    carved: float
    """Most of the weight may come from frames that look through: this share"""

    @staticmethod
    def of(config: Mapping, views: int) -> "KnownVoxelCriteria":
        """As configured, with ``views`` frames."""
        return KnownVoxelCriteria(views, config.agreeing_voxels, config.scatter_voxels, config.carved_share)


@dataclass(frozen=True)
class SigmaShares:
    """What does not average out: of a single view's sigma, and over the roughness of the surface."""

    of_view: float
    of_relief: float


def empty_surface(warnings: tuple[str, ...] = ()) -> SurfaceModel:
    """What is returned when there is nothing to mesh."""
    mesh = trimesh.Trimesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64), process=False)
    return SurfaceModel(mesh=mesh, sigma_m=np.zeros(0), views=np.zeros(0, dtype=np.int64), warnings=warnings)


def extract_surface(
    grid: BlockGrid, support: KnownVoxelCriteria, least_piece_voxels: float, shares: SigmaShares
) -> SurfaceModel:
    """Mesh in G [m] of all voxels that count; empty when there are none.

    Pieces of less area than ``least_piece_voxels`` [faces of a voxel] are left out.
    """
    if len(grid) == 0:
        return empty_surface()
    values = grid.values.cpu().numpy()
    distance = _distances(values, known_voxels(values, grid.voxel_m, support), grid.cut.front_m, grid.voxel_m)
    first = np.unique(np.floor_divide(unpack_keys(grid.keys).cpu().numpy(), _CHUNK), axis=0) * _CHUNK
    parts = [part for corner in first if (part := _mesh_chunk(grid, corner, distance)) is not None]
    if not parts:
        return empty_surface()
    vertices, faces, edges, shares_of = _merge(parts)
    faces = _large_pieces(vertices, faces, least_piece_voxels)
    is_used = np.zeros(len(vertices), dtype=bool)
    is_used[faces] = True
    used = np.flatnonzero(is_used)
    if len(used) == 0:
        return empty_surface()
    renumber = np.full(len(vertices), -1, dtype=np.int64)
    renumber[used] = np.arange(len(used))
    of_vertices = _values_at(values, edges[used], shares_of[used], grid.cut.front_m)
    return _surface_model(vertices[used] * grid.voxel_m, renumber[faces], of_vertices, grid.voxel_m, shares)


def _distances(values: Floats, known: Bools, front_m: float, voxel_m: float) -> Floats:
    """(n, 512): signed distance in voxels, NaN where it is not known."""
    weight = values[..., WEIGHT] + values[..., FREE]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (values[..., DISTANCE] + front_m * values[..., FREE]) / (weight * np.float32(voxel_m))
    return np.where(known, mean, np.float32(np.nan)).astype(np.float32, copy=False)


def _values_at(values: Floats, edges: Ints, share: Floats, front_m: float) -> Floats:
    """(V, 4): sigmas of the mean and of one view [m], views, grey, on edges between voxels (V, 2)."""
    ends = []
    for column in (0, 1):
        c = values.reshape(-1, values.shape[-1])[edges[:, column]]
        weight = np.maximum(c[:, WEIGHT] + c[:, FREE], 1e-30)
        mean = (c[:, DISTANCE] + front_m * c[:, FREE]) / weight
        variance = np.maximum((c[:, SQUARE] + front_m**2 * c[:, FREE]) / weight - mean**2, 0.0)
        views = np.maximum(c[:, VIEWS], 1.0)
        # The larger of what the weights promise and what the frames' scatter shows.
        sigma = np.sqrt(np.maximum(1.0 / weight, variance / views))
        colour = c[:, COLOUR] / np.maximum(c[:, COLOUR_WEIGHT], 1e-30)
        ends.append(np.column_stack([sigma, sigma * np.sqrt(views), c[:, VIEWS], colour]))
    blended: Floats = ends[0] * (1.0 - share[:, None]) + ends[1] * share[:, None]
    return blended


def _mesh_chunk(grid: BlockGrid, first: Ints, distance: Floats) -> tuple[Array, Ints, Ints, Floats] | None:
    """Vertices [voxels in G], faces, voxels at both ends of each vertex's edge, share of the second; or None.

    first (3,): the chunk's first block.
    """
    axis = np.arange(_CHUNK + 1)
    block = first + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    at = grid.find(pack_keys(torch.from_numpy(block)).to(grid.device)).cpu().numpy()
    present = np.flatnonzero(at >= 0)
    shape = (_CHUNK + 1,) * 3
    dense = np.full((*shape, EDGE, EDGE, EDGE), np.nan, dtype=np.float32)
    dense.reshape(-1, VOXELS)[present] = distance[at[present]]
    edge = (_CHUNK + 1) * EDGE
    field = dense.transpose(0, 3, 1, 4, 2, 5).reshape(edge, edge, edge)[:_EDGE, :_EDGE, :_EDGE]
    known = np.isfinite(field)
    filled = np.where(known, field, np.float32(1.0))
    if not known.any() or filled.min() >= 0.0 or filled.max() <= 0.0:
        return None
    vertices, faces, _, _ = marching_cubes(filled, level=0.0)
    low, high = np.floor(vertices).astype(np.int64), np.ceil(vertices).astype(np.int64)
    inside = known[tuple(low.T)] & known[tuple(high.T)]
    faces = faces[inside[faces].all(axis=1)].astype(np.int64)
    if len(faces) == 0:
        return None
    share = (vertices - low).max(axis=1)
    ends = np.stack([_voxel_index(p, at) for p in (low, high)], axis=1)
    return vertices.astype(np.float64) + first * EDGE, faces, ends, share.astype(np.float32)


def _voxel_index(voxel: Ints, at: Ints) -> Ints:
    """Flat indices (n,) into the field's voxels, of voxels (n, 3) of a chunk whose blocks are ``at``."""
    block, inner = voxel // EDGE, voxel % EDGE
    n = _CHUNK + 1
    index: Ints = at[(block[:, 0] * n + block[:, 1]) * n + block[:, 2]] * VOXELS + (
        (inner[:, 0] * EDGE + inner[:, 1]) * EDGE + inner[:, 2]
    )
    return index


def _merge(parts: list[tuple[Array, Ints, Ints, Floats]]) -> tuple[Array, Ints, Ints, Floats]:
    """Join chunks: vertices on the layers they share that have the same coordinates become one."""
    vertices, faces, edges, share = (
        np.concatenate([p[0] for p in parts]),
        np.concatenate([p[1] for p in parts]),
        np.concatenate([p[2] for p in parts]),
        np.concatenate([p[3] for p in parts]),
    )
    counts = [len(p[0]) for p in parts]
    faces += np.repeat(np.cumsum([0, *counts[:-1]]), [len(p[1]) for p in parts])[:, None]
    on_layer = np.flatnonzero((vertices % (_CHUNK * EDGE) == 0.0).any(axis=1))
    # within a chunk too: marching cubes makes several vertices where a voxel is exactly zero
    exact = np.flatnonzero((vertices % 1.0 == 0.0).all(axis=1))
    shared = np.union1d(on_layer, exact)
    key = np.round(vertices[shared] * 1e4).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    renumber = np.arange(len(vertices))
    renumber[shared] = shared[first[inverse.reshape(-1)]]
    faces = renumber[faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices, faces[whole], edges, share


def _large_pieces(vertices: Array, faces: Ints, least: float) -> Ints:
    """Faces of the connected pieces of at least this area; vertices in voxels."""
    piece, area = piece_areas(vertices, faces)
    kept: Ints = faces[area[piece[faces[:, 0]]] >= least]
    return kept


def _surface_model(
    vertices: Array, faces: Ints, values: Floats, voxel_m: float, shares: SigmaShares
) -> SurfaceModel:
    """Assemble the record; values (V, 4) are sigma of the mean, of one view [m], views, grey."""
    grey = np.clip(np.round(values[:, 3]), 0, 255).astype(np.uint8)
    rgba = np.column_stack([grey, grey, grey, np.full_like(grey, 255)])
    # Faces point outwards: the field is positive outside, scikit-image winds them by descending values.
    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, vertex_colors=rgba, process=False)
    noise_m, single_view_m = values[:, :2].T.astype(np.float64)
    return SurfaceModel(
        mesh=mesh,
        sigma_m=vertex_sigma(mesh, noise_m, single_view_m, voxel_m, shares),
        views=np.maximum(np.round(values[:, 2]), 1).astype(np.int64),
    )


_TIMES_USUAL = 2.0
"""Where all depth is poor the limits follow it: so many times the median scatter still counts."""


def known_voxels(values: Floats, voxel_m: float, support: KnownVoxelCriteria) -> Bools:
    """(n, 512): which of the field's voxels (n, 512, 7) count."""
    weight, free, views = values[..., WEIGHT], values[..., FREE], values[..., VIEWS]
    scatter = scatter_m(values) / np.float32(voxel_m)
    usual = _usual(scatter, values, voxel_m)
    seen = views + (free > 0) >= support.views
    confirmed = (views >= 2) & (scatter < max(support.agreeing, usual))
    agree = scatter < max(support.scatter, _TIMES_USUAL * usual)
    # far in front of every surface all frames look through, and that is what they say
    empty = weight <= 0
    solid = free <= support.carved * (weight + free)
    return np.asarray((weight + free > 0) & (seen | confirmed) & (empty | (agree & solid)))


def scatter_m(values: Floats) -> Floats:
    """(n, 512): standard deviation of what frames say of a voxel's distance from the surface [m]."""
    weight = np.maximum(values[..., WEIGHT], np.float32(1e-30))
    mean = values[..., DISTANCE] / weight
    scatter: Floats = np.sqrt(np.maximum(values[..., SQUARE] / weight - mean * mean, np.float32(0.0)))
    return scatter


def _usual(scatter: Floats, values: Floats, voxel_m: float) -> float:
    """Median scatter at the surface [voxels]."""
    distance = np.abs(values[..., DISTANCE])
    near = (values[..., VIEWS] >= 3) & (distance < np.float32(voxel_m) * values[..., WEIGHT])
    return float(np.median(scatter[near])) if near.any() else 0.0


WINDOW_VOXELS = 6.0
"""Radius of the disc over which roughness is told: a voxel is about a pixel, a window 7 of them wide."""


def vertex_sigma(
    mesh: trimesh.Trimesh, noise_m: Array, single_view_m: Array, voxel_m: float, shares: SigmaShares
) -> Array:
    """Standard deviation (V,) of the distance along the normal [m].

    noise_m (V,) what independent frames leave after averaging; single_view_m (V,) that of one view.
    """
    relief = roughness(mesh, WINDOW_VOXELS * voxel_m) if shares.of_relief > 0.0 else 0.0 * noise_m
    return np.asarray(
        np.sqrt(noise_m**2 + (shares.of_view * single_view_m) ** 2 + (shares.of_relief * relief) ** 2)
    )


def roughness(mesh: trimesh.Trimesh, radius_m: float) -> Array:
    """Root mean square (V,) of the surface's height over the plane that fits it around each vertex [m].

    Second moments of the places around, by averaging over neighbours as often as the spread of a disc of this
    radius takes.
    """
    V, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        return np.zeros(len(V))
    sums = neighbour_sums(faces, len(V))
    share = 1.0 / np.diff(sums.indptr)
    # one averaging spreads by the mean square of the steps; a disc by half its radius squared
    along = np.sum((V[faces] - V[np.roll(faces, -1, axis=1)]) ** 2, axis=2)
    step = np.mean(along) * np.mean(1.0 - share)
    rounds = int(np.clip(np.ceil(0.5 * radius_m**2 / step), 1, 60))
    moved = V - V.mean(axis=0)
    a, b = np.triu_indices(3)
    moments = np.concatenate([moved, moved[:, a] * moved[:, b]], axis=1)
    for _ in range(rounds):
        moments = (sums @ moments) * share[:, None]
    return np.asarray(np.sqrt(min_spread(moments)))
