"""Pose of a body from the edges of one image, where edges lie side by side: bevels, rims, thin panels.

As ``tracker.py``, but each control point is measured by all edges that are known across it
(``stripe_fit.py``), weighs as much as its profile tells, and where in its stripe the step of light lies is
an unknown of all stripes that face alike (``planning/edges/stripes.py``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.edges.tracking.edge_search import Levels, as_levels
from benchmarks.edges.tracking.stripe_fit import displacement, searched
from benchmarks.edges.tracking.tracker import TrackerOptions, track
from polhode.camera import RectifiedRig
from polhode.lie import Array, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    motion_scale,
    moved,
    pose_error,
    spectrum,
)
from polhode.planning.edges.stripes import (
    FLOOR_PX,
    HALF_PX,
    MOST_SHIFT_PX,
    MOST_SIGMA_PX,
    SAMPLED_PX,
    MeasuredStripes,
    StripeInformation,
    stripes_across,
    times_measured,
)
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point
from polhode.records import Bools


@dataclass(frozen=True)
class StripeOptions:
    """What the tracker may do."""

    far_px: tuple[float, ...] = (8.0, 8.0, 4.0, 4.0, 4.0)
    """searched on both sides from the guess, step by step"""
    near_px: tuple[float, ...] = (3.0, 3.0)
    """from a pose that is nearly right"""
    wide: int = 3
    """steps after those, from where the edges are, with weights that forget nothing"""
    steps: int = 17
    """at most, after those"""
    half_px: float = HALF_PX
    """of the profiles of those steps"""
    floor_px: float = FLOOR_PX
    """sigma of an edge's place however clear it is: blur, pixels, the model"""
    sigma_m: Array | None = None
    """(n,) of the places of the model's segments, across them; None: exact"""
    prior: "PosePrior | None" = None
    """Holds what the edges do not determine"""
    settled_px: float = 0.01
    remade_px: float = 0.5
    """control points are recomputed when they have moved by this, root mean square"""
    min_found: int = 12
    restarts: int = 4
    restart_px: float = 2.0
    same_px: float = 0.2
    """Another start that comes so near a pose that was found leads there"""
    content: float = 0.95
    """agreement from which no other start is tried: wrong poses reach 0.9"""


@dataclass(frozen=True)
class PosePrior:
    """What is known of the pose before the image."""

    X_RG: Array
    """(4, 4)"""
    information: Array
    """(6, 6) inverse of the covariance of ``pose_error`` about the model's centre"""


@dataclass(frozen=True)
class StripeTracking:
    """A pose and what it rests on."""

    X_RG: Array
    """(4, 4)"""
    points: ControlPoints
    weight: Array
    """(m,) of the points in the last step [px^-2]; 0: not found, or far off"""
    information: EdgeObservability
    """Its C (6, 6) [m^-2, m^-1 rad^-1, rad^-2], of the edges alone, is the inverse of the covariance"""
    agreement: float
    """Share of the information of all known edges that the image confirms to three sigmas, 0 to 1"""
    confirmed: float
    """That information itself [px^-2]: a wrong pose that shows few edges has little of it"""
    scale: float
    """Robust size of the residuals over their sigmas, 1 at least"""
    converged: bool
    reason: str
    """Why there is no pose; empty when there is nothing to say"""

    @property
    def covariance(self) -> Array:
        """(6, 6) [m^2, m rad, rad^2], by the residuals' own size; inf on the diagonal where unobservable."""
        return self.information.covariance * self.scale**2


def track_stripes(
    model: EdgeModel,
    rig: RectifiedRig,
    image: ArrayLike,
    X_RG: Array,
    known: EdgeModel | None = None,
    wanted: StripeOptions | None = None,
) -> StripeTracking:
    """Pose of the model in an image (H, W) of grey levels, from a guess X_RG (4, 4).

    ``known``: all edges of the body that are known, if the model has only some of them (`EdgeModel.only`).
    Never raises for what the image shows. Deterministic: restarts are drawn from a fixed seed.
    """
    wanted = wanted or StripeOptions()
    grey = as_levels(image)
    tracker = _Tracker(model, known or model, rig, grey, wanted)
    coarse = track(model, rig, image, X_RG, TrackerOptions(restarts=0))
    found = [tracker.from_guess(X_RG)]
    if len(coarse.points):
        found += tracker.from_another(coarse.X_RG, found)
    rng = np.random.default_rng(0)
    for number in range(wanted.restarts):
        best = _best(found)
        if not len(best.points) or (best.converged and best.agreement >= wanted.content):
            break
        # by turns from the best pose and from the guess, which it may have left for good
        near = (X_RG, best.X_RG)[number % 2]
        f = edge_motion(best.points, rig, near, model.centre_G)
        step = rng.standard_normal(6)
        step *= wanted.restart_px / max(float(np.sqrt(np.mean((f @ step) ** 2))), 1e-12)
        found += tracker.from_another(moved(near, step, model.centre_G), found)
    return _best(found)


