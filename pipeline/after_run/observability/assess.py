"""The assessment: the metric along a trajectory, and the contribution of each edge."""

from dataclasses import dataclass

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array
from polhode.pipeline.after_run.observability.subject import Subject
from polhode.planning.edges.metric.contributions import Contributions, contributions
from polhode.planning.edges.metric.information import EdgeView, FeatureInformation, by_feature, views_along
from polhode.planning.edges.selection.selection import EdgeSelection, greedy, upper_bound
from polhode.planning.edges.selection.smallest_set import SigmaLimits, SmallestSet, smallest_set
from polhode.progress import Progress

MAX_VIEWS = 20
"""Views for the selection of edges, evenly spread over a trajectory; more barely change the result."""
MAX_MEMORY_MIB = 1024.0
"""Of the information matrices, one for each edge and view."""


@dataclass(frozen=True)
class Choice:
    """Sets of edges for a trajectory."""

    views: int
    smallest: SmallestSet | None
    """with each sigma at most 10 % above that of all edges; None: not requested, or nothing is observable"""
    best: EdgeSelection | None
    """of the requested number of edges; None when not requested"""
    best_ratio: Array | None
    """(6,) its sigma over that of all edges; inf where the set does not determine it, NaN where not even
    all edges do"""
    bound: float | None
    """upper bound of the value of any set of this size"""


@dataclass(frozen=True)
class Assessment:
    """The metric along a trajectory, for a noise of sigma_px normal to the edges."""

    subject: Subject
    views: list[EdgeView]
    edges: Contributions
    choice: Choice
    spacing_px: float
    sigma_px: float

    @property
    def sigma(self) -> Array:
        """(k, 6) standard deviations [m, rad], inf where a view does not determine them."""
        return self.sigma_px * np.stack([view.metric.sigma for view in self.views])


def assess(
    subject: Subject, spacing_px: float, sigma_px: float, few: int | None, fewest: bool, progress: Progress
) -> Assessment:
    """Evaluate all views; select the best ``few`` edges, or the smallest set.

    Raises InputError when the matrices would not fit into memory.
    """
    size_mib = len(subject.X_RG) * subject.model.size * 36 * 8 / 2**20
    if size_mib > MAX_MEMORY_MIB:
        raise InputError(
            f"{len(subject.X_RG)} poses of {subject.model.size} edges take {size_mib:.0f} MiB: "
            "give fewer poses, or a larger --crease-deg"
        )
    views, C = [], []
    with progress.stage("evaluating views", len(subject.X_RG)) as advance:
        for view in views_along(
            subject.model, subject.rig, subject.X_RG, subject.o_G, spacing_px, subject.sun_G
        ):
            views.append(view)
            C.append(by_feature(view.points, view.f, subject.model.size))
            advance()
    information = FeatureInformation(np.stack(C), subject.model.radius_m)
    with progress.stage("selecting edges", 1) as advance:
        choice = choose(information, few, fewest)
        advance()
    return Assessment(subject, views, contributions(information), choice, spacing_px, sigma_px)


def choose(information: FeatureInformation, edges: int | None, fewest: bool) -> Choice:
    """The best set of ``edges`` and the smallest set, where requested. Raises InputError below one."""
    if edges is None and not fewest:
        return Choice(0, None, None, None, None)
    if edges is not None and edges < 1:
        raise InputError(f"--edges {edges}: give a number above 0")
    count = len(information.C)
    views = np.unique(np.linspace(0, count - 1, min(count, MAX_VIEWS)).round().astype(int))
    few = FeatureInformation(information.C[views], information.radius_m)
    try:
        limits = SigmaLimits(few)
    except InputError:
        return Choice(len(views), None, None, None, None)
    smallest = smallest_set(few) if fewest else None
    if edges is None:
        return Choice(len(views), smallest, None, None, None)
    best = greedy(few.scaled, edges, "trace")
    bound = upper_bound(few.scaled, edges, "trace")
    return Choice(len(views), smallest, best, limits.ratio(limits.of(best.features)), bound)
