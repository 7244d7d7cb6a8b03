"""Jacobians of the exponential of SO(3), near zero and near half a turn too."""

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3, log_so3, right_jacobian_so3

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-4, 2e-3, 0.3, 2.0, 3.1])
def test_the_right_jacobian_is_the_derivative_of_the_exponential(angle: float) -> None:
    theta, step = angle * AXIS, 1e-6
    ends = [log_so3(exp_so3(theta).T @ exp_so3(theta + s * step * np.eye(3))) for s in (1.0, -1.0)]
    np.testing.assert_allclose(right_jacobian_so3(theta), (ends[0] - ends[1]).T / (2.0 * step), atol=1e-8)
