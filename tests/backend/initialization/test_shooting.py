"""Rates and inertia from attitudes alone, where the target turns far between frames."""

import numpy as np
import pytest

from polhode.backend.initialization.multistart import HypothesisFit
from polhode.backend.initialization.rates import (
    OPPOSITE_DIRECTION,
    ROTATIONS,
    _carry,
    rate_branches,
    shoot,
)
from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.backend.problem.iterate import Iterate
from polhode.backend.uncertainty.ambiguity import (
    LOG_ODDS_OF_AS_GOOD,
    choose_hypothesis,
    open_rotations,
)
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.geometry.rigid_body import propagate

TIME_S: Array = 0.5 * np.arange(30.0)
J_G = np.diag([1.5, 1.2, 0.9])
AXIS = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
EVERY = np.ones(30, bool)


def _motion(turn_deg: float, axis: Array = AXIS) -> tuple[Array, Array]:
    """Attitudes (30, 3, 3), a few mrad off, and rates (30, 3)."""
    w_G = 2.0 * np.deg2rad(turn_deg) * axis
    _, _, R_NG, w = propagate(TIME_S, np.zeros(3), np.zeros(3), np.eye(3), w_G, J_G)
    return R_NG @ exp_so3(np.random.default_rng(3).normal(0.0, 0.002, (30, 3))), w


@pytest.mark.parametrize(("turn_deg", "suffix"), [(75.0, ""), (150.0, ""), (220.0, OPPOSITE_DIRECTION)])
def test_a_shot_finds_the_inertia_and_the_rates(turn_deg: float, suffix: str) -> None:
    R_NG, w_G = _motion(turn_deg)
    connected = EVERY.copy()
    connected[22] = False
    shot = shoot(TIME_S, R_NG, connected)[suffix]
    moments = np.linalg.eigvalsh(inertia_from_second_moments(shot.second))
    np.testing.assert_allclose(moments / moments[1], [0.75, 1.0, 1.25], atol=3e-3)
    assert np.median(np.linalg.norm(shot.w_G - w_G, axis=1)) < 0.03
    assert shot.misfit < 1.0


def test_short_turns_need_no_shots_and_of_far_ones_both_directions_are_tried() -> None:
    R_NG, w_G = _motion(25.0)
    assert shoot(TIME_S, R_NG, EVERY) == {}
    branches = rate_branches(TIME_S, make_pose(R_NG, np.zeros((30, 3))), EVERY)
    assert list(branches) == [""]
    assert np.median(np.linalg.norm(branches[""] - w_G, axis=1)) < 0.1
    z = np.array([0.0, 0.0, 1.0])
    for turn_deg in (130.0, 170.0, 230.0):
        branches = rate_branches(TIME_S, make_pose(_motion(turn_deg, z)[0], np.zeros((30, 3))), EVERY)
        found = [np.rad2deg(0.5 * np.median(branches[suffix] @ z)) for suffix in ("", OPPOSITE_DIRECTION)]
        assert found == pytest.approx(sorted([turn_deg, turn_deg - 360.0], key=abs), abs=0.5)


def _trial(turn_deg: float, misfit: float, cost: float) -> HypothesisFit:
    w_G = np.tile([0.0, 0.0, 2.0 * np.deg2rad(turn_deg)], (30, 1))
    zero = np.zeros((30, 3))
    R_NG = np.tile(np.eye(3), (30, 1, 1))
    return HypothesisFit(Iterate(zero, R_NG, zero, w_G, zero[0], np.zeros(5), np.eye(3), zero), cost, misfit)


def test_rotations_that_fit_alike_are_open_and_without_a_limit_the_shorter_one_comes_first() -> None:
    dt_s, other = np.diff(TIME_S), "sphere" + OPPOSITE_DIRECTION
    alike = {"sphere": _trial(150.0, 1000.0, 50.0), other: _trial(210.0, 999.0, 10.0)}
    first, second = choose_hypothesis(alike, dt_s)
    assert (first.name, second.name) == ("sphere", other)
    assert (first.turn_deg, second.turn_deg) == pytest.approx((150.0, 210.0))
    # three to one for less than half a revolution, against a misfit that is better by a twentieth of AS_GOOD
    assert first.odds / second.odds == pytest.approx(3.0 * np.exp(-0.05 * LOG_ODDS_OF_AS_GOOD), rel=0.01)
    limited = choose_hypothesis(alike, dt_s, is_limited=True)
    assert [each.name for each in limited] == [other, "sphere"]
    assert sum(each.odds for each in limited) == pytest.approx(1.0)
    hypotheses = {"sphere": _trial(150.0, 3000.0, 1.0), other: _trial(210.0, 1000.0, 10.0)}
    (chosen,) = choose_hypothesis(hypotheses, dt_s)
    assert chosen.name == other and chosen.odds == 1.0
    # rotations beyond what two directions explain are open, unless a limit excludes those that were not tried
    for turn_deg, disturbed, turns in (
        (466.0, False, [466.0, 106.0]),
        (180.0, False, [180.0]),
        (180.0, True, [180.0, 180.0]),
        (60.0, True, [60.0]),
    ):
        alone = {"sphere": _trial(turn_deg, 100.0, 1.0)}
        chosen_alone = choose_hypothesis(alone, dt_s)
        found = open_rotations(chosen_alone, alone, dt_s, disturbed)
        assert [each.turn_deg for each in found] == pytest.approx(turns)
        assert sum(each.odds for each in found) == pytest.approx(1.0)
        assert open_rotations(chosen_alone, alone, dt_s, disturbed, is_limited=True) == chosen_alone


def test_a_stated_limit_decides_which_rotations_are_tried() -> None:
    z = np.array([0.0, 0.0, 1.0])
    poses = make_pose(_motion(40.0, z)[0], np.zeros((30, 3)))
    for limit_deg, turns in ((30.0, [40.0]), (330.0, [40.0, -320.0]), (750.0, [40.0, -320.0, 400.0, -680.0])):
        branches = rate_branches(TIME_S, poses, EVERY, np.deg2rad(limit_deg) / 0.5)
        assert list(branches) == list(ROTATIONS[: len(turns)])
        found = [np.rad2deg(0.5 * np.median(each @ z)) for each in branches.values()]
        assert found == pytest.approx(turns, abs=0.5)


def test_a_shot_at_a_rate_beyond_the_series_leads_nowhere() -> None:
    R, w = _carry(np.array([1e9, -2e9, 3e8]), np.diag([1.5, 1.2, 0.9]), np.array([0.5, 1.0]))
    assert np.isfinite(R).all() and np.isfinite(w).all()
