"""Members and their disturbances against linear flows."""

import numpy as np

from polhode.planning.prediction import (
    DisturbancePaths,
    draw_ensemble,
    nominal_motion,
    pose_covariance,
    process_noise,
)
from tests.planning.bodies import estimate

TIMES = np.linspace(0.1, 8.0, 80)


def test_paths_of_disturbances_have_the_covariance_of_the_linear_flow() -> None:
    target = estimate((0.1, 0.6, 0.2), psd=1e-6)
    shift, turn = DisturbancePaths(target, TIMES).paths(6000, np.random.default_rng(0))
    expected = process_noise(np.array([1.3, 1.0, 0.8]), target.last.w_G, TIMES, 1e-6, 1e-6)
    for k in (9, 79):
        found = turn[:, k].T @ turn[:, k] / len(turn)
        scale = np.sqrt(np.diag(expected[k, 6:9, 6:9]))
        np.testing.assert_allclose(
            found / scale[:, None] / scale, expected[k, 6:9, 6:9] / scale[:, None] / scale, atol=0.06
        )
        np.testing.assert_allclose(shift[:, k].std(axis=0), np.sqrt(expected[k, 0, 0]), rtol=0.03)


def test_members_spread_as_the_covariance_says() -> None:
    target = estimate((0.0, 0.0, 0.4), (0.01, 0.0, 0.0))
    members = draw_ensemble(target, TIMES, 1500, 3)
    P = pose_covariance(members, nominal_motion(target, TIMES))
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # about the spin axis: attitude and rate; the place: r, v t and the lever of the centre of mass
    np.testing.assert_allclose(sigma[0, 5], np.hypot(5e-3, 0.1 * 2e-4), rtol=0.06)
    place = np.sqrt((1e-3) ** 2 + (8.0 * 1e-4) ** 2 + (5e-4) ** 2)
    np.testing.assert_allclose(sigma[-1, 0:3], place, rtol=0.06)


def test_the_estimate_is_a_member_without_deviation() -> None:
    target = estimate((0.1, 0.6, 0.2), (0.01, 0.0, 0.0), size=0.0, com_G=(0.02, 0.0, 0.01))
    members, motion = draw_ensemble(target, TIMES, 3, 1), nominal_motion(target, TIMES)
    np.testing.assert_allclose(members.p_NG[1], motion.p_NG, atol=1e-7)
    np.testing.assert_allclose(members.R_NG[2], motion.R_NG, atol=1e-6)
