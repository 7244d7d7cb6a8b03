"""The standard deviation of each vertex: of its distance from the true surface along the normal.

Two independent parts, added by their squares:

noise   of the frames' mean: errors of each frame's own, and errors that frames have in common when they look
        from similar directions (``vertex_views.FADING_RAD``), both relative to what the depth maps state
relief  finer than the matching windows, which every frame loses alike. It is in proportion to the relief that
        is left in a patch around the vertex; a low quantile of it, so that a smooth body's edges do not count

Depth maps state their errors too large on some bodies and too small on others. The run shows by how much: the
landmarks were measured by other means, so their distances from the mesh scale the noise.

The errors of neighbouring vertices are correlated (``ERROR_CORRELATION``): only a part of them averages out
over an area. The placement of the frame G is no part of sigma. The constants are the best over 24 simulated
bodies; fitted to one half of the bodies they hold on the other half, too (docs/mapping.md).
"""

import numpy as np
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.lie import Array
from polhode.mapping.fusion.vertex_views import VertexViews
from polhode.mapping.mesh_geometry import min_spread, neighbour_sums
from polhode.mesh_metrics import quick_tree
from polhode.records import ErrorCorrelation, SurfaceErrors

WINDOW_VOXELS = 6.0
"""Radius of the disc over which roughness is computed: a voxel is about a pixel, a window 7 of them wide."""
_PATCH_SPACING_VOXELS = 4.0
_PATCH_POINTS = 60
"""Of a patch of relief: about 17 voxels around the vertex."""
_PATCH_QUANTILE = 0.3
_SEPARATED_FROM = 0.05
"""Share of the weight behind from which a vertex is moved all the way."""
_USUAL_SCALE = 0.6
_USUAL_COUNTS = 250
"""The usual scale counts as much as this number of landmarks."""
_OF_MESH = 0.9
"""Share of the distance between landmarks and mesh that is the mesh's error."""
_NEAR_VOXELS, _BESIDE_VOXELS = 3.0, 0.7
"""A landmark is compared with a vertex at most so far away, and so far beside it along the surface."""
_BACK_SHARE = 0.02
ERROR_CORRELATION = ((0.60, 4.0), (0.34, 32.0), (0.06, np.inf))
"""Shares of the variance, and the lengths over which they correlate exponentially [voxels]."""


def separate_sides(
    mesh: trimesh.Trimesh, noise_m: Array, views: VertexViews
) -> tuple[trimesh.Trimesh, Array]:
    """The mesh with vertices that frames see from behind moved to the mean of the frames that face them.

    In the field, the two sides of a part that is thinner than the truncation band are averaged, and push each
    other outwards. The second result is the noise (V,) [m] of the frames that are used.
    """
    share = np.clip(views.back_share / _SEPARATED_FROM, 0.0, 1.0) * (views.front_weight > 0.0)
    if not share.any():
        return mesh, noise_m
    out = mesh.copy()
    out.vertices = np.asarray(mesh.vertices) - (share * views.front_m)[:, None] * np.asarray(
        mesh.vertex_normals
    )
    front_m = 1.0 / np.sqrt(np.maximum(views.front_weight, 1e-30))
    return out, np.where(share > 0.0, np.maximum(noise_m, front_m), noise_m)


def vertex_sigma(
    mesh: trimesh.Trimesh,
    normals: Array,
    noise_m: Array,
    single_m: Array,
    views: VertexViews,
    landmarks: Array | None,
    voxel_m: float,
    config: Mapping,
) -> tuple[Array, SurfaceErrors]:
    """Sigma (V,) of the vertices [m], and how their errors belong together.

    normals (V, 3); noise_m (V,) of the mean of independent frames; single_m (V,) of one frame, taken for what
    frames have in common where none of the kept frames saw the vertex; landmarks (L, 3) in the mesh's frame
    [m]; None: not known.
    """
    shared_m = config.shared_sigma * np.where(np.isfinite(views.shared_m), views.shared_m, single_m)
    stated_m = np.hypot(noise_m, shared_m)
    scale, count = noise_scale(np.asarray(mesh.vertices), normals, stated_m, views, landmarks, voxel_m)
    relief_m = np.zeros(len(noise_m))
    if config.relief_sigma > 0.0:
        rough_m = roughness(mesh, WINDOW_VOXELS * voxel_m)
        relief_m = config.relief_sigma * patch_quantile(mesh, rough_m, voxel_m)
    correlation = tuple(ErrorCorrelation(share, length * voxel_m) for share, length in ERROR_CORRELATION)
    return np.hypot(scale * stated_m, relief_m), SurfaceErrors(scale, count, correlation)


def noise_scale(
    vertices: Array,
    normals: Array,
    stated_m: Array,
    views: VertexViews,
    landmarks: Array | None,
    voxel_m: float,
) -> tuple[float, int]:
    """Actual over stated noise (V,) [m], from the landmarks' distances from the mesh, and how many there are.

    vertices, normals (V, 3), landmarks (L, 3) in one frame [m].

    The median of the distances over the stated noise, drawn towards the usual value where they are few.
    Vertices that frames see from behind are left out: there the distance is that between two sides.
    """
    if landmarks is None or len(landmarks) == 0:
        return _USUAL_SCALE, 0
    reach_m = _NEAR_VOXELS * voxel_m
    distance, nearest = quick_tree(vertices).query(landmarks, distance_upper_bound=reach_m)
    found = np.flatnonzero(np.isfinite(distance))
    nearest = nearest[found]
    between = landmarks[found] - vertices[nearest]
    off_m = np.abs(np.einsum("ni,ni->n", between, normals[nearest]))
    beside_m = np.sqrt(np.maximum(distance[found] ** 2 - off_m**2, 0.0))
    used = (beside_m < _BESIDE_VOXELS * voxel_m) & (views.back_share[nearest] < _BACK_SHARE)
    count = int(used.sum())
    if count == 0:
        return _USUAL_SCALE, 0
    ratio = float(np.median(off_m[used] / stated_m[nearest[used]])) / 0.6745
    share = count / (count + _USUAL_COUNTS)
    return float(max(_OF_MESH * ratio, 1e-3) ** share * _USUAL_SCALE ** (1.0 - share)), count


def patch_quantile(mesh: trimesh.Trimesh, values: Array, voxel_m: float) -> Array:
    """A low quantile (V,) of ``values`` (V,) in a patch around each vertex."""
    vertices = np.asarray(mesh.vertices)
    if len(vertices) == 0:
        return values
    cell = np.floor((vertices - vertices.min(axis=0)) / (_PATCH_SPACING_VOXELS * voxel_m)).astype(np.int64)
    width = cell.max(axis=0) + 1
    key = (cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]
    _, first, of_vertex = np.unique(key, return_index=True, return_inverse=True)
    centres = vertices[first]
    near = quick_tree(centres).query(centres, k=min(_PATCH_POINTS, len(centres)))[1].reshape(len(centres), -1)
    low = np.quantile(values[first][near], _PATCH_QUANTILE, axis=1)
    return np.asarray(low[of_vertex.reshape(-1)])


def roughness(mesh: trimesh.Trimesh, radius_m: float) -> Array:
    """Root mean square (V,) of the surface's height over the plane that fits it around each vertex [m].

    Second moments of the vertices around, by repeated averaging over neighbours up to the spread of a disc of
    this radius.
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
