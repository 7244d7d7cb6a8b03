"""Pose of the target in a CAD model: from corresponding points, or from the surfaces.

Points: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976. Surfaces: the
iterative closest point to plane of Chen and Medioni, "Object modelling by registration of multiple range
images", 1992, from many rotations, with the worst tenth of the points left out at each step.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from polhode.geometry.lie import Array, exp_so3, log_so3, make_pose, transform_points
from polhode.geometry.rigid_fit import fit_rigid

KEPT_SHARE = 0.9
"""Share of the points that a step uses: the scan may contain what the model does not."""
MODEL_POINTS = 20_000
FIRST_POINTS, LAST_POINTS = 250, 2_000
FIRST_STEPS, LAST_STEPS, FINALISTS = 12, 40, 6
DISTINCT_DEG = 15.0
MIRROR_FACTOR = 5.0
"""Points with a poor fit that is better by this factor after a reflection are mirrored."""
POOR_FIT_SHARE = 0.02
"""Share of the points' spread: a fit with a larger residual is poor."""
AMBIGUITY_FACTOR = 1.3
"""Another pose whose residual is larger by less than this factor is as good: the model is symmetric."""


@dataclass(frozen=True)
class CadAlignment:
    """X_cadG and how well it fits."""

    X_cadG: Array
    """(4, 4)"""
    rms_m: float
    """Root mean square residual: between points, or from the surface (of the better 90 %)"""
    rival_deg: float | None
    """Angle to another pose that fits as well; None: there is none"""


def align_points(p_G: Array, p_cad: Array) -> CadAlignment:
    """From corresponding points (n, 3) each.

    Raises ValueError when they do not determine the pose, or fit only after a reflection.
    """
    if len(p_G) < 3:
        raise ValueError(f"{len(p_G)} pairs of points; give three or more")
    mean_G, mean_cad = p_G.mean(axis=0), p_cad.mean(axis=0)
    spread = np.linalg.svd((p_cad - mean_cad).T @ (p_G - mean_G), compute_uv=False)
    if spread[1] < 1e-6 * spread[0]:
        raise ValueError("the points lie on a line; give one beside it")
    X, X_mirrored = fit_rigid(p_cad, p_G), fit_rigid(p_cad, -p_G)
    rms = _rms(transform_points(X, p_G) - p_cad)
    other = _rms(transform_points(X_mirrored, -p_G) - p_cad)
    if rms > POOR_FIT_SHARE * _rms(p_cad - mean_cad) and rms > MIRROR_FACTOR * other:
        raise ValueError(
            f"the points are mirrored: {1e3 * rms:.3g} mm rms are left by any rotation, {1e3 * other:.3g} mm "
            "after a reflection; one sign is wrong, or two coordinates are exchanged"
        )
    return CadAlignment(X, rms, None)


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def align_surfaces(scan: trimesh.Trimesh, model: trimesh.Trimesh, start: Array | None = None) -> CadAlignment:
    """From the surfaces [m], starting at ``start`` (4, 4), X_cadG; without it many rotations are tried.

    Deterministic. The scan may be a part of the model.
    """
    points, normals = _sampled(model, MODEL_POINTS, 0)
    target = cKDTree(points), points, normals
    few, many = _sampled(scan, FIRST_POINTS, 1), _sampled(scan, LAST_POINTS, 1)
    if start is not None:
        return CadAlignment(*_fit(start, *many, *target, LAST_STEPS), None)
    # centroid on centroid; rotations of octahedron and icosahedron between the principal frames
    frames = []
    for mesh in (scan, model):
        points, _ = _sampled(mesh, 4_000, 2)
        _, _, Vt = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        frames.append((Vt.T * [1.0, 1.0, np.linalg.det(Vt)], points.mean(axis=0)))
    (R_scan, mean_scan), (R_model, mean_model) = frames
    rotations = (
        R_model @ np.concatenate([Rotation.create_group(each).as_matrix() for each in "OI"]) @ R_scan.T
    )
    starts = make_pose(rotations, mean_model - rotations @ mean_scan)
    first = _distinct([_fit(X, *few, *target, FIRST_STEPS) for X in starts])
    last = _distinct([_fit(X, *many, *target, LAST_STEPS) for X, _ in first[:FINALISTS]])
    (best, rms), *others = last
    rival = next((_degrees(best, X) for X, other in others if other < AMBIGUITY_FACTOR * rms), None)
    return CadAlignment(best, rms, rival)


def _sampled(mesh: trimesh.Trimesh, count: int, seed: int) -> tuple[Array, Array]:
    """Points (n, 3) of a surface and normals (n, 3)."""
    points, face = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.asarray(points), np.asarray(mesh.face_normals)[face]


def _fit(
    X: Array, points: Array, normals: Array, tree: cKDTree, to: Array, to_normals: Array, steps: int
) -> tuple[Array, float]:
    """The pose after some steps, and the root mean square distance of the better part of the points."""
    for _ in range(steps):
        moved, rotated = transform_points(X, points), normals @ X[:3, :3].T
        distance, near = tree.query(moved)
        n = to_normals[near]
        # the other side of a thin panel is no counterpart
        use = (np.sum(rotated * n, axis=1) > 0.0) & (distance <= np.quantile(distance, KEPT_SHARE))
        if use.sum() < 12:
            break
        middle = moved[use].mean(axis=0)
        A = np.hstack([np.cross(moved[use] - middle, n[use]), n[use]])
        gap = np.sum((to[near[use]] - moved[use]) * n[use], axis=1)
        # nothing moves along what the surface does not determine (rotations of a sphere)
        x = np.linalg.lstsq(A, gap, rcond=1e-6)[0]
        R = exp_so3(x[:3])
        X = make_pose(R, middle - R @ middle + x[3:]) @ X
        if np.linalg.norm(x[:3]) < 1e-8 and np.linalg.norm(x[3:]) < 1e-9:
            break
    moved = transform_points(X, points)
    distance, near = tree.query(moved)
    flat = np.abs(np.sum((to[near] - moved) * to_normals[near], axis=1))
    # near the samples of the model the distance to the plane counts; far from them, that to the point
    residual = np.sort(np.where(distance < 3.0 * np.median(distance), flat, distance))
    return X, float(np.sqrt(np.mean(residual[: int(KEPT_SHARE * len(residual))] ** 2)))


def _distinct(fits: list[tuple[Array, float]]) -> list[tuple[Array, float]]:
    """Those that are not within DISTINCT_DEG of a better one, the best first."""
    kept: list[tuple[Array, float]] = []
    for X, rms in sorted(fits, key=lambda each: each[1]):
        if all(_degrees(X, other) > DISTINCT_DEG for other, _ in kept):
            kept.append((X, rms))
    return kept


def _degrees(X_a: Array, X_b: Array) -> float:
    return float(np.rad2deg(np.linalg.norm(log_so3(X_a[:3, :3].T @ X_b[:3, :3]))))
