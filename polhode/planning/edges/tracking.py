"""Pose of a body from the edges of one image, also where edges lie side by side: bevels, rims, thin panels.

Each control point is measured by all edges that are known across it (``profiles.py``) and weighs as
much as its profile tells; where in its stripe the step of light lies is an unknown of all stripes that face
alike (``stripes.py``). The pose is sought from the guess and from further starts; of the poses that are
found, that one is taken of whose edges the image confirms most. ``expected_tracking.py`` predicts its errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    motion_scale,
    moved,
    pose_error,
    spectrum,
)
from polhode.planning.edges.profiles import Levels, as_levels, fitted, profiles, searched
from polhode.planning.edges.stripes import (
    FLOOR_PX,
    HALF_PX,
    MAX_SHIFT_PX,
    MAX_SIGMA_PX,
    SAMPLED_PX,
    MeasuredStripes,
    stripes_across,
    times_measured,
)
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point

MIN_POINTS = 12
"""Control points with a measurement, for a pose"""


@dataclass(frozen=True)
class PosePrior:
    """What is known of the pose before the image: it holds what the edges do not determine."""

    X_RG: Array
    """(4, 4)"""
    information: Array
    """(6, 6) inverse of the covariance of ``pose_error`` about the model's centre"""


@dataclass(frozen=True)
class TrackingOptions:
    """What the tracker may do, and what is known of edges and pose."""

    ranges_px: tuple[float, ...] = (8.0, 8.0, 4.0, 4.0, 4.0)
    """Searched on both sides from the guess, step by step"""
    restarts: int = 4
    floor_px: float = FLOOR_PX
    """Sigma of an edge's place in an image however clear it is: blur, pixels, the model"""
    sigma_m: Array | None = None
    """(n,) of the places of the model's segments, across them; None: exact"""
    prior: PosePrior | None = None


@dataclass(frozen=True)
class TrackedPose:
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
    """Why there is no pose, or what the edges do not determine; empty when there is nothing to say"""

    @property
    def covariance(self) -> Array:
        """(6, 6) [m^2, m rad, rad^2], by the residuals' own size; inf on the diagonal where unobservable."""
        return self.information.covariance * self.scale**2


