"""A ball and a box that move freely, with small covariances: for the tests of planning products."""

import numpy as np
import trimesh

from polhode.geometry.lie import Array, exp_so3
from polhode.planning.prediction import FinalEstimate, FinalState
from polhode.records.surface import SurfaceModel

SIGMA_M = 2e-4
BASIS = np.zeros((5, 3, 3))
for n, (i, j) in enumerate([(0, 0), (1, 1), (0, 1), (0, 2), (1, 2)]):
    BASIS[n, i, j] = BASIS[n, j, i] = 1.0


def measured(mesh: trimesh.Trimesh, sigma_m: float = SIGMA_M) -> SurfaceModel:
    V = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(V, sigma_m), np.full(V, 5, dtype=np.int64))


def ball(radius_m: float = 0.1) -> SurfaceModel:
    return measured(trimesh.creation.icosphere(5, radius_m))


def box(edge_m: float = 0.01) -> SurfaceModel:
    """With edges of the mesh so long, or shorter."""
    mesh = trimesh.creation.box((0.3, 0.15, 0.1))
    return measured(mesh.subdivide_to_size(edge_m))


def estimate(
    w_G: tuple[float, float, float],
    v_N: tuple[float, float, float] = (0.0, 0.0, 0.0),
    size: float = 1.0,
    com_G: tuple[float, float, float] = (0.0, 0.0, 0.0),
    psd: float = 0.0,
) -> FinalEstimate:
    """``size`` of the standard deviations: 1 mm, 0.1 mm/s, 5 mrad, 0.2 mrad/s, 1e-3, 0.5 mm."""
    scale = np.concatenate([np.repeat([1e-3, 1e-4, 5e-3, 2e-4], 3), np.full(5, 1e-3), np.full(3, 5e-4)])
    covariance: Array = np.diag((size * scale) ** 2)
    J = np.diag([1.3, 1.0, 0.8])
    last = FinalState(
        np.array([0.1, 0.0, 0.6]), np.array(v_N), exp_so3([0.2, -0.3, 0.1]), np.array(w_G), J, np.eye(3),
        BASIS, covariance,
    )  # fmt: skip
    return FinalEstimate(last, np.array(com_G), psd, psd)
