"""Known errors in, exactly these errors out."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.geometry.lie import exp_so3
from polhode.geometry.rigid_body import HALF_TURNS, best_half_turn, propagate
from polhode.records.metrics import (
    States,
    motion_errors,
    nees,
    state_scores,
    truth_at,
    with_half_turn,
)
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError

MOMENTS = np.array([1.2, 1.0, 0.7])


@pytest.fixture
def truth() -> Truth:
    t = np.arange(0.0, 20.0, 0.5)
    R0 = exp_so3([0.3, -0.5, 0.8])
    r, v, R, w = propagate(t, [0.1, 0.2, 0.6], [3e-3, 0, 1e-3], R0, [0.1, 0.9, 0.2], np.diag(MOMENTS))
    stamps = np.round(t * 1e9).astype(np.int64)
    ratios = float(np.log(1.2)), float(np.log(1 / 0.7))
    return Truth(stamps, r, R, v, w, MOMENTS, *ratios, np.zeros(3), np.eye(3), mesh=None)


def states_of(truth: Truth) -> States:
    return States(truth.timestamps_ns, truth.r_N, truth.v_N, truth.R_NP, truth.w_P)


def test_constant_errors_are_given_back_exactly_and_the_truth_has_none(truth: Truth) -> None:
    s = states_of(truth)
    errors = motion_errors(s, s)
    assert errors.rmse_position_m == errors.rmse_velocity_m_s == errors.error_com_mm == 0.0
    assert errors.rmse_angular_velocity_deg_s == 0.0 and errors.half_turn == 0
    assert max(errors.attitude_max_deg, errors.principal_axes_error_deg) < 1e-5
    tilt = exp_so3(np.deg2rad([0.0, 2.0, 0.0]))
    offset_P = np.array([1e-3, -2e-3, 2e-3])
    wrong = States(
        s.timestamps_ns,
        s.r_N + s.R_NP @ offset_P,
        s.v_N + np.array([0.0, 3e-3, 4e-3]),
        s.R_NP @ tilt,
        s.w_P @ tilt + np.deg2rad([0.6, 0.0, 0.8]),
    )
    errors = motion_errors(wrong, s)
    assert errors.rmse_position_m == pytest.approx(3e-3, rel=1e-9)
    assert errors.error_com_mm == pytest.approx(3.0, rel=1e-9)
    assert errors.rmse_velocity_m_s == pytest.approx(5e-3, rel=1e-9)
    assert errors.rmse_angular_velocity_deg_s == pytest.approx(1.0, rel=1e-9)
    assert errors.principal_axes_error_deg == pytest.approx(2.0, abs=1e-6)
    assert errors.attitude_max_deg < 1e-5
    assert errors.attitude_with_axes_median_deg == pytest.approx(2.0, abs=1e-6)
    assert errors.attitude_with_axes_max_deg == pytest.approx(2.0, abs=1e-6)
    # the attitude error is what no constant rotation explains
    signs = np.where(np.arange(len(s.r_N)) % 2 == 0, 1.0, -1.0)
    wobble = exp_so3(np.deg2rad(1.5) * signs[:, None] * np.array([0.0, 0.0, 1.0]))
    errors = motion_errors(States(s.timestamps_ns, s.r_N, s.v_N, s.R_NP @ wobble, s.w_P), s)
    assert errors.attitude_median_deg == pytest.approx(1.5, abs=1e-6)
    assert errors.principal_axes_error_deg == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("half_turn", range(4))
def test_answers_that_differ_by_a_half_turn_score_the_same(truth: Truth, half_turn: int) -> None:
    s = states_of(truth)
    rng = np.random.default_rng(3)
    noisy = States(
        s.timestamps_ns,
        s.r_N + rng.normal(0, 1e-3, s.r_N.shape),
        s.v_N,
        s.R_NP @ exp_so3(rng.normal(0, 0.02, s.w_P.shape)),
        s.w_P + rng.normal(0, 0.01, s.w_P.shape),
    )
    covariance = np.tile(np.diag(np.repeat([1e-6, 1e-6, 4e-4, 1e-4], 3)), (len(s.r_N), 1, 1))
    flip = np.diag(np.concatenate([np.ones(6), np.tile(HALF_TURNS[half_turn], 2)]))
    other = with_half_turn(noisy, half_turn)
    assert best_half_turn(other.R_NP, s.R_NP) == half_turn
    plain, flipped = motion_errors(noisy, s), motion_errors(other, s)
    for name in ("rmse_angular_velocity_deg_s", "attitude_median_deg", "principal_axes_error_deg"):
        assert getattr(flipped, name) == pytest.approx(getattr(plain, name), abs=1e-6)
    before = state_scores(noisy, s, covariance, 0)[0]
    after = state_scores(other, s, flip @ covariance @ flip, half_turn)[0]
    assert after == pytest.approx(before)


def test_nees_of_samples_drawn_from_the_covariance_is_the_number_of_components() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4000, 3, 3)) * np.array([1.0, 1e-3, 10.0])[:, None]
    covariance = A @ np.swapaxes(A, 1, 2)
    errors = (A @ rng.normal(size=(4000, 3, 1)))[..., 0]
    assert nees(errors, covariance) == pytest.approx(3.0, abs=0.15)
    # undetermined
    assert nees(np.zeros((1, 3)), np.diag([1.0, np.inf, 1.0])[None]) is None
    assert nees(np.zeros((1, 2)), np.zeros((1, 2, 2))) is None


def test_state_nees_takes_each_block_and_the_right_perturbation(truth: Truth) -> None:
    rng = np.random.default_rng(1)
    n = 4000
    s = states_of(truth)
    base = States(np.arange(n), *(np.repeat(a[:1], n, axis=0) for a in (s.r_N, s.v_N, s.R_NP, s.w_P)))
    A = rng.normal(size=(12, 12)) * np.repeat([1e-3, 1e-3, 1e-2, 1e-2], 3)[:, None]
    e = rng.normal(size=(n, 12)) @ A.T
    estimate = States(
        base.timestamps_ns,
        base.r_N + e[:, :3],
        base.v_N + e[:, 3:6],
        base.R_NP @ exp_so3(e[:, 6:9]),
        base.w_P + e[:, 9:],
    )
    values = state_scores(estimate, base, np.tile(A @ A.T, (n, 1, 1)), 0)[0]
    for value in values.values():
        assert value == pytest.approx(3.0, abs=0.25)


def test_truth_between_its_rows_follows_the_rigid_body(truth: Truth) -> None:
    names = ("timestamps_ns", "r_N", "R_NP", "v_N", "w_P")
    every_other = replace(truth, **{name: getattr(truth, name)[::2] for name in names})
    inside = truth.timestamps_ns[:-1]
    found = truth_at(every_other, inside)
    np.testing.assert_allclose(found.R_NP, truth.R_NP[:-1], atol=1e-7)
    np.testing.assert_allclose(found.r_N, truth.r_N[:-1], atol=1e-9)
    np.testing.assert_allclose(found.w_P, truth.w_P[:-1], atol=1e-8)
    with pytest.raises(InputError, match="does not cover"):
        truth_at(truth, truth.timestamps_ns[-1:] + 10**9)


def test_coverage_counts_determined_components_within_three_sigma(truth: Truth) -> None:
    s = truth_at(truth, truth.timestamps_ns)
    n = len(s.r_N)
    off = s.r_N.copy()
    off[0, 0] += 0.0031
    estimate = States(s.timestamps_ns, off, s.v_N, s.R_NP, s.w_P)
    covariance = np.tile(np.eye(12) * 1e-6, (n, 1, 1))
    covariance[:, 1, 1] = np.inf
    covariance[:, 6:9, 6:9] = np.diag([np.inf] * 3)
    found = state_scores(estimate, s, covariance, 0)[1]
    assert found == {
        "position": pytest.approx(1.0 - 1.0 / (2 * n)),
        "velocity": 1.0,
        "attitude": None,
        "angular_velocity": 1.0,
    }