def track_edges(
    model: EdgeModel,
    rig: RectifiedRig,
    image: ArrayLike,
    X_RG: Array,
    known: EdgeModel | None = None,
    options: TrackingOptions | None = None,
) -> TrackedPose:
    """Pose of the model in an image (H, W) of grey levels, from a guess X_RG (4, 4).

    ``known``: all edges of the body that are known, if the model has only some of them (`EdgeModel.only`).
    Never raises for what the image shows. Deterministic: restarts are drawn from a fixed seed.
    """
    options = options or TrackingOptions()
    tracker = _Tracker(model, known or model, rig, as_levels(image), options)
    found = tracker.run(X_RG, options.ranges_px, [])
    rng = np.random.default_rng(0)
    for number in range(options.restarts + 1):
        # the one that converged and that the image confirms most of: of edges, not of its own expectation
        best = max(found, key=lambda each: (each.converged, each.confirmed))
        # wrong poses reach an agreement of 0.9
        sure = best.converged and best.agreement >= 0.95
        if number == options.restarts or not len(best.points) or sure:
            break
        # in turn from the best pose and from the guess, which it may have left for good
        near = (X_RG, best.X_RG)[number % 2]
        f = edge_motion(best.points, rig, near, model.centre_G)
        step = rng.standard_normal(6)
        # the edges move by 2 px, root mean square
        step *= 2.0 / max(float(np.sqrt(np.mean((f @ step) ** 2))), 1e-12)
        found += tracker.run(moved(near, step, model.centre_G), (3.0, 3.0), found)
    return best


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
class _Tracker:
    model: EdgeModel
    known: EdgeModel
    rig: RectifiedRig
    grey: Levels
    options: TrackingOptions

    @cached_property
    def of_model(self) -> Bools:
        """(features of the known model,) which of them the tracked model has."""
        own = {ends.tobytes() for ends in self.model.ends_G}
        segments = [ends.tobytes() in own for ends in self.known.ends_G]
        return np.append(np.array(segments, dtype=bool), self.model.outlined)

    def run(self, X_RG: Array, ranges_px: Sequence[float], found: Sequence[TrackedPose]) -> list[TrackedPose]:
        """The pose from a start; none where it leads to one that has been found.

        First each point takes the displacement within a range that explains its profile best; then the pose
        goes on from where the edges are, for three steps with weights that forget nothing; and at last for up
        to 17 without what is far off, in the end by half steps, as poses may go to and fro.
        """
        if transform_points(X_RG, self.model.centre_G[None])[0, 2] <= 0.0:
            return [self._no_pose(X_RG, "the target is behind the camera")]
        view: _View | None = None
        drift_px, place, settled = np.inf, np.zeros(0), False
        searches = len(ranges_px)
        for number in range(searches + 3 + 17):
            if number in (searches, searches + 3) and any(self._is_near(each, X_RG) for each in found):
                return []
            range_px = ranges_px[number] if number < searches else None
            narrow, share = number >= searches + 3, 0.5 if number >= searches + 3 + 9 else 1.0
            if view is None or drift_px > 0.5:
                view, drift_px = self._view(X_RG), 0.0
            _, measured = self._measure(view, X_RG, range_px)
            count = int(measured.counts.sum())
            if count < MIN_POINTS:
                of = len(measured.counts)
                return [self._no_pose(X_RG, f"edges were found at {count} of {of} control points: too few")]
            if range_px is not None or len(place) != measured.stripes.classes:
                place = np.zeros(measured.stripes.classes)
            equations, _, _ = measured.normal_equations(place, narrow=narrow)
            C, pull, prior = equations.C, equations.pull, self.options.prior
            if prior is not None:
                C = C + prior.information
                pull = pull - prior.information @ pose_error(X_RG, prior.X_RG, self.model.centre_G)
            # least squares in the directions that are seen; a step of half a radius is a sigma too far
            values, directions, seen = spectrum(C, self.model.radius_m)
            unit = motion_scale(self.model.radius_m)
            part = np.where(seen, directions.T @ (unit * pull) / (np.maximum(values, 0.0) + 4.0), 0.0)
            step = share * unit * (directions @ part)
            if range_px is None:
                place = equations.places(step)
            motion_px = float(np.sqrt(np.mean((measured.f @ step) ** 2)))
            X_RG, drift_px = moved(X_RG, step, self.model.centre_G), drift_px + motion_px
            if settled := narrow and motion_px < 0.01:
                break
        return [self._result(X_RG, settled)]

    def _is_near(self, found: TrackedPose, X_RG: Array) -> bool:
        """Whether a pose that was found and another one agree to 0.2 px root mean square across the edges."""
        if not len(found.points):
            return False
        f = edge_motion(found.points, self.rig, found.X_RG, self.model.centre_G)
        off_px = f @ pose_error(X_RG, found.X_RG, self.model.centre_G)
        return float(np.sqrt(np.mean(off_px**2))) < 0.2

    def _view(self, X_RG: Array, known: ControlPoints | None = None) -> _View:
        """``known``: the points of all edges that are known there, if they are at hand."""
        points = control_points(self.model, self.rig, X_RG, SPACING_PX)
        if known is None:
            known = every_point(self.known, self.rig, X_RG, SAMPLED_PX)
        own = known if self.known is self.model else known[self.of_model[known.feature]]
        return _View(points, known, points.weight / np.maximum(times_measured(points, own), 1.0))

    def _measure(
        self, view: _View, X_RG: Array, range_px: float | None
    ) -> tuple[ControlPoints, MeasuredStripes]:
        """The points where a pose that has hardly moved shows them, searched within a range or fitted."""
        points, every = (
            replace(each, uv_px=self.rig.project(transform_points(X_RG, each.p_G))[:, :2])
            for each in (view.points, view.known)
        )
        reach_px = HALF_PX if range_px is None else range_px + 1.5
        stripes = stripes_across(points, every, X_RG, reach_px + MAX_SHIFT_PX)
        f = edge_motion(points, self.rig, X_RG, self.model.centre_G)
        place, grey = profiles(self.grey, points, reach_px)
        if range_px is not None:
            shift, good = searched(place, grey, stripes, range_px)
            sigma, none = np.full(len(points), MAX_SIGMA_PX), np.zeros(len(points))
            return points, MeasuredStripes(stripes, f, shift, sigma, none, good, view.length)
        floor_px: Array | float = self.options.floor_px
        if self.options.sigma_m is not None:
            # with that of the model's segments, in the image
            z = transform_points(X_RG, points.p_G)[:, 2]
            floor_px = np.hypot(floor_px, self.rig.focal_px * self.options.sigma_m[points.feature] / z)
        return points, fitted(place, grey, stripes).of(stripes, f, view.length, floor_px)

    def _result(self, X_RG: Array, settled: bool) -> TrackedPose:
        """The record of the last pose, where its points are measured a last time."""
        view = self._view(X_RG)
        points, measured = self._measure(view, X_RG, None)
        count = int(measured.counts.sum())
        if count < MIN_POINTS:
            return self._no_pose(X_RG, "too few edges were found at the last pose")
        _, weight, scale = measured.normal_equations(measured.settled_places(), narrow=True)
        information = EdgeObservability(measured.weighted(weight).C, self.model.radius_m, count)
        reason = information.describe_unobservable() if settled else "the pose has not settled"
        if self.known is not self.model:
            # edges that are known without being used say whether the pose is right
            every = replace(self, model=self.known, options=replace(self.options, sigma_m=None))
            _, measured = every._measure(every._view(X_RG, view.known), X_RG, None)
        size = np.abs(measured.residual(measured.settled_places()))
        variance = measured.sigma_px**2 + measured.spread_px**2
        expected = measured.length / np.maximum(variance, self.options.floor_px**2)
        confirmed = float(expected[measured.counts & (size < 3.0)].sum())
        agreement = confirmed / float(expected.sum())
        return TrackedPose(X_RG, points, weight, information, agreement, confirmed, scale, settled, reason)

    def _no_pose(self, X_RG: Array, reason: str) -> TrackedPose:
        none = EdgeObservability(np.zeros((6, 6)), self.model.radius_m, 0)
        points = control_points(self.model, self.rig, X_RG, SPACING_PX)[np.zeros(0, dtype=np.int64)]
        return TrackedPose(X_RG, points, np.zeros(0), none, 0.0, 0.0, np.inf, False, reason)
