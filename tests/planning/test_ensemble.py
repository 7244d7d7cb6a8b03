"""Members and their disturbances against linear flows."""

from dataclasses import replace

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


def test_no_member_has_its_centre_of_mass_out_of_its_range() -> None:
    """A member spins about its own centre of mass: the origin of G moves about it by (1 - R) com."""
    target = estimate((0.0, 0.0, 0.4), (0.01, 0.0, 0.0), com_G=(0.02, 0.0, 0.01))
    target.last.covariance[:12, :12] *= 0.0
    target.last.covariance[17:20, 17:20] = np.diag([0.05, 1e-6, 0.05]) ** 2
    bounded = replace(target, com_range_G=(np.array([-0.03, -1.0, -1.0]), np.array([0.04, 1.0, 1.0])))
    found = []
    for each in (target, bounded):
        members = draw_ensemble(each, TIMES, 400, 3)
        # the last position of the centre of mass is fixed here: X_NG com = r_N
        last = each.last
        found.append(
            np.einsum("nji,nj->ni", members.R_NG[:, 0], last.r_N + 0.1 * last.v_N - members.p_NG[:, 0])
        )
    free, kept = found
    assert free[:, 0].min() < -0.05 and free[:, 0].max() > 0.06
    assert kept[:, 0].min() > -0.031 and kept[:, 0].max() < 0.041
    # all of the range is used
    assert kept[:, 0].min() < -0.02 and kept[:, 0].max() > 0.03
