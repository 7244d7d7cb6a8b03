"""Edges of a measured mesh, after simplification to as few faces as its errors allow.

Marching cubes divides a surface into small faces whose angles are noise; quadric simplification (Garland and
Heckbert, SIGGRAPH 1997) first merges them where the surface is flat.
"""

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array
from polhode.planning.edges.edge_model import EdgeModel, edge_model

REDUCTION = 0.6
"""Ratio of the numbers of faces of successive simplifications."""
MIN_FACES = 60
MIN_AGREEMENT = 0.95
"""Smallest share of either surface that is within the tolerance of the other."""
MEASURED_TOLERANCE, MEASURED_MIN_LENGTH = 2e-3, 0.025
"""Smallest tolerance for a measured mesh, and length of an edge that is no noise: shares of its diameter."""
MEASURED_FLAT_DEG = 20.0
"""The normals of a measured plane deviate by less from their mean."""


def measured_edge_model(mesh: trimesh.Trimesh, sigma_m: Array) -> EdgeModel:
    """Edges of a run's mesh in G, whose vertices have sigma_m (V,), inf where nothing was measured."""
    diameter = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    known = sigma_m[np.isfinite(sigma_m)]
    noise = 2.0 * float(np.median(known)) if len(known) else 0.0
    tolerance_m = max(MEASURED_TOLERANCE * diameter, noise)
    return edge_model(
        simplified(mesh, tolerance_m),
        tolerance_m=tolerance_m,
        min_length_m=MEASURED_MIN_LENGTH * diameter,
        flat_deg=MEASURED_FLAT_DEG,
        faceted=True,
    )


def simplified(mesh: trimesh.Trimesh, tolerance_m: float) -> trimesh.Trimesh:
    """The coarsest simplification that agrees with the mesh: 95 % of either within the tolerance.

    The mesh itself where no simplification does.
    """
    best = mesh
    if len(mesh.faces) <= MIN_FACES:
        return best
    points, normals = _samples(mesh)
    tree = cKDTree(points)
    faces = REDUCTION * len(mesh.faces)
    while faces >= MIN_FACES:
        vertices, triangles = fast_simplification.simplify(
            np.asarray(best.vertices, dtype=np.float32),
            np.asarray(best.faces, dtype=np.int32),
            target_count=int(faces),
            agg=3,
        )
        # below what quadric simplification can reach, it returns the mesh nearly unchanged
        if len(triangles) == 0 or len(triangles) > 0.98 * len(best.faces):
            break
        tried = trimesh.Trimesh(vertices, triangles, process=False)
        own, own_normals = _samples(tried)
        there, back = _distance(tree, points, normals, own), _distance(cKDTree(own), own, own_normals, points)
        if min((there <= tolerance_m).mean(), (back <= tolerance_m).mean()) < MIN_AGREEMENT:
            break
        best, faces = tried, faces * REDUCTION
    return best


def _samples(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Points (n, 3) sampled on the surface, the normals of their faces (n, 3); deterministic."""
    points, face = trimesh.sample.sample_surface(mesh, 20_000, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals)[face]


def _distance(tree: cKDTree, points: Array, normals: Array, other: Array) -> Array:
    """Distance (m,) of points from the plane of the nearest sample, beyond a boundary from the sample."""
    distance, nearest = tree.query(other, k=4)
    gap = other[:, None] - points[nearest]
    across = np.abs(np.einsum("mkc,mkc->mk", gap, normals[nearest]))
    # Close to samples the distance to the plane counts; far from them there is no surface.
    spacing = 3.0 * float(np.median(distance[:, 0])) + 1e-12
    return np.asarray(np.where(distance[:, 0] < spacing, across.min(axis=1), distance[:, 0]))
