"""The constant motion behind a relative pose."""

import numpy as np
import pytest

from polhode.lie import Array, exp_so3, make_pose
from polhode.pipeline.checkout.target_motion import twist


@pytest.mark.parametrize("w", [(0.0, 0.0, 0.0), (0.1, -0.3, 0.2), (0.0, 2.0, 0.0)])
def test_twist_moves_points_as_the_pose_does(w: tuple[float, float, float]) -> None:
    rate, velocity, seconds = np.array(w), np.array([0.2, -0.1, 0.05]), 0.5
    steps = 20_000
    X: Array = np.eye(4)
    small = make_pose(exp_so3(rate * seconds / steps), velocity * seconds / steps)
    for _ in range(steps):
        X = small @ X
    found_w, found_v = twist(X, seconds)
    np.testing.assert_allclose(found_w, rate, atol=1e-6)
    np.testing.assert_allclose(found_v, velocity, atol=1e-4)
