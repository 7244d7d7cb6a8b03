"""How sure a vertex is: what the frames' noise leaves, what all views share, relief that is smoothed away.

Independent noise averages out over the frames. What does not: disparities are matched in windows, so relief
finer than a window is lost in every view alike, and all views share a part of their other errors (texture,
light, calibration). The defaults of both shares were set on four simulated bodies
(``benchmarks/mapping/mesh_quality.py``).
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from polhode.lie import Array
from polhode.mapping.mesh_loops import averaged, least_spread, neighbours

WINDOW_VOXELS = 6.0
"""Radius of the disc over which roughness is told: a voxel is about a pixel, a window 7 of them wide."""


@dataclass(frozen=True)
class Shares:
    """What does not average out: of a single view's sigma, and over the roughness of the surface."""

    of_view: float
    of_relief: float


def vertex_sigma(
    mesh: trimesh.Trimesh, noise_m: Array, single_view_m: Array, voxel_m: float, shares: Shares
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
    start, other = neighbours(faces, len(V))
    degree = np.diff(start) + 1
    # one averaging spreads by the mean square of the steps; a disc by half its radius squared
    along = np.sum((V[np.repeat(np.arange(len(V)), degree - 1)] - V[other]) ** 2, axis=1)
    step = np.mean(along) * np.mean(1.0 - 1.0 / degree)
    rounds = int(np.clip(np.ceil(0.5 * radius_m**2 / step), 1, 60))
    moved = V - V.mean(axis=0)
    a, b = np.triu_indices(3)
    moments = np.concatenate([moved, moved[:, a] * moved[:, b]], axis=1)
    for _ in range(rounds):
        moments = averaged(moments, start, other)
    return np.asarray(np.sqrt(least_spread(moments)))
