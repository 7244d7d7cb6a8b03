"""Compiled rotations are those of ``geometry.lie``: near no turn, in between, and near half a turn."""

import numpy as np
import pytest

from polhode.backend.dynamics.so3_exp import (
    inverse_right_jacobians,
    matrices_from_quaternions,
    right_jacobians,
    rotation_matrices,
    rotation_vectors,
)
from polhode.geometry.lie import Array, exp_so3, log_so3, right_jacobian_so3, wxyz_from_matrix

ANGLES = (0.0, 1e-9, 1e-6, 9.9e-4, 1.1e-3, 9e-3, 1.1e-2, 0.3, 2.0, 3.0, np.pi - 1e-7)


@pytest.fixture(params=ANGLES)
def theta(request: pytest.FixtureRequest) -> Array:
    axes = np.random.default_rng(3).normal(size=(50, 3))
    axes[:3] = np.eye(3)
    return np.asarray(request.param * axes / np.linalg.norm(axes, axis=1, keepdims=True))


def test_exponential_and_logarithm(theta: Array) -> None:
    R = rotation_matrices(theta)
    np.testing.assert_allclose(R, exp_so3(theta), atol=1e-14)
    np.testing.assert_allclose(rotation_vectors(R), theta, atol=1e-7 if np.abs(theta).max() > 3 else 1e-14)
    np.testing.assert_allclose(rotation_vectors(R), log_so3(R), atol=1e-12)
    np.testing.assert_allclose(matrices_from_quaternions(3.0 * wxyz_from_matrix(R)), R, atol=1e-14)


def test_jacobians(theta: Array) -> None:
    np.testing.assert_allclose(right_jacobians(theta), right_jacobian_so3(theta), atol=1e-9)
    product = right_jacobians(theta) @ inverse_right_jacobians(theta)
    np.testing.assert_allclose(product, np.tile(np.eye(3), (len(theta), 1, 1)), atol=1e-11)
