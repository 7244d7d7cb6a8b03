"""The standard deviation of each vertex: of its distance from the true surface.

Three independent parts, added by their squares:

noise   of the frames' mean: errors of each frame's own, and errors that frames have in common when they look
        from similar directions (``vertex_views.FADING_RAD``), both relative to what the depth maps state
relief  finer than the matching windows, which every frame loses alike. It is in proportion to the relief that
        is left in a patch around the vertex; a low quantile of it, so that a smooth body's edges do not count
border  the surface protrudes beyond the body's edges by a part of the window

Depth maps state their errors too large on some bodies and too small on others. The run shows by how much: the
landmarks were measured by other means, so their distances from the mesh scale the noise, where the depth is
about as good as at the landmarks (``NoiseScale``). Where frames disagree by more than elsewhere on the body,
the noise is larger.

The errors of neighbouring vertices are correlated (``ERROR_CORRELATION``): only a part of them averages out
over an area. The placement of the frame G is no part of sigma. The constants are the best over 24 simulated
bodies; how well constants of one half of the bodies hold on the other half is in docs/mapping.md.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array
from polhode.mapping.fusion.vertex_views import VertexViews
from polhode.mapping.mesh_geometry import border_vertices, min_spread, neighbour_sums
from polhode.records.mesh_metrics import quick_tree
from polhode.records.surface import ErrorCorrelation, SurfaceErrors

_USUAL_SCALE = 0.46
_FAR_SCALE, _COMPARABLE = 1.6, 2.9
"""Scale where the stated noise is much larger than at the landmarks; up to about how many times larger the
landmarks' scale counts."""
_DISAGREEMENT_POWER, _MAX_DISAGREEMENT = 0.7, 2.7
"""The noise grows with this power of the disagreement of frames, which is limited to this factor."""
_BORDER_VOXELS = 2.0
"""Length over which the border's part fades away from it."""
_NEAR_VOXELS, _BESIDE_VOXELS = 3.0, 0.7
"""A landmark is compared with a vertex at most so far away, and so far beside it along the surface."""
ERROR_CORRELATION = ((0.60, 4.0), (0.34, 32.0), (0.06, np.inf))
"""Shares of the variance, and the lengths over which they correlate exponentially [voxels]."""


def separate_sides(
    mesh: trimesh.Trimesh, noise_m: Array, views: VertexViews
) -> tuple[trimesh.Trimesh, Array]:
    """The mesh with vertices that frames see from behind moved to the mean of the frames that face them.

    In the field, the two sides of a part that is thinner than the truncation band are averaged, and push each
    other outwards. The second result is the noise (V,) [m] of the frames that are used.
    """
    # share of the weight behind from which a vertex is moved all the way
    share = np.clip(views.back_share / 0.05, 0.0, 1.0) * (views.front_weight > 0.0)
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
    at_landmarks = noise_scale(np.asarray(mesh.vertices), normals, stated_m, views, landmarks, voxel_m)
    # radius of the disc over which roughness and disagreement are computed: a voxel is about a pixel, a
    # window 7 of them wide
    rough_m, disagreement = over_discs(mesh, 6.0 * voxel_m, views)
    squares = (stated_m * at_landmarks.at(stated_m) * disagreement**_DISAGREEMENT_POWER) ** 2
    squares += (config.relief_sigma * patch_quantile(mesh, rough_m, voxel_m)) ** 2
    squares += (config.border_sigma * voxel_m * border_share(mesh, voxel_m)) ** 2
    correlation = tuple(ErrorCorrelation(share, length * voxel_m) for share, length in ERROR_CORRELATION)
    return np.sqrt(squares), SurfaceErrors(at_landmarks.scale, at_landmarks.count, correlation)


@dataclass(frozen=True)
class NoiseScale:
    """Actual over stated noise, as the landmarks show it where they are."""

    scale: float
    stated_m: float
    """Median stated noise there [m]"""
    count: int
    """Number of landmarks"""

    def at(self, stated_m: Array) -> Array:
        """(V,) for vertices with this stated noise (V,) [m].

        Landmarks lie where the depth is good. Where it is much worse they show nothing, and the scale of such
        places on all bodies is taken.
        """
        near = 1.0 / (1.0 + (stated_m / max(_COMPARABLE * self.stated_m, 1e-30)) ** 2)
        return np.asarray(self.scale**near * _FAR_SCALE ** (1.0 - near))


