"""Long gaps: which they are, and the states that Euler's equation carries through them."""

import numpy as np
import pytest

from polhode.backend.initialization.multistart import (
    Gap,
    closing_error_rad,
    long_gaps,
    loose_steps,
    propagate_through_gaps,
)
from polhode.backend.problem.iterate import Iterate
from polhode.geometry.lie import Array, exp_so3, log_so3
from polhode.geometry.rigid_body import propagate

TIME_S: Array = 0.5 * np.arange(60.0)
J_G = np.diag([1.5, 1.2, 0.9])
COM_G = np.array([0.01, -0.02, 0.03])
INSIDE = range(20, 45)


def _truth() -> Iterate:
    v_N = np.array([0.002, -0.001, 0.003])
    w_G = np.array([0.3, 0.45, 0.35])
    r_N, v, R_NG, w = propagate(TIME_S, np.zeros(3), v_N, np.eye(3), w_G, J_G)
    return Iterate(r_N - R_NG @ COM_G, R_NG, v, w, COM_G, np.zeros(5), np.eye(3), np.zeros((0, 3)))


def _with_hole(inside: range) -> Iterate:
    """The truth with nonsense inside the gap."""
    rng, out, at = np.random.default_rng(0), _truth(), list(inside)
    out.p_NG[at], out.w_G[at] = rng.normal(size=(2, len(at), 3))
    out.R_NG[at] = exp_so3(rng.normal(size=(len(at), 3)))
    return out


@pytest.mark.parametrize("inside", [INSIDE, range(15), range(45, 60)])
def test_the_true_inertia_carries_the_state_through(inside: range) -> None:
    truth, at = _truth(), list(inside)
    gap = Gap(inside.start - 1 if inside.start > 0 else None, inside.stop if inside.stop < 60 else None)
    found = propagate_through_gaps(_with_hole(inside), J_G, TIME_S, [gap])
    assert np.linalg.norm(log_so3(np.swapaxes(found.R_NG, 1, 2) @ truth.R_NG), axis=1).max() < 1e-6
    np.testing.assert_allclose(found.p_NG, truth.p_NG, atol=1e-8)
    np.testing.assert_allclose(found.w_G, truth.w_G, atol=1e-6)
    np.testing.assert_allclose(found.v_N[at], truth.v_N[at], atol=1e-9)


def test_a_wrong_inertia_still_arrives_at_the_known_pose_one_way_or_the_other() -> None:
    truth, gaps, wrong = _truth(), [Gap(19, 45)], np.diag([1.4, 1.25, 0.95])
    assert 0.05 < closing_error_rad(truth, wrong, TIME_S, gaps) < np.pi
    assert closing_error_rad(truth, J_G, TIME_S, gaps) < 1e-6
    for opposite in (False, True):
        at = propagate_through_gaps(_with_hole(INSIDE), wrong, TIME_S, gaps, opposite)
        np.testing.assert_allclose(at.R_NG[[19, 45]], truth.R_NG[[19, 45]], atol=1e-12)
        # it enters the known pose behind the gap without a jump of more than a step's turn
        assert np.linalg.norm(log_so3(at.R_NG[44].T @ at.R_NG[45])) < 0.5


def test_short_gaps_are_none_and_the_steps_of_long_ones_are_loose() -> None:
    connected = np.ones(60, bool)
    connected[[0, 10, *INSIDE, 58, 59]] = False
    w_G = _truth().w_G
    # one frame of 0.5 s at 37 deg/s is short, 13 s are long, and so are the last 1.0 s at twice the rate
    assert long_gaps(TIME_S, connected, w_G) == [Gap(19, 45)]
    assert Gap(57, None) in long_gaps(TIME_S, connected, 3.0 * w_G)
    loose = loose_steps(60, [Gap(None, 3), Gap(19, 45), Gap(57, None)])
    assert np.flatnonzero(loose).tolist() == [0, 1, 2, *range(19, 45), 57, 58]
