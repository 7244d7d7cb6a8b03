"""Relative poses of perfect points are exact; too few points or points far off make none."""

import numpy as np

from polhode.lie import exp_so3, inverse_pose, make_pose, transform_points
from polhode.simulation.monte_carlo import pair_poses

RNG = np.random.default_rng(0)
X_RG = make_pose(exp_so3(RNG.normal(size=(4, 3))), [0.0, 0.0, 0.6] + 0.1 * RNG.normal(size=(4, 3)))
P_G = 0.1 * RNG.normal(size=(30, 3))
SEEN = [np.arange(0, 20), np.arange(10, 30), np.arange(5, 25), np.arange(0, 9)]
FRAME = np.concatenate([np.full(len(points), k) for k, points in enumerate(SEEN)])
POINT = np.concatenate(SEEN)
P_R = transform_points(X_RG[FRAME], P_G[POINT][:, None])[:, 0]


def test_pairs_with_enough_common_points_get_the_true_relative_pose() -> None:
    i, j, X, count = pair_poses(FRAME, POINT, P_R, X_RG, 0.01, 9)
    assert list(zip(i, j, strict=True)) == [(0, 1), (0, 2), (0, 3), (1, 2)]
    assert list(count) == [10, 15, 9, 15]
    np.testing.assert_allclose(X, X_RG[i] @ inverse_pose(X_RG[j]), atol=1e-12)


def test_points_far_from_where_the_truth_puts_them_are_left_out() -> None:
    p_R = P_R.copy()
    p_R[(FRAME == 1) & (POINT < 13)] += 0.1
    i, j, X, count = pair_poses(FRAME, POINT, p_R, X_RG, 0.01, 8)
    assert list(zip(i, j, count, strict=True)) == [(0, 2, 15), (0, 3, 9), (1, 2, 12)]
    np.testing.assert_allclose(X, X_RG[i] @ inverse_pose(X_RG[j]), atol=1e-12)
