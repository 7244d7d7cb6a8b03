"""The zero level of the field as a triangle mesh, with colour, standard deviation and views per vertex.

Marching cubes (Lewiner et al. 2003, scikit-image) runs over cubes of 64^3 voxels that share one layer;
vertices on shared layers have the same coordinates and are merged, so there are no seams and memory
follows the surface.

A voxel is known where enough frames saw it and agree, and few frames look through it. The number of frames
alone is a poor criterion: two frames that agree confirm each other, while many that disagree, as matching
windows do on a slanted surface without texture, confirm nothing.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array, Bools, Ints
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
    WEIGHT_SQUARED,
    BlockGrid,
    pack_keys,
    unpack_keys,
)
from polhode.mapping.mesh_geometry import piece_areas
from polhode.records.surface import SurfaceModel

_CHUNK = 8
"""Blocks along the edge of a chunk."""
_EDGE = _CHUNK * EDGE + 1
"""Voxels along it: one layer is shared with the next chunk."""
Floats = NDArray[np.float32]


def empty_surface(warnings: tuple[str, ...] = ()) -> SurfaceModel:
    """A surface without faces."""
    mesh = trimesh.Trimesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64), process=False)
    return SurfaceModel(mesh=mesh, sigma_m=np.zeros(0), views=np.zeros(0, dtype=np.int64), warnings=warnings)


@dataclass(frozen=True)
class ExtractedSurface:
    """The zero level, with the field's values at its vertices."""

    mesh: trimesh.Trimesh
    """vertex colours set"""
    noise_m: Array
    """(V,) sigma of the mean of independent frames"""
    single_m: Array
    """(V,) of one frame"""
    views: Ints
    """(V,)"""


def extract_surface(grid: BlockGrid, config: Mapping, min_views: int) -> ExtractedSurface | None:
    """Mesh in G [m] of all known voxels, without small pieces; None when there are none.

    ``min_views`` replaces that of the configuration.
    """
    if len(grid) == 0:
        return None
    values = grid.values.numpy()
    known = known_voxels(values, grid.voxel_m, config, min_views)
    # in voxels, NaN where it is not known
    weight = values[..., WEIGHT] + values[..., FREE]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (values[..., DISTANCE] + grid.front_m * values[..., FREE]) / (
            weight * np.float32(grid.voxel_m)
        )
    distance = np.where(known, mean, np.float32(np.nan)).astype(np.float32, copy=False)
    first = np.unique(np.floor_divide(unpack_keys(grid.keys).numpy(), _CHUNK), axis=0) * _CHUNK
    parts = [part for corner in first if (part := _mesh_chunk(grid, corner, distance)) is not None]
    if not parts:
        return None
    vertices, faces, edges, shares_of = _merge(parts)
    piece, area = piece_areas(vertices, faces)
    # Pieces of less area are removed [faces of a voxel]
    faces = faces[area[piece[faces[:, 0]]] >= 25.0]
    used, renumbered = np.unique(faces, return_inverse=True)
    if len(used) == 0:
        return None
    noise_m, single_m, views, colour = _values_at(values, edges[used], shares_of[used], grid.front_m).T
    grey = np.clip(np.round(colour), 0, 255).astype(np.uint8)
    rgba = np.column_stack([grey, grey, grey, np.full_like(grey, 255)])
    vertices, faces = vertices[used] * grid.voxel_m, renumbered.reshape(-1, 3)
    return ExtractedSurface(
        # Faces point outwards: the field is positive outside, scikit-image winds them by descending values.
        mesh=trimesh.Trimesh(vertices=vertices, faces=faces, vertex_colors=rgba, process=False),
        noise_m=noise_m.astype(np.float64),
        single_m=single_m.astype(np.float64),
        views=np.maximum(np.round(views), 1).astype(np.int64),
    )


def _values_at(values: Floats, edges: Ints, share: Floats, front_m: float) -> Floats:
    """(V, 4): sigmas of the mean and of one view [m], views, grey, on edges between voxels (V, 2)."""
    ends = []
    for column in (0, 1):
        c = values.reshape(-1, values.shape[-1])[edges[:, column]]
        weight = np.maximum(c[:, WEIGHT] + c[:, FREE], 1e-30)
        mean = (c[:, DISTANCE] + front_m * c[:, FREE]) / weight
        variance = np.maximum((c[:, SQUARE] + front_m**2 * c[:, FREE]) / weight - mean**2, 0.0)
        views = np.maximum(c[:, VIEWS], 1.0)
        # the larger of the variance by the weights and that by the scatter over the frames
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
    at = grid.find(pack_keys(torch.from_numpy(block))).numpy()
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
    vertices, faces, edges, share = (np.concatenate(column) for column in zip(*parts, strict=True))
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


def known_voxels(values: Floats, voxel_m: float, config: Mapping, min_views: int) -> Bools:
    """(n, 512): which of the field's voxels (n, 512, 8) are known, from at least ``min_views`` frames."""
    weight, free, views = values[..., WEIGHT], values[..., FREE], values[..., VIEWS]
    scatter = scatter_m(values) / np.float32(voxel_m)
    # median scatter at the surface [voxels]: where all depth is poor, the limits follow it
    near = (views >= 3) & (np.abs(values[..., DISTANCE]) < np.float32(voxel_m) * weight)
    usual = float(np.median(scatter[near])) if near.any() else 0.0
    seen = views + (free > 0) >= min_views
    confirmed = (views >= 2) & (_disagreement(scatter, values) < max(config.agreeing_voxels, usual))
    agree = scatter < max(config.scatter_voxels, 2.0 * usual)
    # far in front of every surface all frames look through, and the voxel is known to be empty
    empty = weight <= 0
    solid = free <= config.carved_share * (weight + free)
    return np.asarray((weight + free > 0) & (seen | confirmed) & (empty | (agree & solid)))


def scatter_m(values: Floats) -> Floats:
    """(n, 512): standard deviation over the frames of a voxel's distance from the surface [m]."""
    weight = np.maximum(values[..., WEIGHT], np.float32(1e-30))
    mean = values[..., DISTANCE] / weight
    scatter: Floats = np.sqrt(np.maximum(values[..., SQUARE] / weight - mean * mean, np.float32(0.0)))
    return scatter


def _disagreement(scatter: Floats, values: Floats) -> Floats:
    """(n, 512): the scatter that frames of equal weight and the same differences would have.

    The weighted scatter is small where one frame has most of the weight, however far the others are off. Its
    expectation is in proportion to one less one over the effective number of frames (Kish 1965).
    """
    total, squared = values[..., WEIGHT], values[..., WEIGHT_SQUARED]
    effective = total * total / np.maximum(squared, np.float32(1e-30))
    views = np.maximum(values[..., VIEWS], np.float32(1.0))
    short = np.maximum(
        np.float32(1.0) - np.float32(1.0) / np.maximum(effective, np.float32(1.0)), np.float32(1e-6)
    )
    widened: Floats = scatter * np.sqrt(
        np.maximum((np.float32(1.0) - np.float32(1.0) / views) / short, np.float32(1.0))
    )
    return widened
