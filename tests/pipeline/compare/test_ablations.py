"""Variants of the formulation: other unknowns reach the same cost, other problems another one."""

import numpy as np
import pytest

from pipeline.compare.judge import AGREED, judge
from pipeline.compare.measured_problem import MeasuredProblem
from pipeline.compare.registry import ABLATIONS, entries
from pipeline.compare.solver import Watch
from pipeline.compare.solvers.ablations import ABSENT, passages
from pipeline.compare.solvers.changed_unknowns import changes


@pytest.mark.parametrize("unknowns", ["rotation_vector", "mrp", "body"])
def test_other_unknowns_come_back_and_have_their_derivatives(unknowns: str, small: MeasuredProblem) -> None:
    to_x, to_z = changes(unknowns, small)
    x = small.start("perturbed", 0)
    z = to_z(x)
    again, change = to_x(z)
    assert np.allclose(again, x, atol=1e-12)
    along, step = np.random.default_rng(0).normal(size=len(z)), 1e-6
    difference = (to_x(z + step * along)[0] - to_x(z - step * along)[0]) / (2.0 * step)
    assert np.allclose(change @ along, difference, atol=1e-7)


@pytest.mark.parametrize("name", [entry.name for entry in ABLATIONS])
def test_variants_end_where_they_should(name: str, small: MeasuredProblem) -> None:
    entry = entries((name,))[0]
    found = entry.load().solve(small, small.start("near", 0), Watch(120.0))
    verdict, least = judge(small, found.x), judge(small, small.solution).cost
    assert verdict.cost is not None and least is not None
    over = verdict.cost / least - 1.0
    if entry.claim == "ok":
        assert found.converged and over < AGREED
    else:
        assert over > -AGREED


def test_a_landmark_that_comes_back_is_a_new_one(small: MeasuredProblem) -> None:
    new, old = passages(small.data)
    d = small.data
    assert np.array_equal(old[new], d.landmark)
    assert len(old) > d.n_landmarks
    for number in range(len(old)):
        frames = d.frame[new == number]
        assert np.diff(frames).max(initial=0) <= ABSENT
