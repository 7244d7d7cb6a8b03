"""The votes that are compared: right proposals have most support in each, and what they ignore is ignored."""

import numpy as np
import pytest

from benchmarks.frontend.votes import PAIRS, VOTES, Judged, _cells
from polhode.lie import Array, exp_so3

RIGHT, WRONG = 20, 30
TURN = exp_so3([0.3, -0.7, 0.2])


def _axes(rng: np.random.Generator, n: int) -> Array:
    return np.array([exp_so3(v) for v in rng.uniform(-1.8, 1.8, (n, 3))])


def proposals(with_axes: bool = True) -> tuple[Array, ...]:
    """Points and axes in both frames, weights and gates: first the right ones. Axes may be chance."""
    rng = np.random.default_rng(4)
    n = RIGHT + WRONG
    p_B, R_BS = rng.uniform(-0.1, 0.1, (n, 3)), _axes(rng, n)
    p_A, R_AS = p_B @ TURN.T, TURN @ R_BS
    p_A[RIGHT:], R_AS[RIGHT:] = rng.uniform(-0.1, 0.1, (WRONG, 3)), _axes(rng, WRONG)
    if not with_axes:
        R_AS = _axes(rng, n)
    return p_A, p_B, R_AS, R_BS, rng.uniform(0.5, 1.0, n), np.full(n, 0.002)


@pytest.mark.parametrize("vote", VOTES)
def test_right_proposals_have_most_support(vote: str) -> None:
    agrees, support = VOTES[vote](*proposals())
    assert support[:RIGHT].min() > support[RIGHT:].max()
    assert agrees[:RIGHT, :RIGHT].mean() > 0.7 and agrees[RIGHT:, RIGHT:].mean() < 0.15
    assert np.array_equal(agrees, agrees.T) and agrees.diagonal().all()


def test_distances_need_no_axes() -> None:
    given = proposals(with_axes=False)
    _, support = VOTES["distances"](*given)
    assert support[:RIGHT].min() > support[RIGHT:].max()
    agrees, _ = PAIRS(*given)
    assert agrees[:RIGHT, :RIGHT].mean() < 0.2


def test_the_cells_are_means_at_each_angle() -> None:
    judged = [
        Judged(1, 10, 8, True, True, 0.002),
        Judged(1, 20, 10, False, False, 0.004),
        Judged(2, 6, 2, True, False, 0.006),
    ]
    assert _cells(judged) == ["15, 6", "9.0, 2.0", "100, 0", "4"]
