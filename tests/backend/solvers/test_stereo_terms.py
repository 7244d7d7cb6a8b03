"""The stereo terms against the camera's own model and finite differences."""

from dataclasses import replace

import numpy as np

from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import motion_data
from polhode.backend.solvers.casadi_nlp import ExternalFunction
from polhode.backend.solvers.ipopt import StereoTerms
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, exp_so3, inverse_pose, transform_points
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(frames=4, landmarks=25, detection=0.7, camera_moves=True)


def start() -> tuple[StereoTerms, Array, Array]:
    """Terms of exact measurements, unknowns off their references, attitudes that are fixed."""
    sequence, rng = generate(SCENE, 0), np.random.default_rng(1)
    tracks, X_NG, p_G = sequence.tracks, sequence.X_NG, sequence.p_G
    theta = 0.2 * rng.normal(size=(SCENE.frames, 3))
    reference = X_NG[:, :3, :3] @ exp_so3(-theta)
    seen = transform_points(inverse_pose(tracks.X_NR) @ X_NG, p_G)[tracks.frame, tracks.landmark]
    tracks = replace(tracks, uvd_px=tracks.rig.project(seen))
    data, zero = motion_data(tracks, Backend()), np.zeros((SCENE.frames, 3))
    it = Iterate(X_NG[:, :3, 3], reference, zero, zero, zero[0], np.zeros(5), np.eye(3), p_G)
    x = it.vector()
    x[: it.n_states].reshape(-1, it.n_state)[:, 3:6] = theta
    A = np.swapaxes(data.R_RN @ it.R_NG, 1, 2).ravel()
    return StereoTerms(data, it.n_state, it.n_dense), x, A


def test_the_hessian_is_the_second_derivative_where_the_residuals_vanish() -> None:
    terms, x, A = start()
    n, step = len(x), 1e-6
    columns, rows = np.divmod(terms.keys(), n)
    assert np.all(rows <= columns)
    H = np.zeros((n, n))
    np.add.at(H, (rows, columns), terms.hessian(x, A))
    H = H + np.triu(H, 1).T
    rng = np.random.default_rng(3)
    for _ in range(5):
        along = rng.normal(size=n)
        slope = (terms.gradient(x + step * along, A) - terms.gradient(x - step * along, A)) / (2.0 * step)
        np.testing.assert_allclose(H @ along, slope, atol=2e-5 * np.abs(slope).max())
    # CasADi calls such functions with its own numbers
    outside = ExternalFunction("twice", lambda x, y: 2.0 * x + y, (3, 3), 3)
    found = np.asarray(outside(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 0.0]))).ravel()
    np.testing.assert_array_equal(found, [2.5, 4.0, 6.0])
