"""States in principal axes: one half-turn for a run, and unknowns that say so."""

import itertools

import numpy as np

from polhode.backend.uncertainty.covariance import with_infinite
from polhode.backend.window.causal_state import unknown_state
from polhode.geometry.lie import exp_so3, make_pose
from polhode.geometry.rigid_body import HALF_TURNS, nearest_half_turn
from polhode.simulation.monte_carlo import SyntheticSequence
from tests.backend.window.conftest import Feed


def test_the_half_turn_nearest_to_the_wanted_axes() -> None:
    R_GP = exp_so3([0.4, -0.2, 0.9])
    for turn in HALF_TURNS:
        seen = R_GP @ exp_so3([0.1, 0.1, -0.1]) @ np.diag(turn)
        np.testing.assert_array_equal(np.diag(nearest_half_turn(seen, R_GP)), turn)


def test_axes_do_not_flip_from_row_to_row(tumble: SyntheticSequence, feed: Feed) -> None:
    _, states = feed(tumble)
    known = [s for s in states if s.determined[3]]
    assert len(known) > 10
    for a, b in itertools.pairwise(known):
        assert np.trace(a.R_GP.T @ b.R_GP) > 2.0


def test_nothing_known_is_finite_with_infinite_sigma_and_without_covariance() -> None:
    state = unknown_state(5, make_pose(np.eye(3), [1.0, 0.0, 0.0]))
    assert np.isfinite(state.r_N).all() and np.all(np.isinf(np.diag(state.covariance)))
    assert not state.determined.any()
    out = with_infinite(np.ones((3, 3)), np.array([False, True, False]))
    assert np.isinf(out[1, 1]) and out[0, 1] == 0.0 and out[0, 2] == 1.0