def noise_scale(
    vertices: Array,
    normals: Array,
    stated_m: Array,
    views: VertexViews,
    landmarks: Array | None,
    voxel_m: float,
) -> NoiseScale:
    """Actual over stated noise (V,) [m], from the landmarks' distances from the mesh.

    vertices, normals (V, 3), landmarks (L, 3) in one frame [m].

    The median of the distances over the stated noise, drawn towards the usual value where they are few.
    Vertices that frames see from behind are left out: there the distance is that between two sides.
    """
    usual = NoiseScale(_USUAL_SCALE, float(np.median(stated_m)) if len(stated_m) else 0.0, 0)
    if landmarks is None or len(landmarks) == 0:
        return usual
    reach_m = _NEAR_VOXELS * voxel_m
    distance, nearest = quick_tree(vertices).query(landmarks, distance_upper_bound=reach_m)
    found = np.flatnonzero(np.isfinite(distance))
    nearest = nearest[found]
    between = landmarks[found] - vertices[nearest]
    off_m = np.abs(np.einsum("ni,ni->n", between, normals[nearest]))
    beside_m = np.sqrt(np.maximum(distance[found] ** 2 - off_m**2, 0.0))
    used = (beside_m < _BESIDE_VOXELS * voxel_m) & (views.back_share[nearest] < 0.02)
    count = int(used.sum())
    if count == 0:
        return usual
    there_m = stated_m[nearest[used]]
    ratio = float(np.median(off_m[used] / there_m)) / 0.6745
    # the usual scale counts as much as this number of landmarks
    share = count / (count + 250)
    # share of the distance between landmarks and mesh that is the mesh's error
    scale = max(0.6 * ratio, 1e-3) ** share * _USUAL_SCALE ** (1.0 - share)
    return NoiseScale(float(scale), float(np.median(there_m)), count)


def patch_quantile(mesh: trimesh.Trimesh, values: Array, voxel_m: float) -> Array:
    """A low quantile (V,) of ``values`` (V,) in a patch around each vertex."""
    vertices = np.asarray(mesh.vertices)
    if len(vertices) == 0:
        return values
    cell = np.floor((vertices - vertices.min(axis=0)) / (4.0 * voxel_m)).astype(np.int64)
    width = cell.max(axis=0) + 1
    key = (cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]
    _, first, of_vertex = np.unique(key, return_index=True, return_inverse=True)
    centres = vertices[first]
    # of a patch of relief: about 17 voxels around the vertex
    near = quick_tree(centres).query(centres, k=min(60, len(centres)))[1].reshape(len(centres), -1)
    low = np.quantile(values[first][near], 0.3, axis=1)
    return np.asarray(low[of_vertex.reshape(-1)])


def over_discs(mesh: trimesh.Trimesh, radius_m: float, views: VertexViews) -> tuple[Array, Array]:
    """What discs of this radius around each vertex show: roughness (V,) [m], and disagreement of frames (V,).

    roughness: root mean square of the surface's height over the plane that fits it
    disagreement: how much more the frames scatter than they state, over the median of all vertices
    """
    V = np.asarray(mesh.vertices, dtype=np.float64)
    if len(mesh.faces) == 0:
        return np.zeros(len(V)), np.ones(len(V))
    moved = V - V.mean(axis=0)
    a, b = np.triu_indices(3)
    freedom = np.maximum(views.front_count - 1.0, 0.0)
    values = [moved, moved[:, a] * moved[:, b], views.front_chi2[:, None], freedom[:, None]]
    means = disc_means(mesh, np.concatenate(values, axis=1), radius_m)
    chi2, freedom = means[:, 9], means[:, 10]
    # frames at a vertex, less one, averaged over the disc, from which their disagreement is computed
    known = (chi2 > 0.0) & (freedom >= 1.0)
    ratio = np.ones(len(V))
    if known.any():
        of_patch = np.sqrt(chi2[known] / freedom[known])
        ratio[known] = np.clip(of_patch / np.median(of_patch), 1.0 / _MAX_DISAGREEMENT, _MAX_DISAGREEMENT)
    return np.asarray(np.sqrt(min_spread(np.ascontiguousarray(means[:, :9])))), ratio


def disc_means(mesh: trimesh.Trimesh, values: Array, radius_m: float) -> Array:
    """Means (V, k) of ``values`` (V, k) around each vertex, by repeated averaging over neighbours up to the
    spread of a disc of this radius."""
    V, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    sums = neighbour_sums(faces, len(V))
    share = 1.0 / np.diff(sums.indptr)
    # one averaging spreads by the mean square of the steps; a disc by half its radius squared
    along = np.sum((V[faces] - V[np.roll(faces, -1, axis=1)]) ** 2, axis=2)
    step = np.mean(along) * np.mean(1.0 - share)
    rounds = int(np.clip(np.ceil(0.5 * radius_m**2 / step), 1, 60))
    for _ in range(rounds):
        values = (sums @ values) * share[:, None]
    return values


def border_share(mesh: trimesh.Trimesh, voxel_m: float) -> Array:
    """(V,) 1 at the border of the surface, fading over ``_BORDER_VOXELS`` away from it."""
    vertices = np.asarray(mesh.vertices)
    border = border_vertices(np.asarray(mesh.faces), len(vertices))
    if len(border) == 0:
        return np.zeros(len(vertices))
    length_m = _BORDER_VOXELS * voxel_m
    distance_m, _ = quick_tree(vertices[border]).query(vertices, distance_upper_bound=4.0 * length_m)
    return np.asarray(np.exp(-distance_m / length_m))
