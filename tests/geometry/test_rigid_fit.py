"""Rotations and rigid transforms of least squares."""

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3, make_pose, transform_points
from polhode.geometry.rigid_fit import fit_rigid, mean_rotation, nearest_rotation

X_AB = make_pose(exp_so3([0.3, -2.0, 0.4]), [0.1, 0.2, 0.5])


def test_an_exact_motion_is_recovered() -> None:
    p_B = np.random.default_rng(0).normal(size=(6, 3))
    np.testing.assert_allclose(fit_rigid(transform_points(X_AB, p_B), p_B), X_AB, atol=1e-12)


def test_points_of_a_plane_give_a_rotation_and_no_reflection() -> None:
    rng = np.random.default_rng(1)
    p_B = rng.normal(size=(20, 3)) * [1.0, 1.0, 0.0]
    p_A = p_B + rng.normal(size=(20, 3)) * 1e-3
    assert np.linalg.det(fit_rigid(p_A, p_B)[:3, :3]) == pytest.approx(1.0)


def test_a_point_without_weight_does_not_count() -> None:
    p_B = np.random.default_rng(2).normal(size=(8, 3))
    p_A = transform_points(X_AB, p_B)
    p_A[3] += 10.0
    weight = np.where(np.arange(8) == 3, 0.0, 2.0)
    np.testing.assert_allclose(fit_rigid(p_A, p_B, weight), X_AB, atol=1e-12)


def test_many_rotations_are_found_at_once() -> None:
    rng = np.random.default_rng(3)
    R = exp_so3(rng.normal(size=(5, 3)))
    M = np.einsum("n,nij->nij", rng.uniform(0.1, 3.0, 5), R)
    np.testing.assert_allclose(nearest_rotation(M), R, atol=1e-12)


def test_the_mean_of_rotations_about_one_axis_is_the_one_in_the_middle() -> None:
    R = exp_so3(np.outer([-0.2, 0.1, 0.4], [0.0, 0.6, 0.8]))
    np.testing.assert_allclose(mean_rotation(R), exp_so3([0.0, 0.06, 0.08]), atol=1e-3)
