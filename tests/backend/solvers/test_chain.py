"""Eliminating the chain first gives the solution of the whole system."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from polhode.backend.problem.iterate import N_POSE
from polhode.backend.solvers.chain import eliminate_chain, half_log_det, solve_with_chain
from polhode.geometry.lie import Array


def system(n_frames: int, n_state: int, constants: int, seed: int = 0) -> tuple[Array, Array]:
    """Poses coupled as by landmarks, the rest of a state to its neighbours and to the constants."""
    rng = np.random.default_rng(seed)
    n = n_state * n_frames + constants
    H = np.zeros((n, n))
    poses = (n_state * np.arange(n_frames)[:, None] + np.arange(N_POSE)).ravel()
    J = rng.normal(size=(2 * len(poses), len(poses)))
    H[np.ix_(poses, poses)] += J.T @ J
    for k in range(n_frames - 1):
        at = np.r_[n_state * k : n_state * (k + 2), n_state * n_frames : n]
        J = rng.normal(size=(2 * n_state, len(at)))
        H[np.ix_(at, at)] += J.T @ J
    return H + np.eye(n), rng.normal(size=n)


@pytest.mark.parametrize(
    ("n_frames", "n_state", "constants"), [(2, 12, 8), (20, 12, 8), (35, 18, 19), (1, 18, 8)]
)
def test_step_and_determinant_are_those_of_the_whole_system(
    n_frames: int, n_state: int, constants: int
) -> None:
    H, g = system(n_frames, n_state, constants)
    step, half_log = solve_with_chain(eliminate_chain(np.tril(H), g, n_frames, n_state), n_state)
    np.testing.assert_allclose(step, -np.linalg.solve(H, g), rtol=1e-8, atol=1e-10)
    assert half_log == pytest.approx(0.5 * np.linalg.slogdet(H)[1], rel=1e-12)
    assert half_log_det(np.tril(H), n_frames, n_state) == half_log
    # damping grows the diagonal
    step, _ = solve_with_chain(eliminate_chain(np.tril(H), g, n_frames, n_state, 0.3), n_state)
    damped = H + 0.3 * np.diag(np.diag(H))
    np.testing.assert_allclose(step, -np.linalg.solve(damped, g), rtol=1e-8, atol=1e-10)
    H[-constants - 1, -constants - 1] = -1.0
    with pytest.raises(LinAlgError, match="not positive definite"):
        eliminate_chain(np.tril(H), g, n_frames, n_state)
