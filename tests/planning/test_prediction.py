"""Predictions and sampled members against the integrated truth, linear flows and Monte Carlo."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from polhode.geometry.lie import Array, exp_so3, hat, log_so3
from polhode.geometry.rigid_body import propagate
from polhode.planning.prediction import (
    UNKNOWN_RAD,
    DisturbancePaths,
    Ensemble,
    FinalState,
    axes_jacobian,
    draw_deviations,
    draw_ensemble,
    nominal_motion,
    pose_covariance,
    power_shape,
    predict,
    process_noise,
    propagate_members,
)
from polhode.simulation.monte_carlo import disturbed_motion
from tests.planning.bodies import BASIS, estimate

MOMENTS = np.array([1.3, 1.0, 0.8])
R0 = exp_so3([0.4, -0.2, 0.9])
R_GP = exp_so3([-0.3, 0.5, 0.2])
W_P = np.array([0.15, 0.5, 0.1])
ANY_BODY = R_GP @ BASIS @ R_GP.T
"""Derivatives of J_G by five parameters: two moments and three products of inertia, along P."""


def last_body(covariance: Array, w_P: Array = W_P, moments: Array = MOMENTS) -> FinalState:
    J = R_GP @ np.diag(moments) @ R_GP.T
    r, v = np.array([0.1, 0.0, 0.6]), np.array([1e-3, 2e-3, 0.0])
    return FinalState(r, v, R0 @ R_GP.T, R_GP @ w_P, J, R_GP, ANY_BODY, covariance)


def small_covariance(seed: int, size: float = 1.0) -> Array:
    scale = (
        np.concatenate([np.repeat([1e-3, 1e-4, 2e-4, 1e-4], 3), np.full(5, 2e-4), np.full(3, 1e-3)]) * size
    )
    A = (np.eye(20) + 0.3 * np.random.default_rng(seed).normal(size=(20, 20))) * scale[:, None]
    return np.asarray(A @ A.T)


def test_the_mean_follows_the_rigid_body() -> None:
    t = np.array([0.0, 5.0, 20.0])
    found = predict(last_body(np.zeros((20, 20))), t, 0.0, 0.0)
    r, v, R, w = propagate(t, [0.1, 0.0, 0.6], [1e-3, 2e-3, 0.0], R0, W_P, np.diag(MOMENTS))
    np.testing.assert_allclose(found.R_NP, R, atol=1e-9)
    np.testing.assert_allclose(found.r_N, r, atol=1e-12)
    np.testing.assert_allclose(found.w_P, w, atol=1e-9)
    np.testing.assert_allclose(found.v_N, v, atol=1e-12)
    np.testing.assert_allclose(found.covariance, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.covariance_of_marks, 0.0, atol=1e-12)
    # members move so, too, also backwards
    last = last_body(np.zeros((20, 20)))
    for times in (t, -t):
        R_NG, w_G = propagate_members(last, np.zeros((1, 20)), last.J_G[None], times)
        _, _, R, w = propagate(times, last.r_N, last.v_N, R0, W_P, np.diag(MOMENTS), rtol=1e-10)
        np.testing.assert_allclose(R_NG[:, 0] @ R_GP, R, atol=1e-6)
        np.testing.assert_allclose(w_G[:, 0] @ R_GP, w, atol=1e-6)


@pytest.mark.parametrize("rows", [1, 13])
def test_blocks_of_rows_give_the_bytes_of_all_rows_at_once(
    rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    last, t = last_body(small_covariance(7)), np.linspace(0.1, 9.0, 131)
    whole = len(t)
    found = []
    for size in (whole, rows):
        monkeypatch.setattr("polhode.planning.prediction.ROWS_AT_ONCE", size)
        calls: list[int] = []
        found.append(predict(last, t, 1e-8, 1e-6, advance=partial(calls.append, 1)))
        assert len(calls) == -(-whole // size)
    for name in ("r_N", "R_NP", "w_P", "covariance", "covariance_of_marks", "sigma_parts"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_at_time_zero_the_covariance_is_that_of_the_state() -> None:
    covariance = small_covariance(0)
    last = last_body(covariance)
    found = predict(last, [0.0], 1e-6, 1e-6)
    # theta and w turned from G to P, plus what the axes add
    T = np.zeros((12, 20))
    T[:6, :6], T[6:9, 6:9], T[9:, 9:12] = np.eye(6), R_GP.T, R_GP.T
    of_axes = T.copy()
    D = axes_jacobian(last)
    of_axes[6:9, 12:17] = D
    of_axes[9:, 12:17] = np.cross(W_P, D.T).T
    np.testing.assert_allclose(found.covariance[0], of_axes @ covariance @ of_axes.T, atol=3e-9)
    # a mark at the estimated centre of mass lies where p_NG + R_NG com is, whatever the true one
    T[0:3, 17:20] = -last.R_NG
    T[3:6, 17:20] = -last.R_NG @ np.cross(np.eye(3), last.w_G)
    lever = T @ covariance @ T.T
    np.testing.assert_allclose(found.covariance_of_marks[0][:3, :3], lever[:3, :3], atol=3e-9)
    np.testing.assert_allclose(found.covariance_of_marks[0][6:, 6:], lever[6:, 6:], atol=3e-9)


def test_small_errors_grow_as_differences_of_the_motion_say() -> None:
    covariance, t = small_covariance(1, 0.1), [12.0]
    last = last_body(covariance)
    found = predict(last, t, 0.0, 0.0)
    columns = []
    for k in range(20):
        e = np.zeros(20)
        e[k] = 1e-6
        J = last.J_G + np.einsum("k,kij->ij", e[12:17], ANY_BODY)
        r, v, R, w = propagate(
            [0.0, *t], last.r_N + e[:3], last.v_N + e[3:6], last.R_NG @ exp_so3(e[6:9]), last.w_G + e[9:12], J
        )
        R_NP = R[1] @ R_GP @ exp_so3(axes_jacobian(last) @ e[12:17])
        w_P = R_NP.T @ R[1] @ w[1]
        theta = log_so3(found.R_NP[0].T @ R_NP)
        columns.append(np.concatenate([r[1] - found.r_N[0], v[1] - found.v_N[0], theta, w_P - found.w_P[0]]))
    flow = np.stack(columns, axis=1) / 1e-6
    expected = flow @ covariance @ flow.T
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found.covariance[0] / scale[:, None] / scale, expected / scale[:, None] / scale, atol=0.01
    )


def test_large_errors_are_spread_as_a_monte_carlo_spreads_them() -> None:
    # 2 degrees and 0.01 rad/s before a flip: after 40 s the linear flow would say several turns
    covariance = np.diag(np.repeat([1e-6, 1e-8, 1e-3, 1e-4, 1e-8, 1e-8, 1e-6], [3, 3, 3, 3, 2, 3, 3]))
    w_P = np.array([0.02, 0.8, 0.02])
    last = last_body(covariance, w_P)
    found = predict(last, [40.0], 0.0, 0.0)
    rng = np.random.default_rng(4)
    angles = []
    for e in rng.normal(size=(150, 20)) * np.sqrt(np.diag(covariance)):
        J = last.J_G + np.einsum("k,kij->ij", e[12:17], ANY_BODY)
        _, _, R, _ = propagate(
            [0.0, 40.0], last.r_N, last.v_N, last.R_NG @ exp_so3(e[6:9]), last.w_G + e[9:12], J, rtol=1e-6
        )
        angles.append(np.sum(log_so3(found.R_NP[0].T @ R[1] @ R_GP) ** 2))
    # 150 draws against 256: two means of squares with heavy tails
    spread = np.trace(found.covariance_of_marks[0, 6:9, 6:9])
    assert spread == pytest.approx(np.mean(angles), rel=0.35)
    assert np.sqrt(spread) < np.pi


def test_a_spin_that_was_long_steady_stays_predictable_though_its_inertia_is_undetermined() -> None:
    variances = np.repeat([1e-6, 1e-8, 1e-6, 1e-8, 0.3, 1e-8, 0.3, 1e-2], [3, 3, 3, 3, 2, 0, 3, 3])
    # what would make the spin axis no principal axis is known
    variances[15:17] = 1e-8
    last = last_body(np.diag(variances), np.array([0.0, 0.0, 0.8]))
    sigma_deg = []
    for seen in (0, 20, 120):
        past_s = -np.arange(1.0, 1.0 + seen)
        R_NG = last.R_NG @ exp_so3(past_s[:, None] * last.w_G)
        body = replace(last, past_s=past_s, past_R_NG=R_NG) if seen else last
        covariance = predict(body, [30.0], 0.0, 0.0).covariance_of_marks[0]
        sigma_deg.append(np.rad2deg(np.sqrt(np.trace(covariance[6:9, 6:9]))))
    # about the middle axis it would tip over: the longer it did not, the surer it will not
    assert sigma_deg[0] > 3.0 * sigma_deg[1] > 10.0 * sigma_deg[2]
    assert sigma_deg[2] < 0.5


def test_members_may_spin_about_the_middle_axis_if_that_was_steady_as_it_began() -> None:
    variances = np.repeat([1e-6, 1e-8, 1e-5, 1e-4, 0.3, 1e-8, 0.3, 1e-2], [3, 3, 3, 3, 2, 0, 3, 3])
    variances[15:17] = 1e-8
    last = last_body(np.diag(variances), np.array([0.0, 0.0, 0.6]))
    past_s = -np.arange(1.0, 13.0)
    past_R_NG = last.R_NG @ exp_so3(past_s[:, None] * last.w_G)
    deviation, J = draw_deviations(replace(last, past_s=past_s, past_R_NG=past_R_NG))
    axis = last.w_G / np.linalg.norm(last.w_G)
    about = np.einsum("i,nij,j->n", axis, J, axis)
    moments = np.linalg.eigvalsh(J)
    middle = (about > 1.01 * moments[:, 0]) & (about < 0.99 * moments[:, 2])
    assert middle.any()
    # at the rates that are drawn for them, not at those of the estimate
    R_NG, _ = propagate_members(last, np.where(np.arange(20) < 6, 0.0, deviation), J, past_s)
    off = np.linalg.norm(log_so3(np.swapaxes(past_R_NG, 1, 2)[:, None] @ R_NG), axis=-1)
    limit = 5.0 * np.sqrt(variances[6:9].sum() + variances[9:12].sum() * past_s**2)
    assert (off < limit[:, None]).mean() > 0.95


def test_an_attitude_is_never_less_known_than_not_at_all() -> None:
    turns = log_so3(Rotation.random(20_000, rng=np.random.default_rng(0)).as_matrix())
    assert np.sqrt(np.mean(turns**2)) == pytest.approx(UNKNOWN_RAD, rel=0.01)
    found = predict(last_body(small_covariance(6)), [10.0, 400.0], 1e-8, 1e-3)
    sigma = np.sqrt(np.diagonal(found.covariance_of_marks, axis1=1, axis2=2))[:, 6:9]
    assert np.all(sigma[0] < 0.5 * UNKNOWN_RAD)
    np.testing.assert_allclose(sigma[1], UNKNOWN_RAD)


def test_drawn_deviations_have_the_covariance_and_drawn_bodies_are_possible() -> None:
    covariance = small_covariance(3)
    # the second one is a plate, thinner than other bodies may become
    for moments in (MOMENTS, np.array([1.79, 1.0, 0.8])):
        deviation, _ = draw_deviations(last_body(covariance, moments=moments))
        spread = deviation.T @ deviation / len(deviation)
        np.testing.assert_allclose(spread, covariance, rtol=1e-6, atol=1e-14)
        np.testing.assert_allclose(deviation.mean(axis=0), 0.0, atol=1e-12)
    wild = np.diag(np.repeat([1e-6, 1.0, 1e-6], [12, 5, 3]))
    _, J = draw_deviations(last_body(wild))
    moments = np.linalg.eigvalsh(J)
    assert np.all(moments > 0.0) and np.all(moments[:, 0] + moments[:, 1] > moments[:, 2])


def test_process_noise_is_in_proportion_to_its_level() -> None:
    one, least = (process_noise(MOMENTS, W_P, np.array([5.0, 60.0]), psd, psd) for psd in (1.0, 1e-18))
    np.testing.assert_allclose(1e18 * least, one, rtol=1e-9)


def test_process_noise_matches_monte_carlo() -> None:
    rng = np.random.default_rng(5)
    psd, dt, steps = 1e-6, 0.1, 60
    noise = process_noise(MOMENTS, W_P, np.array([dt * steps]), psd, psd)[0]
    R_end = predict(last_body(np.zeros((20, 20))), [dt * steps], 0.0, 0.0)
    n = 3000
    w, R, v = np.tile(W_P, (n, 1)), np.tile(R0, (n, 1, 1)), np.zeros((n, 3))
    for _ in range(steps):
        # Midpoint rule for the body, kicks of white torque and acceleration between the steps.
        w = w + rng.normal(size=(n, 3)) * np.sqrt(psd * dt) / MOMENTS
        v = v + rng.normal(size=(n, 3)) * np.sqrt(psd * dt)
        middle = w + 0.5 * dt * np.cross(w * MOMENTS, w) / MOMENTS
        w = w + dt * np.cross(middle * MOMENTS, middle) / MOMENTS
        R = R @ exp_so3(middle * dt)
    errors = np.hstack([log_so3(R_end.R_NP[0].T @ R), w - R_end.w_P[0]])
    expected = np.sqrt(np.diagonal(noise))
    np.testing.assert_allclose(errors.std(axis=0), expected[6:], rtol=0.1)
    np.testing.assert_allclose(v.std(axis=0), expected[3:6], rtol=0.1)
    assert expected[0] == pytest.approx(np.sqrt(psd * (dt * steps) ** 3 / 3))
    # small enough for a linear flow: what bends is of second order
    small = predict(last_body(np.zeros((20, 20))), [dt * steps], 0.03 * psd, 0.03 * psd)
    np.testing.assert_allclose(small.covariance[0] / 0.03, noise, rtol=1e-5, atol=1e-10)


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


def test_paths_under_an_uncertain_level_have_its_mean_power_and_its_tails() -> None:
    decades, target = 0.4, estimate((0.1, 0.6, 0.2), psd=1e-6)
    target = replace(target, level_decades=(decades, decades))
    at, rng = np.linspace(0.5, 8.0, 16), np.random.default_rng(0)
    drawn = np.concatenate(DisturbancePaths(target, at).paths(40_000, rng), axis=-1)[:, -1]
    expected = process_noise(np.array([1.3, 1.0, 0.8]), target.last.w_G, at, 1e-6, 1e-6)[-1]
    rows = np.r_[0:3, 6:9]
    np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(np.diag(expected)[rows]), rtol=0.03)
    levels = rng.gamma(power_shape(decades), size=200_000)
    assert np.std(np.log10(levels)) == pytest.approx(decades, rel=0.01)
    # of independent numbers with one random variance: 3 (1 + c^2), c the level's deviation over its mean
    kurtosis = np.mean(drawn**4, axis=0) / np.mean(drawn**2, axis=0) ** 2
    np.testing.assert_allclose(kurtosis, 3.0 * (1.0 + np.var(levels) / np.mean(levels) ** 2), rtol=0.15)


def test_a_region_holds_its_share_of_errors_under_an_uncertain_level() -> None:
    decades, psd, covariance = (0.25, 0.8), 1e-7, small_covariance(3, size=0.3)
    found = predict(last_body(covariance), [5.0, 60.0], psd, psd, decades)
    given = predict(last_body(covariance), [5.0, 60.0], psd, psd)
    np.testing.assert_array_equal(found.covariance, given.covariance)
    np.testing.assert_allclose(given.region_sigmas, np.sqrt(chi2.ppf(0.99, 3)), rtol=1e-6)
    noise = process_noise(MOMENTS, W_P, np.array([5.0, 60.0]), psd, psd)
    rng = np.random.default_rng(5)
    for quantity, level in enumerate(np.repeat(decades, 2)):
        rows = slice(3 * quantity, 3 * quantity + 3)
        shape = power_shape(level)
        for k in range(2):
            C, Q = found.covariance[k][rows, rows], noise[k][rows, rows]
            scale = np.sqrt(rng.gamma(shape, 1.0 / shape, (100_000, 1)))
            calm = rng.normal(size=(100_000, 3)) @ np.linalg.cholesky(C - Q).T
            error = calm + scale * (rng.normal(size=(100_000, 3)) @ np.linalg.cholesky(Q).T)
            square = np.einsum("ni,ij,nj->n", error, np.linalg.inv(C), error)
            held = np.mean(square < found.region_sigmas[k, quantity] ** 2)
            assert 0.989 < held < 0.996
    assert found.region_sigmas[1, 2] > 1.15 * given.region_sigmas[1, 2]


def test_a_region_holds_its_share_where_few_members_make_most_of_the_variance() -> None:
    # a rotation near the middle axis: most members stay there, some have begun to flip
    covariance = np.diag(np.repeat([0.0, 0.005, 0.0], [9, 3, 8]) ** 2)
    last, t = last_body(covariance, np.array([0.01, 0.5, 0.0])), np.array([40.0])
    found = predict(last, t, 0.0, 0.0)
    deviation, J = draw_deviations(last, np.random.default_rng(3).normal(size=(4000, 20)))
    _, w = propagate_members(last, deviation, J, t)
    error = w[0] @ R_GP - found.w_P[0]
    square = np.einsum("ni,ij,nj->n", error, np.linalg.inv(found.covariance[0][9:, 9:]), error)
    assert np.mean(square < chi2.ppf(0.99, 3)) < 0.97
    assert 0.98 < np.mean(square < found.region_sigmas[0, 3] ** 2) < 0.999


def test_parts_of_the_sigmas_are_those_of_what_causes_them() -> None:
    covariance, t, psd = small_covariance(3), [20.0], 1e-8
    whole = predict(last_body(covariance), t, psd, psd)
    np.testing.assert_allclose(
        np.sum(whole.sigma_parts**2, axis=1), np.diagonal(whole.covariance, axis1=1, axis2=2), rtol=1e-6
    )
    known = covariance.copy()
    known[12:17], known[:, 12:17] = 0.0, 0.0
    exact = predict(last_body(known), t, 0.0, 0.0)
    state = np.sqrt(np.diagonal(exact.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(whole.sigma_parts[:, 0], state, rtol=0.03)
    noise = process_noise(MOMENTS, W_P, np.array(t), psd, psd)
    np.testing.assert_allclose(whole.sigma_parts[0, 2], np.sqrt(np.diag(noise[0])), rtol=1e-3)


def test_regions_hold_where_strong_disturbances_turn_the_body_far_off() -> None:
    psd, h, n = 4e-5, 0.05, 800
    last, rng = last_body(np.zeros((20, 20))), np.random.default_rng(8)
    found = predict(last, [n * h], 0.0, psd)
    start, none = (last.r_N, last.v_N, last.R_NG, last.w_G), np.zeros((n, 3))
    errors = []
    for _ in range(400):
        torque = rng.normal(size=(n, 3)) * np.sqrt(psd / h)
        R, w = (each[-1] for each in disturbed_motion(start, last.J_G, h, none, torque)[2:])
        errors.append([log_so3(found.R_NP[0].T @ R @ R_GP), w @ R_GP - found.w_P[0]])
    assert np.std(errors, axis=0)[0].max() > 0.5
    for k, error in enumerate(np.moveaxis(np.array(errors), 1, 0)):
        own = slice(6 + 3 * k, 9 + 3 * k)
        C = found.covariance[0][own, own]
        square = np.einsum("ni,ij,nj->n", error, np.linalg.inv(C), error)
        assert np.mean(square < found.region_sigmas[0, 2 + k] ** 2) > 0.97
        # and not by being vague
        assert 0.8 < np.sqrt(np.trace(C) / np.mean(np.sum(error**2, axis=1))) < 1.6


def test_members_spread_as_the_covariance_says() -> None:
    target = estimate((0.0, 0.0, 0.4), (0.01, 0.0, 0.0))
    members = draw_ensemble(target, TIMES, 1500, 3)
    P = pose_covariance(members, nominal_motion(target, TIMES), target.com_G)
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # about the spin axis: attitude and rate; the place: r, v t and the lever of the centre of mass
    np.testing.assert_allclose(sigma[0, 5], np.hypot(5e-3, 0.1 * 2e-4), rtol=0.06)
    place = np.sqrt((1e-3) ** 2 + (8.0 * 1e-4) ** 2 + (5e-4) ** 2)
    np.testing.assert_allclose(sigma[-1, 0:3], place, rtol=0.06)


def test_however_far_members_turn_the_centre_of_mass_has_its_own_sigma() -> None:
    """Errors of the attitude of any angle about a centre that is far from the origin of G."""
    rng, com_G = np.random.default_rng(4), np.array([0.3, -0.1, 0.2])
    motion = nominal_motion(estimate((0.0, 0.0, 0.4), (0.01, 0.0, 0.0)), TIMES[:1])
    R_NG = motion.R_NG @ exp_so3(rng.normal(0.0, 1.0, (4000, 3)))
    of_com = motion.p_NG + motion.R_NG @ com_G + rng.normal(0.0, 0.01, (4000, 1, 3))
    P = pose_covariance(Ensemble(R_NG[:, None], of_com - R_NG[:, None] @ com_G), motion, com_G)[0]
    J = np.hstack([np.eye(3), -hat(com_G)])
    np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(J @ P @ J.T)), 0.01, rtol=0.05)


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
