"""Lighter meshes for planners and viewers by quadric decimation, and their distance from the full mesh.

Garland and Heckbert, "Surface simplification using quadric error metrics", 1997, as in fast-simplification.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from trimesh.visual import ColorVisuals

from polhode.geometry.lie import Array
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.surface import SurfaceModel

SAMPLES = 10_000
"""Points on each mesh whose distance from the other is measured."""


@dataclass(frozen=True)
class DetailLevel:
    """A lighter mesh; each vertex has colour, sigma and views of the nearest one of the full mesh."""

    surface: SurfaceModel
    largest_m: float
    """Largest distance of the sampled points of either mesh from the other"""
    mean_m: float


def levels_of(surface: SurfaceModel, shares: Sequence[float], seed: int = 0) -> list[DetailLevel]:
    """One level for each share of the faces, in this order; levels of too few faces are omitted."""
    counts = [round(share * len(surface.mesh.faces)) for share in shares]
    # minimum number of faces of a lighter mesh
    counts = [count for count in counts if count >= 200]
    if not counts:
        return []
    full = surface.mesh
    # in the precision of the files: the last digits decide between edges of the same cost
    start_V = np.asarray(full.vertices).astype(np.float32).astype(np.float64)
    full = trimesh.Trimesh(start_V, np.asarray(full.faces), process=False)
    middles = cKDTree(np.asarray(full.triangles_center))
    points, _ = trimesh.sample.sample_surface(full, SAMPLES, seed=seed)
    levels, thinned = [], {len(full.faces): full}
    for count in counts:
        # from the lightest one that has more faces: indistinguishable, and faster
        start = thinned[min(faces for faces in thinned if faces > count)]
        light = _used(start.simplify_quadric_decimation(face_count=count))
        thinned[len(light.faces)] = light
        levels.append(_level(surface, full, middles, np.asarray(points), light))
    return levels


def _used(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Without unreferenced vertices."""
    used, faces = np.unique(np.asarray(mesh.faces), return_inverse=True)
    return trimesh.Trimesh(np.asarray(mesh.vertices)[used], faces.reshape(-1, 3), process=False)


def _level(
    surface: SurfaceModel, full: trimesh.Trimesh, middles: cKDTree, points: Array, light: trimesh.Trimesh
) -> DetailLevel:
    away = np.append(distance_to_surface(light, points), _to_full(full, middles, light))
    # A vertex corresponds to the nearest one of the full mesh, a face to the face at its centroid.
    _, around = middles.query(np.asarray(light.vertices))
    corner = np.asarray(full.faces)[around]
    separation = np.linalg.norm(
        np.asarray(full.vertices)[corner] - np.asarray(light.vertices)[:, None], axis=2
    )
    nearest = np.take_along_axis(corner, separation.argmin(axis=1)[:, None], axis=1)[:, 0]
    _, face = middles.query(np.asarray(light.triangles_center))
    visual = surface.mesh.visual
    rgba = np.asarray(visual.vertex_colors)[nearest] if isinstance(visual, ColorVisuals) else None
    return DetailLevel(
        SurfaceModel(
            trimesh.Trimesh(light.vertices, light.faces, vertex_colors=rgba, process=False),
            sigma_m=surface.sigma_m[nearest],
            views=surface.views[nearest],
            invented=surface.is_invented[face],
            coverage=surface.coverage_classes[nearest],
        ),
        largest_m=float(away.max()),
        mean_m=float(away.mean()),
    )


def _to_full(full: trimesh.Trimesh, middles: cKDTree, light: trimesh.Trimesh) -> Array:
    """Distances of points on the light mesh from the full one [m], by its faces of the nearest centroids."""
    points, _ = trimesh.sample.sample_surface(light, SAMPLES, seed=0)
    _, face = middles.query(np.asarray(points), k=4)
    best = np.full(len(points), np.inf)
    for column in face.T:
        closest = trimesh.triangles.closest_point(np.asarray(full.triangles)[column], points)
        best = np.minimum(best, np.linalg.norm(closest - points, axis=1))
    return best
