"""Cholesky's solution of small systems against NumPy's."""

import numpy as np
import pytest

from polhode.geometry.small_systems import solve_symmetric


@pytest.mark.parametrize("n", [1, 3, 6])
def test_it_solves_the_system(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    A, b = root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)
    L, x = np.zeros((n, n)), np.empty(n)
    solve_symmetric(A, b, L, x)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-9)
    np.testing.assert_allclose(np.tril(L) @ np.tril(L).T, A, rtol=1e-12, atol=1e-12)
