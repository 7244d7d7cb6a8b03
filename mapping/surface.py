"""The zero level of the field as a triangle mesh, with colour, standard deviation and views per vertex.

Marching cubes (Lewiner et al. 2003, scikit-image) runs over cubes of 64^3 voxels that share one layer;
vertices on shared layers have the same coordinates and are merged, so there are no seams and memory
follows the surface.
"""

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from mapping.blocks import EDGE, BlockGrid, unpack_keys
from mapping.vertex_sigma import Shares, vertex_sigma
from polhode.lie import Array
from polhode.records import Ints, SurfaceModel

_CHUNK = 8
"""Blocks along the edge of a chunk."""
Floats = NDArray[np.float32]


def empty_surface() -> SurfaceModel:
    """What is returned when there is nothing to mesh."""
    mesh = trimesh.Trimesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64), process=False)
    return SurfaceModel(mesh=mesh, sigma_m=np.zeros(0), views=np.zeros(0, dtype=np.int64))


def extract_surface(
    grid: BlockGrid, min_views: int, min_component_area: float, shares: Shares
) -> SurfaceModel:
    """Mesh in G [m] of all voxels seen in at least ``min_views`` frames; empty when there are none."""
    if len(grid) == 0:
        return empty_surface()
    block = unpack_keys(grid.keys).cpu().numpy()
    layers = _vertex_layers(grid, min_views)
    lookup = {tuple(b): i for i, b in enumerate(block.tolist())}
    chunks = sorted({tuple(c) for c in np.floor_divide(block, _CHUNK).tolist()})
    parts = [part for chunk in chunks if (part := _mesh_chunk(chunk, lookup, layers)) is not None]
    if not parts:
        return empty_surface()
    vertices, faces, values = _merge(parts)
    faces = _large_components(vertices, faces, min_component_area)
    used = np.unique(faces)
    if len(used) == 0:
        return empty_surface()
    renumber = np.full(len(vertices), -1, dtype=np.int64)
    renumber[used] = np.arange(len(used))
    return _surface_model(vertices[used] * grid.voxel_m, renumber[faces], values[used], grid.voxel_m, shares)


def _vertex_layers(grid: BlockGrid, min_views: int) -> Floats:
    """(n, 512, 6): distance in voxels (NaN unknown), sigmas of mean and view [m], views, colour, known."""
    c = grid.channels
    weight = c["weight"].clamp_min(1e-30)
    mean = c["weighted_distance"] / weight
    variance = (c["weighted_square"] / weight - mean.square()).clamp_min(0.0)
    views = c["views"].clamp_min(1.0)
    # The larger of what the weights promise and what the frames' scatter shows.
    sigma = torch.sqrt(torch.maximum(1.0 / weight, variance / views))
    colour = c["colour"] / c["colour_weight"].clamp_min(1e-30)
    known = (c["weight"] > 0) & (c["views"] + (c["free"] > 0) >= min_views)
    distance = torch.where(known, mean / grid.voxel_m, torch.full_like(mean, torch.nan))
    stacked = torch.stack(
        [distance, sigma, sigma * views.sqrt(), c["views"], colour, known.to(mean.dtype)], dim=-1
    )
    return np.asarray(stacked.cpu().numpy(), dtype=np.float32)


def _mesh_chunk(
    chunk: tuple[int, ...], lookup: dict[tuple[int, ...], int], layers: Floats
) -> tuple[Floats, Ints, Floats] | None:
    """Vertices [voxels in G], faces and values (n, 4: sigmas, views, colour) of one chunk, or None."""
    n = _CHUNK + 1
    dense = np.zeros((n, EDGE, n, EDGE, n, EDGE, layers.shape[2]), dtype=np.float32)
    dense[..., 0] = np.nan
    first = np.array(chunk) * _CHUNK
    for a, b, c in np.ndindex(n, n, n):
        at = lookup.get((int(first[0]) + a, int(first[1]) + b, int(first[2]) + c))
        if at is not None:
            dense[a, :, b, :, c, :] = layers[at].reshape(EDGE, EDGE, EDGE, -1)
    edge = _CHUNK * EDGE + 1
    field = dense.reshape(n * EDGE, n * EDGE, n * EDGE, -1)[:edge, :edge, :edge]
    distance = field[..., 0]
    known = np.isfinite(distance)
    filled = np.where(known, distance, np.float32(1.0))
    if not known.any() or filled.min() >= 0.0 or filled.max() <= 0.0:
        return None
    vertices, faces, _, _ = marching_cubes(filled, level=0.0)
    low, high = np.floor(vertices).astype(np.int64), np.ceil(vertices).astype(np.int64)
    inside = known[tuple(low.T)] & known[tuple(high.T)]
    faces = faces[inside[faces].all(axis=1)].astype(np.int64)
    if len(faces) == 0:
        return None
    share = (vertices - low).max(axis=1)[:, None]
    values = field[tuple(low.T)][:, 1:5] * (1.0 - share) + field[tuple(high.T)][:, 1:5] * share
    return (vertices + (first * EDGE)).astype(np.float64), faces, values.astype(np.float32)


def _merge(parts: list[tuple[Floats, Ints, Floats]]) -> tuple[Array, Ints, Floats]:
    """Join chunks: vertices with the same coordinates (to 1e-4 voxel) become one."""
    vertices = np.concatenate([p[0] for p in parts])
    starts = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
    faces = np.concatenate([p[1] + s for p, s in zip(parts, starts, strict=True)])
    values = np.concatenate([p[2] for p in parts])
    key = np.round(vertices * 1e4).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices[first], faces[whole], values[first]


def _large_components(vertices: Array, faces: Ints, min_share: float) -> Ints:
    """Faces of the connected pieces that hold at least ``min_share`` of the area."""
    if len(faces) == 0:
        return faces
    n = len(vertices)
    i, j = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    graph = coo_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    corner = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    per_label = np.bincount(label[faces[:, 0]], weights=area)
    kept: Ints = faces[per_label[label[faces[:, 0]]] >= min_share * area.sum()]
    return kept


def _surface_model(
    vertices: Array, faces: Ints, values: Floats, voxel_m: float, shares: Shares
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
