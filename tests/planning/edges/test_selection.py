"""Sets of edges: greedy against the best and against its bound, and the smallest set within ten percent."""

from itertools import combinations

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.planning.edges.information import FeatureInformation
from polhode.planning.edges.selection import greedy, upper_bound, value_of
from polhode.planning.edges.smallest_set import SigmaLimits, min_number, smallest_set
from tests.planning.edges.views import block, seen


def random_information(n: int, views: int, seed: int, rank: int = 2) -> Array:
    """(views, n, 6, 6) of few lines each, some large, some small."""
    rng = np.random.default_rng(seed)
    f = rng.normal(size=(views, n, rank, 6)) * np.exp(rng.normal(size=(n, 1, 1))) * 3.0
    return np.asarray(np.einsum("tnri,tnrj->tnij", f, f))


def value(scaled: Array, features: object) -> float:
    return float(value_of(np.eye(6) + scaled[:, np.asarray(features, dtype=int)].sum(axis=1)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [2, 4])
def test_greedy_adds_the_best_edge_and_the_bound_holds(seed: int, count: int) -> None:
    scaled = random_information(9, 2, seed)
    best = max(value(scaled, one) for one in combinations(range(9), count))
    found = greedy(scaled, count)
    for k, feature in enumerate(found.features):
        before = found.features[:k]
        free = np.setdiff1d(range(9), before)
        assert feature == free[np.argmax([value(scaled, [*before, each]) for each in free])]
    assert found.value == pytest.approx(value(scaled, found.features))
    assert found.value <= best + 1e-9 <= upper_bound(scaled, count) + 2e-9
    assert upper_bound(scaled, 9) == pytest.approx(value(scaled, range(9)))


def test_edges_without_information_are_not_chosen() -> None:
    scaled = random_information(5, 2, 0)
    scaled[:, [1, 3]] = 0.0
    assert sorted(greedy(scaled, 5).features) == [0, 2, 4]


def exact_size(limits: SigmaLimits) -> int:
    """Of the smallest set, by trying all."""
    for size in range(1, len(limits.candidates) + 1):
        if any(limits.meets(limits.of(list(one))) for one in combinations(limits.candidates.tolist(), size)):
            return size
    raise AssertionError


def test_the_smallest_set_is_within_ten_percent_and_nearly_the_smallest() -> None:
    information = seen(block())
    found, limits = smallest_set(information), SigmaLimits(information)
    assert found.at_least <= len(found.features) and found.ratio.max() <= 1.1
    for size in range(found.at_least, len(found.features) - 1):
        sets = combinations(limits.candidates.tolist(), size)
        assert not any(limits.meets(limits.of(list(one))) for one in sets)
    for i in found.features:
        assert not limits.meets(limits.of(found.features[found.features != i]))


def test_the_bound_of_the_smallest_set_holds() -> None:
    for seed in range(4):
        information = FeatureInformation(random_information(11, 2, seed), 1.0)
        limits = SigmaLimits(information, 1.2)
        exact = exact_size(limits)
        assert min_number(limits) <= exact <= len(smallest_set(information, 1.2).features)


def test_more_room_needs_fewer_edges() -> None:
    information = seen(block())
    sizes = [len(smallest_set(information, factor).features) for factor in (1.05, 1.3, 2.0)]
    assert sizes[0] >= sizes[1] >= sizes[2]
