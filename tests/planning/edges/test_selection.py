"""Choices of edges: greedy against the best, against its bound, and the smallest set."""

from itertools import combinations

import numpy as np
import pytest

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.information import FeatureInformation
from polhode.planning.edges.selection import (
    Value,
    best_selection,
    edge_lengths,
    greedy,
    improved_by_exchange,
    upper_bound,
    value_of,
    value_of_set,
)
from polhode.planning.edges.smallest_set import (
    SigmaLimits,
    exact_smallest_set,
    min_number,
    smallest_set,
)
from tests.planning.edges.views import block, seen

VALUES: tuple[Value, Value] = ("log_det", "trace")
GREEDY_GUARANTEE = 1.0 - float(np.exp(-1.0))
"""Share of the best log_det under a cardinality budget; half of it under a length budget."""


def random_information(n: int, views: int, seed: int, rank: int = 2) -> Array:
    """(views, n, 6, 6) of few lines each, some large, some small."""
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(views, n, rank, 6)) * np.exp(rng.normal(size=(n, 1, 1))) * 3.0
    return np.asarray(np.einsum("tnri,tnrj->tnij", f, f))


@pytest.mark.parametrize("seed", range(4))
def test_greedy_keeps_its_promise_and_the_bound_holds(seed: int) -> None:
    scaled = random_information(9, 2, seed)
    for value in VALUES:
        for budget in 2, 4:
            best = max(value_of_set(scaled, np.array(one), value) for one in combinations(range(9), budget))
            found = greedy(scaled, budget, value)
            assert found.cost == budget == len(set(found.features.tolist()))
            assert found.value == pytest.approx(value_of_set(scaled, found.features, value))
            assert found.value <= best + 1e-9 <= upper_bound(scaled, budget, value) + 2e-9
            if value == "log_det":
                assert found.value >= GREEDY_GUARANTEE * best
            assert (
                found.value <= improved_by_exchange(scaled, found, budget, value).value + 1e-12 <= best + 2e-9
            )
            assert best_selection(scaled, budget, value).value == pytest.approx(best, rel=1e-9)


def test_under_a_length_the_promise_is_half() -> None:
    scaled = random_information(9, 2, 7)
    length = np.random.default_rng(3).uniform(0.2, 2.0, 9)
    for value in VALUES:
        sets = [one for k in range(10) for one in combinations(range(9), k) if length[list(one)].sum() <= 3.0]
        best = max(value_of_set(scaled, np.array(one, dtype=int), value) for one in sets)
        found = greedy(scaled, 3.0, value, length)
        assert found.cost <= 3.0 and found.value <= best + 1e-9
        assert upper_bound(scaled, 3.0, value, length) >= best - 1e-9
        exact = best_selection(scaled, 3.0, value, length)
        assert exact.value == pytest.approx(best, rel=1e-9) and exact.cost <= 3.0
        if value == "log_det":
            assert found.value >= 0.5 * GREEDY_GUARANTEE * best


def test_lazy_greedy_chooses_as_plain_greedy_does() -> None:
    scaled = random_information(60, 3, 1)
    found = greedy(scaled, 12, "log_det")
    M = np.tile(np.eye(6), (3, 1, 1))
    chosen: list[int] = []
    for _ in range(12):
        values = value_of(M + np.swapaxes(scaled, 0, 1), "log_det")
        values[chosen] = -np.inf
        chosen.append(int(np.argmax(values)))
        M = M + scaled[:, chosen[-1]]
    assert found.features.tolist() == chosen
    assert found.evaluations < 0.5 * sum(60 - k for k in range(12))


def test_log_det_is_submodular_and_the_trace_is_not() -> None:
    rng = np.random.default_rng(0)
    scaled = random_information(8, 2, 5)
    for _ in range(50):
        order = rng.permutation(8)
        a, b, i = order[:2], order[:5], order[7]
        gain = [
            value_of_set(scaled, np.append(s, i), "log_det") - value_of_set(scaled, s, "log_det")
            for s in (a, b)
        ]
        assert gain[1] <= gain[0] + 1e-9
    # three edges that tell x and y together: the last one is worth more beside two than beside one
    f = np.zeros((3, 6))
    f[:, :2] = [[-2.0, 1.0], [9.0, -4.0], [-5.0, 5.0]]
    lines = np.einsum("ni,nj->nij", f, f)[None]

    def joined(*features: int) -> float:
        return value_of_set(lines, np.array(features), "trace")

    assert joined(0, 1, 2) - joined(0, 1) > joined(0, 2) - joined(0) + 0.3


def test_the_smallest_set_is_within_ten_percent_and_nearly_the_smallest() -> None:
    information = seen(block())
    found, exact = smallest_set(information), exact_smallest_set(information)
    assert found.at_least <= len(exact.features) <= len(found.features) <= len(exact.features) + 1
    assert found.ratio.max() <= 1.1 and exact.ratio.max() <= 1.1
    limits = SigmaLimits(information)
    for i in found.features:
        fewer = found.features[found.features != i]
        assert not limits.meets(limits.of(fewer))


def test_the_bound_of_the_smallest_set_holds() -> None:
    for seed in range(4):
        information = FeatureInformation(random_information(11, 2, seed), 1.0)
        exact = exact_smallest_set(information, 1.2)
        assert min_number(SigmaLimits(information, 1.2)) <= len(exact.features)
        assert len(exact.features) <= len(smallest_set(information, 1.2).features)


def test_more_room_needs_fewer_edges() -> None:
    information = seen(block())
    sizes = [len(smallest_set(information, factor).features) for factor in (1.05, 1.3, 2.0)]
    assert sizes[0] >= sizes[1] >= sizes[2]


def test_lengths_of_a_block_are_those_of_its_edges() -> None:
    model = block()
    length = edge_lengths(model)
    assert length.shape == (model.size,) and (length > 0.0).all()
    np.testing.assert_allclose(length[: len(model.ends_G)], model.lengths_m)


def test_what_cannot_be_chosen_is_told() -> None:
    scaled = random_information(3, 1, 0)
    with pytest.raises(InputError, match="smaller than the cost of every edge"):
        greedy(scaled, 0.5, "log_det")
    with pytest.raises(InputError, match="must be positive"):
        greedy(scaled, 2.0, "trace", np.array([1.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="no set can be selected"):
        smallest_set(FeatureInformation(np.zeros((1, 3, 6, 6)), 1.0))
    with pytest.raises(InputError, match="give a number above 1"):
        smallest_set(FeatureInformation(scaled, 1.0), 1.0)
    with pytest.raises(InputError, match="sets to test"):
        exact_smallest_set(FeatureInformation(random_information(60, 1, 0), 1.0), 1.001)
