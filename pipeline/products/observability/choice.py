"""Which edges are enough, and which to use when there is room for few."""

from dataclasses import dataclass

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array
from polhode.planning.edges.metric.information import FeatureInformation
from polhode.planning.edges.selection.selection import Chosen, greedy, upper_bound
from polhode.planning.edges.selection.smallest_set import Need, SmallestSet, smallest_set

MOST_VIEWS = 20
"""Of a trajectory, evenly spread: the choice hardly changes with more."""


@dataclass(frozen=True)
class Choice:
    """Sets of edges for a trajectory."""

    views: int
    smallest: SmallestSet | None
    """with each sigma at most 10 % above that of all edges; None: not asked for, or no view tells anything"""
    best: Chosen | None
    """of as many edges as asked for; None when that was not asked"""
    best_ratio: Array | None
    """(6,) its sigma over that of all edges; inf where it does not tell what all do, NaN where all do not"""
    bound: float | None
    """no set of so many edges has a larger value"""


def choose(information: FeatureInformation, edges: int | None, fewest: bool) -> Choice:
    """The best ``edges``, and the fewest that do, where asked for. Raises InputError for less than one."""
    if edges is None and not fewest:
        return Choice(0, None, None, None, None)
    if edges is not None and edges < 1:
        raise InputError(f"--edges {edges}: give a number above 0")
    count = len(information.C)
    views = np.unique(np.linspace(0, count - 1, min(count, MOST_VIEWS)).round().astype(int))
    few = FeatureInformation(information.C[views], information.radius_m)
    try:
        need = Need(few)
    except InputError:
        return Choice(len(views), None, None, None, None)
    smallest = smallest_set(few) if fewest else None
    if edges is None:
        return Choice(len(views), smallest, None, None, None)
    best = greedy(few.scaled, edges, "trace")
    bound = upper_bound(few.scaled, edges, "trace")
    return Choice(len(views), smallest, best, need.ratio(need.of(best.features)), bound)
