"""Rates and inertia from attitudes alone, where the target turns far between frames."""

import numpy as np
import pytest

from polhode.backend.initialization.multistart import HypothesisFit
from polhode.backend.initialization.rates import OPPOSITE_DIRECTION, _carry, rate_branches, shoot
from polhode.backend.problem.inertia import inertia_from_second_moments
from polhode.backend.problem.iterate import Iterate
from polhode.backend.uncertainty.ambiguity import HypothesisChoice, ambiguous_turns_deg, choose_hypothesis
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


def test_a_direction_is_chosen_by_the_misfit_and_the_shorter_one_when_both_fit() -> None:
    dt_s, other = np.diff(TIME_S), "sphere" + OPPOSITE_DIRECTION
    alike = {"sphere": _trial(150.0, 1000.0, 50.0), other: _trial(210.0, 999.0, 10.0)}
    choice = choose_hypothesis(alike, dt_s)
    assert choice.name == "sphere" and choice.turns_deg == pytest.approx((150.0, 210.0))
    hypotheses = {"sphere": _trial(150.0, 3000.0, 1.0), other: _trial(210.0, 1000.0, 10.0)}
    assert choose_hypothesis(hypotheses, dt_s) == HypothesisChoice(other, None)
    assert choose_hypothesis({"sphere": _trial(30.0, 5.0, 5.0)}, dt_s).turns_deg is None
    # rotations beyond what two directions explain are open
    far, near, small = (_trial(turn, 100.0, 1.0) for turn in (466.0, 180.0, 60.0))
    chosen = HypothesisChoice("sphere", None)
    assert ambiguous_turns_deg(chosen, far, dt_s, False) == pytest.approx((466.0, 106.0))
    assert ambiguous_turns_deg(chosen, near, dt_s, False) is None
    assert ambiguous_turns_deg(chosen, near, dt_s, True) == pytest.approx((180.0, 180.0))
    assert ambiguous_turns_deg(chosen, small, dt_s, True) is None
    assert ambiguous_turns_deg(choice, small, dt_s, False) == choice.turns_deg


def test_a_shot_at_a_rate_beyond_the_series_leads_nowhere() -> None:
    R, w = _carry(np.array([1e9, -2e9, 3e8]), np.diag([1.5, 1.2, 0.9]), np.array([0.5, 1.0]))
    assert np.isfinite(R).all() and np.isfinite(w).all()