def _best(found: Sequence[StripeTracking]) -> StripeTracking:
    """The one that converged and that the image confirms most of: of edges, not of its own expectation."""
    return max(found, key=lambda each: (each.converged, each.confirmed))


@dataclass(frozen=True)
class _View:
    """What is looked for from a pose."""

    points: ControlPoints
    """of the model"""
    known: ControlPoints
    """of all edges that are known, close together"""
    length: Array
    """(m,) see ``MeasuredStripes``"""


@dataclass(frozen=True)
class _Walk:
    """A pose on its way."""

    X_RG: Array
    view: _View | None = None
    """what it was last looked for with"""
    drift_px: float = np.inf
    """moved since, root mean square"""
    place: Array = field(default_factory=lambda: np.zeros(0))
    """(classes,) of the steps of light in their stripes"""
    settled: bool = False
    lost: str = ""
    """Why it goes no further"""


@dataclass(frozen=True)
class _Tracker:
    model: EdgeModel
    known: EdgeModel
    rig: RectifiedRig
    grey: Levels
    wanted: StripeOptions

    @cached_property
    def of_model(self) -> Bools:
        """(features of the known model,) which of them the tracked model has."""
        own = {ends.tobytes() for ends in self.model.ends_G}
        segments = [ends.tobytes() in own for ends in self.known.ends_G]
        return np.append(np.array(segments, dtype=bool), self.model.outlined)

    def from_guess(self, X_RG: Array) -> StripeTracking:
        """From where the pose is thought to be."""
        if transform_points(X_RG, self.model.centre_G[None])[0, 2] <= 0.0:
            return self._nothing(X_RG, "the target is behind the camera")
        return self._ended(self._settled(self._near(self._searched(X_RG, self.wanted.far_px))))

    def from_another(self, X_RG: Array, found: Sequence[StripeTracking]) -> list[StripeTracking]:
        """From a start beside it; nothing where it leads to a pose that has been found."""
        walk = self._searched(X_RG, self.wanted.near_px)
        for onward in self._near, self._settled:
            if not walk.lost and any(self._apart_px(each, walk.X_RG) < self.wanted.same_px for each in found):
                return []
            walk = onward(walk)
        return [self._ended(walk)]

    def _apart_px(self, found: StripeTracking, X_RG: Array) -> float:
        """Between a pose that was found and another one: root mean square across the edges."""
        if not len(found.points):
            return np.inf
        f = edge_motion(found.points, self.rig, found.X_RG, self.model.centre_G)
        return float(np.sqrt(np.mean((f @ pose_error(X_RG, found.X_RG, self.model.centre_G)) ** 2)))

    def _searched(self, X_RG: Array, search_px: tuple[float, ...]) -> "_Walk":
        """Each point takes the displacement within a range that explains its profile best."""
        walk = _Walk(X_RG)
        for range_px in search_px:
            walk = self._stepped(walk, range_px, True)
            if walk.lost:
                break
        return walk

    def _near(self, walk: "_Walk") -> "_Walk":
        """On from where the edges are, by weights that forget nothing."""
        for _ in range(self.wanted.wide):
            walk = walk if walk.lost else self._stepped(walk, None, True)
        return walk

    def _settled(self, walk: "_Walk") -> "_Walk":
        """To the end, without what is far off; at last by half steps, as poses may go to and fro."""
        for number in range(self.wanted.steps):
            if walk.lost or walk.settled:
                break
            walk = self._stepped(walk, None, False, 1.0 if 2 * number < self.wanted.steps else 0.5)
        return walk

    def _ended(self, walk: "_Walk") -> StripeTracking:
        return self._nothing(walk.X_RG, walk.lost) if walk.lost else self._told(walk.X_RG, walk.settled)

    def _stepped(self, walk: "_Walk", range_px: float | None, is_wide: bool, share: float = 1.0) -> "_Walk":
        """A share of one step of the pose; ``is_wide``: by weights that forget nothing."""
        view, drift_px = walk.view, walk.drift_px
        if view is None or drift_px > self.wanted.remade_px:
            view, drift_px = self._view(walk.X_RG), 0.0
        _, seen = self._look(view, walk.X_RG, range_px)
        if seen.counts.sum() < self.wanted.min_found:
            found, of = int(seen.counts.sum()), len(seen.counts)
            lost = f"edges were found at {found} of {of} control points: too few"
            return replace(walk, lost=lost)
        place = walk.place
        if range_px is not None or len(place) != seen.stripes.classes:
            place = np.zeros(seen.stripes.classes)
        told, _, _ = seen.told(place, narrow=not is_wide)
        step = share * self._step(told, self._pull_of_prior(walk.X_RG))
        if range_px is None:
            place = told.places(step)
        motion_px = float(np.sqrt(np.mean((seen.f @ step) ** 2)))
        X_RG = moved(walk.X_RG, step, self.model.centre_G)
        settled = not is_wide and motion_px < self.wanted.settled_px
        return _Walk(X_RG, view, drift_px + motion_px, place, settled)

    def _view(self, X_RG: Array, known: ControlPoints | None = None) -> _View:
        """``known``: the points of all edges that are known there, if they are at hand."""
        points = control_points(self.model, self.rig, X_RG, SPACING_PX)
        if known is None:
            known = every_point(self.known, self.rig, X_RG, SAMPLED_PX)
        own = known if self.known is self.model else known[self.of_model[known.feature]]
        return _View(points, known, points.weight / np.maximum(times_measured(points, own), 1.0))

    def _at(self, points: ControlPoints, X_RG: Array) -> ControlPoints:
        """The same points of the body, where a pose that has hardly moved shows them."""
        return replace(points, uv_px=self.rig.project(transform_points(X_RG, points.p_G))[:, :2])

    def _look(
        self, view: _View, X_RG: Array, range_px: float | None
    ) -> tuple[ControlPoints, MeasuredStripes]:
        wanted = self.wanted
        points, every = self._at(view.points, X_RG), self._at(view.known, X_RG)
        reach_px = wanted.half_px if range_px is None else range_px + 1.5
        stripes = stripes_across(points, every, X_RG, reach_px + MOST_SHIFT_PX)
        f = edge_motion(points, self.rig, X_RG, self.model.centre_G)
        if range_px is None:
            found = displacement(self.grey, points, stripes, wanted.half_px)
            return points, found.of(stripes, f, view.length, self._floor_px(points, X_RG))
        shift, good = searched(self.grey, points, stripes, range_px)
        sigma, none = np.full(len(points), MOST_SIGMA_PX), np.zeros(len(points))
        return points, MeasuredStripes(stripes, f, shift, sigma, none, good, view.length)

    def _floor_px(self, points: ControlPoints, X_RG: Array) -> Array | float:
        """Sigma of the edges' places in the image, with that of the model's segments (m,)."""
        sigma_m = self.wanted.sigma_m
        if sigma_m is None:
            return self.wanted.floor_px
        z = transform_points(X_RG, points.p_G)[:, 2]
        return np.asarray(np.hypot(self.wanted.floor_px, self.rig.focal_px * sigma_m[points.feature] / z))

    def _pull_of_prior(self, X_RG: Array) -> Array:
        """(6,) the prior's information times the step back to its pose."""
        prior = self.wanted.prior
        if prior is None:
            return np.zeros(6)
        return -np.asarray(prior.information @ pose_error(X_RG, prior.X_RG, self.model.centre_G))

    def _step(self, told: StripeInformation, pull_of_prior: Array) -> Array:
        """Least squares in the directions that are seen; a step of half a radius is a sigma too far."""
        prior = self.wanted.prior
        C, pull = told.C + (0.0 if prior is None else prior.information), told.pull + pull_of_prior
        values, directions, seen = spectrum(C, self.model.radius_m)
        unit = motion_scale(self.model.radius_m)
        part = np.where(seen, directions.T @ (unit * pull) / (np.maximum(values, 0.0) + 4.0), 0.0)
        return np.asarray(unit * (directions @ part))

    def _told(self, X_RG: Array, settled: bool) -> StripeTracking:
        """The record of the last pose, where its points are measured a last time."""
        view = self._view(X_RG)
        points, seen = self._look(view, X_RG, None)
        if seen.counts.sum() < self.wanted.min_found:
            return self._nothing(X_RG, "too few edges were found at the last pose")
        _, weight, scale = seen.told(seen.settled_places(), narrow=True)
        C = seen.weighted(weight).C
        information = EdgeObservability(C, self.model.radius_m, int(seen.counts.sum()))
        reason = information.describe_unobservable() if settled else "the pose has not settled"
        if self.known is not self.model:
            # edges that are known without being used say whether the pose is right
            every = replace(self, model=self.known, wanted=replace(self.wanted, sigma_m=None))
            _, seen = every._look(every._view(X_RG, view.known), X_RG, None)
        confirmed, share = self._confirmed(seen)
        return StripeTracking(X_RG, points, weight, information, share, confirmed, scale, settled, reason)

    def _confirmed(self, seen: MeasuredStripes) -> tuple[float, float]:
        """Information that the image confirms to three sigmas [px^-2], and its share of what is expected."""
        size = np.abs(seen.residual(seen.settled_places()))
        expected = seen.length / np.maximum(seen.sigma_px**2 + seen.spread_px**2, self.wanted.floor_px**2)
        confirmed = float(expected[seen.counts & (size < 3.0)].sum())
        return confirmed, confirmed / float(expected.sum())

    def _nothing(self, X_RG: Array, reason: str) -> StripeTracking:
        none = EdgeObservability(np.zeros((6, 6)), self.model.radius_m, 0)
        points = control_points(self.model, self.rig, X_RG, SPACING_PX)[np.zeros(0, dtype=np.int64)]
        return StripeTracking(X_RG, points, np.zeros(0), none, 0.0, 0.0, np.inf, False, reason)
