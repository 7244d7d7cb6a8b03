"""Errors of a surface's vertices: what averages out over an area, and whether the stated sigmas hold."""

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array
from polhode.records.mesh_metrics import closest_on_surface
from polhode.records.surface import ErrorCorrelation

MAX_VERTICES = 15_000
"""Compared with the truth."""
PATCH_LENGTHS = 0.5
"""Radius of a patch whose mean error is compared, in the longest finite length of correlation."""


def mean_correlation(radius_m: float, correlation: Sequence[ErrorCorrelation]) -> float:
    """Variance of the mean error over a disc, over that of a single vertex: what does not average out.

    The mean of exp(-distance / length) over pairs of points of a disc, within a tenth of the exact integral.
    """
    ratios = [(each.share, radius_m / each.length_m) for each in correlation]
    return float(sum(share / (1.0 + 0.9054 * x + 0.5 * x * x) for share, x in ratios))


def sigma_of_mean(sigma_m: Array, radius_m: float, correlation: Sequence[ErrorCorrelation]) -> float:
    """Sigma [m] of the mean distance of the vertices of a disc from the true surface; sigma_m (n,) theirs."""
    return float(np.mean(sigma_m) * np.sqrt(mean_correlation(radius_m, correlation)))


def sigma_shares(
    mesh: trimesh.Trimesh,
    sigma_m: Array,
    truth: trimesh.Trimesh,
    correlation: Sequence[ErrorCorrelation] | None,
    seed: int = 0,
) -> dict[str, float | None]:
    """Shares of vertices within one and three sigmas of the truth, and of the means over patches.

    mesh and truth in one frame [m]; sigma_m (V,) of the mesh's vertices, not finite: not measured;
    correlation None: not known, and then nothing is said of patches. Shares without one of them are None.
    """
    rng = np.random.default_rng(seed)
    known = np.flatnonzero(np.isfinite(sigma_m) & (sigma_m > 0.0))
    some = rng.choice(known, min(MAX_VERTICES, len(known)), replace=False)
    names = ("within_one_sigma", "within_three_sigma")
    out: dict[str, float | None] = dict.fromkeys((*names, *(f"patches_{name}" for name in names)))
    if len(some) == 0:
        return out
    points, normals = np.asarray(mesh.vertices)[some], np.asarray(mesh.vertex_normals)[some]
    closest, distance = closest_on_surface(truth, points)
    out |= _shares(distance / sigma_m[some], "")
    lengths = [] if correlation is None else [e.length_m for e in correlation if np.isfinite(e.length_m)]
    if correlation is None or not lengths:
        return out
    radius_m = PATCH_LENGTHS * max(lengths)
    error_m = np.einsum("ni,ni->n", points - closest, normals)
    tree, ratios = cKDTree(points), []
    for centre in rng.choice(len(points), min(400, len(points)), replace=False):
        inside = np.array(tree.query_ball_point(points[centre], radius_m))
        # normals within 60 deg of that of the centre
        inside = inside[normals[inside] @ normals[centre] > 0.5]
        if len(inside) >= 8:
            expected = sigma_of_mean(sigma_m[some][inside], radius_m, correlation)
            ratios.append(abs(float(error_m[inside].mean())) / expected)
    return out | _shares(np.array(ratios), "patches_")


def _shares(ratio: Array, prefix: str) -> dict[str, float | None]:
    if len(ratio) == 0:
        return {}
    return {
        f"{prefix}within_one_sigma": float(np.mean(ratio < 1.0)),
        f"{prefix}within_three_sigma": float(np.mean(ratio < 3.0)),
    }
