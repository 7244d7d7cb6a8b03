"""The interface of methods that match the features of two frames, and the registry of their names.

``frontend.pairs.method`` names the method. As for feature methods, it is instantiated once in each process
and imported only when it is used.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.methods import make_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.geometry.lie import Array, Ints


@dataclass(frozen=True)
class Matches:
    """Features of two frames that look alike, before any geometric check; each feature at most once."""

    features: Ints
    """(m, 2) indices into the features of a and of b"""
    confidence: Array
    """(m,) from 0 to 1, on the method's own scale: larger is more certain"""

    @classmethod
    def none(cls) -> "Matches":
        """No matches."""
        return cls(np.zeros((0, 2), np.int64), np.zeros(0))


class MatchMethod(Protocol):
    """Features of two frames to matches, without knowledge of the motion between them."""

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches between the features of frames a and b, either of which may have none."""
        ...


@runtime_checkable
class HypothesisMethod(Protocol):
    """A method that can tell several motions between the same two frames apart."""

    def hypotheses(self, a: StereoFeatures, b: StereoFeatures, count: int) -> list[Matches]:
        """The matches of each of the ``count`` motions with most support, that one first."""
        ...


MATCH_METHODS: Mapping[str, str] = {
    "nearest": "polhode.frontend.matching.nearest:MutualNearest",
    "polhode": "polhode.frontend.matching.matchers:SoftmaxMatcher",
}
"""Name in ``frontend.pairs.method`` -> module:class, called with the configuration."""


@lru_cache(maxsize=4)
def match_method(config: Frontend) -> MatchMethod:
    """The configured method."""
    method: MatchMethod = make_method(MATCH_METHODS[config.matcher], config)
    return method


def one_to_one(pairs: Ints, confidence: Array) -> Ints:
    """Positions of the pairs (m, 2) to keep so that no feature has two: greedily by confidence; ascending."""
    order = np.argsort(-confidence, kind="stable")
    used_a, used_b, kept = set[int](), set[int](), []
    for k in order.tolist():
        i, j = int(pairs[k, 0]), int(pairs[k, 1])
        if i not in used_a and j not in used_b:
            used_a.add(i)
            used_b.add(j)
            kept.append(k)
    return np.array(sorted(kept), dtype=np.int64)


def mutual_best(pairs: Ints, cost: Array) -> Ints:
    """Positions of the pairs (m, 2) that are the best of both their members, by cost (m,); cheapest first."""
    order = np.argsort(cost, kind="stable")
    best = np.zeros((len(order), 2), dtype=bool)
    for side in (0, 1):
        best[np.unique(pairs[order, side], return_index=True)[1], side] = True
    return np.asarray(order[best.all(axis=1)])
