"""Elimination against the marginal and the conditional of a Gaussian."""

import numpy as np

from polhode.backend.window.quadratic import Quadratic, eliminate
from polhode.lie import Array


def information(n: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n), rng.normal(size=n)


def test_what_is_left_is_the_marginal() -> None:
    H, g = information(9, 0)
    gone, kept = np.array([1, 4, 5]), np.array([0, 2, 3, 6, 7, 8])
    left = eliminate(H, g, gone, kept)
    np.testing.assert_allclose(np.linalg.inv(left.H), np.linalg.inv(H)[np.ix_(kept, kept)], rtol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(left.H, -left.g), np.linalg.solve(H, -g)[kept], rtol=1e-9)


def test_the_eliminated_entries_follow_to_the_joint_optimum() -> None:
    H, g = information(9, 1)
    gone, kept = np.arange(4), np.arange(4, 9)
    left, best = eliminate(H, g, gone, kept), np.asarray(np.linalg.solve(H, -g), dtype=np.float64)
    np.testing.assert_allclose(left.follow(best[kept]), best[gone], rtol=1e-9)


def test_nothing_to_eliminate_leaves_all() -> None:
    H, g = information(4, 2)
    left = eliminate(H, g, np.zeros(0, np.int64), np.arange(4))
    np.testing.assert_array_equal(left.H, H)
    assert left.follow(np.ones(4)).shape == (0,)


def test_gradient_is_that_of_the_value() -> None:
    H, g = information(5, 3)
    rng = np.random.default_rng(4)
    quadratic, x, d = Quadratic(H, g, rng.normal(size=5)), rng.normal(size=5), rng.normal(size=5)
    slope = (quadratic.value(x + 1e-5 * d) - quadratic.value(x - 1e-5 * d)) / 2e-5
    np.testing.assert_allclose(quadratic.gradient(x) @ d, slope, rtol=1e-7)
