"""Pose of a body from the edges of one image, from a guess near by.

Drummond and Cipolla, IEEE PAMI 24(7), 2002: project the model's edges at the guess, cut them into control
points, look for edges of the image along their normals, move the pose by the weighted least squares of the
distances (M-estimator), and go on while the search narrows. The information that the last step had is C of
the observability metric, with robust weights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.edges.tracking.edge_search import EdgeCandidates, Levels, as_levels, search
from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    motion_scale,
    moved,
    observability,
    spectrum,
)
from polhode.planning.edges.stripes import median_scale, robust_weight
from polhode.planning.edges.visible_edges import SEPARATION_PX, SPACING_PX, ControlPoints, clear_points
from polhode.records import Bools, Ints

BESIDE_PX = 3.0
"""How far from the edge either side is looked at."""


@dataclass(frozen=True)
class TrackerOptions:
    """What the tracker may do."""

    ranges_px: tuple[float, ...] = (16.0, 8.0, 4.0)
    """searched on both sides of an edge, from the first to the last iterations"""
    iterations: int = 8
    """at most, at each range"""
    spacing_px: float = SPACING_PX
    min_contrast: float = 4.0
    """grey levels"""
    min_sigma_px: float = 0.1
    """residuals are not weighted as if they were better than this"""
    max_sigma_px: float = 1.0
    """nor, at the last range, worse; with each step there the limit falls by half, down to the least"""
    settled_px: float = 0.01
    """the pose has settled when the edges move by less, root mean square"""
    remade_px: float = 1.0
    """control points are recomputed when they have moved by this, root mean square"""
    separation_px: float = SEPARATION_PX
    """control points that are nearer to another edge, side by side with it, do not count"""
    min_found: int = 12
    """control points"""
    restarts: int = 6
    """from poses near the found one, while less than a share of the edges agrees"""
    restart_px: float = 3.0
    """how far a restart moves the edges, root mean square"""
    content: float = 0.9
    dark_sky: bool = True
    """The body is brighter than what is behind it"""


@dataclass(frozen=True)
class TrackingResult:
    """A pose and what it rests on: m control points at that pose."""

    X_RG: Array
    """(4, 4)"""
    points: ControlPoints
    f: Array
    """(m, 6) of `edge_motion` about the middle of the model's box"""
    residuals_px: Array
    """(m,) from the model's edge to that of the image, along the normal; NaN where none was found"""
    contrast: Array
    """(m,) step of grey levels there; 0 where none was found"""
    robust: Array
    """(m,) weight of the M-estimator, 0 to 1; 0 where none was found"""
    beside: Bools
    """(m, 2) whether the body is behind and before the point along the normal, else sky"""
    information: EdgeObservability
    """its C (6, 6) = sum of w f f^T, w the length that a point stands for times its robust weight"""
    iterations: int
    converged: bool
    reason: str
    """why there is no pose, or what of it is not seen; empty when there is nothing to say"""

    @property
    def C(self) -> Array:
        """(6, 6) for one pixel of noise."""
        return self.information.C

    @property
    def found(self) -> Bools:
        """(m,) where the image has an edge within the last range."""
        return np.isfinite(self.residuals_px)

    @property
    def found_share(self) -> float:
        """Length of edge that was found over what was expected: the binary metric. 0 without any."""
        expected = float(self.points.weight.sum())
        return float(self.points.weight[self.found].sum()) / expected if expected > 0.0 else 0.0

    @property
    def sigma_px(self) -> float:
        """Root mean square of the residuals, robustly weighted; inf where they are too few."""
        weight = self.robust * self.points.weight
        many = float((self.robust > 0.0).sum())
        if many <= 6.0:
            return np.inf
        total = float(np.nansum(weight * self.residuals_px**2))
        return float(np.sqrt(total / weight.sum() * many / (many - 6.0)))

    @property
    def covariance(self) -> Array:
        """(6, 6) for independent residuals of sigma_px; see `calibrated_covariance.py` for a better one."""
        return self.information.covariance * self.sigma_px**2


def track(
    model: EdgeModel, rig: RectifiedRig, image: ArrayLike, X_RG: Array, wanted: TrackerOptions | None = None
) -> TrackingResult:
    """Pose of the model in an image (H, W) of grey levels, from a guess X_RG (4, 4).

    Never raises for what the image shows: `converged` and `reason` say what went wrong. Deterministic:
    restarts are drawn from a fixed seed.
    """
    wanted = wanted or TrackerOptions()
    grey = as_levels(image)
    found = _track(model, rig, grey, X_RG, wanted, wanted.ranges_px)
    rng = np.random.default_rng(0)
    for _ in range(wanted.restarts):
        if len(found.points) == 0 or _agreement(found, wanted) >= wanted.content:
            break
        step = rng.standard_normal(6)
        step *= wanted.restart_px / max(float(np.sqrt(np.mean((found.f @ step) ** 2))), 1e-12)
        other = _track(
            model, rig, grey, moved(found.X_RG, step, model.centre_G), wanted, wanted.ranges_px[-1:]
        )
        if other.converged and (_agreement(other, wanted) > _agreement(found, wanted) or not found.converged):
            found = other
    return found


def _agreement(tracked: TrackingResult, wanted: TrackerOptions) -> float:
    """Length of edge that is found to three of the least sigmas, over what was expected."""
    close = np.abs(np.nan_to_num(tracked.residuals_px, nan=np.inf)) < 3.0 * wanted.min_sigma_px
    return float(tracked.points.weight[close].sum() / tracked.points.weight.sum())


def _track(
    model: EdgeModel,
    rig: RectifiedRig,
    grey: Levels,
    X_RG: Array,
    wanted: TrackerOptions,
    ranges_px: tuple[float, ...],
) -> TrackingResult:
    """From one guess, without restarts."""
    o_G = model.centre_G
    if transform_points(X_RG, o_G[None])[0, 2] <= 0.0:
        return _nothing(X_RG, model.radius_m, "the target is behind the camera")
    view = _view(model, rig, X_RG, wanted)
    steps, drift_px, settled, few = 0, 0.0, False, False
    for number, range_px in enumerate(ranges_px):
        last = number == len(ranges_px) - 1
        for turn in range(wanted.iterations * (2 if last else 1)):
            max_px = max(wanted.max_sigma_px * 0.5**turn, wanted.min_sigma_px) if last else np.inf
            if len(view.points) < wanted.min_found:
                return _nothing(X_RG, model.radius_m, _too_few(len(view.points), wanted))
            found = _measure(view, grey, range_px, wanted)
            f = edge_motion(view.points, rig, X_RG, o_G)
            step, few = _fit(found, f, view.points.weight, model.radius_m, wanted, max_px)
            if few:
                break
            X_RG = moved(X_RG, step, o_G)
            steps += 1
            motion_px = float(np.sqrt(np.mean((f @ step) ** 2)))
            drift_px += motion_px
            if drift_px > wanted.remade_px:
                view, drift_px = _view(model, rig, X_RG, wanted), 0.0
            else:
                view = view.at(rig, X_RG)
            settled = motion_px < wanted.settled_px
            narrowest = max_px in (np.inf, wanted.min_sigma_px)
            if narrowest and motion_px < (wanted.settled_px if last else 0.3):
                break
    return _told(model, rig, view, grey, X_RG, steps, settled, few, wanted)


@dataclass(frozen=True)
class _View:
    """Control points with what is beside them."""

    points: ControlPoints
    beside: Bools

    def at(self, rig: RectifiedRig, X_RG: Array) -> "_View":
        """The same points of the model, where a pose that has hardly moved shows them."""
        p = self.points
        uv = rig.project(transform_points(X_RG, p.p_G))[:, :2]
        return _View(ControlPoints(p.p_G, uv, p.normal_px, p.feature, p.weight, p.sides_G), self.beside)


def _view(model: EdgeModel, rig: RectifiedRig, X_RG: Array, wanted: TrackerOptions) -> _View:
    points = clear_points(model, rig, X_RG, wanted.spacing_px, wanted.separation_px)
    return _View(points, body_beside(points, model, rig, X_RG))


def _measure(view: _View, grey: Levels, range_px: float, wanted: TrackerOptions) -> EdgeCandidates:
    points = view.points
    sign = polarity(view.beside) if wanted.dark_sky else np.zeros(len(points), dtype=np.int64)
    return search(grey, points.uv_px, points.normal_px, sign, range_px, wanted.min_contrast)


def _fit(
    found: EdgeCandidates, f: Array, length: Array, radius_m: float, wanted: TrackerOptions, max_px: float
) -> tuple[Array, bool]:
    """Step (6,) of the pose by iterated weighted least squares, and whether too few edges were found."""
    step = np.zeros(6)
    for _ in range(10):
        d, _ = _nearest(found, f @ step)
        seen = np.isfinite(d)
        if seen.sum() < wanted.min_found:
            return step, True
        residual = d[seen] - f[seen] @ step
        scale = min(_scale(residual, length[seen], wanted), max_px)
        weight = length[seen] * robust_weight(residual / scale, narrow=np.isfinite(max_px))
        before = step
        step = _solve(f[seen], d[seen], weight, radius_m, scale)
        if np.mean((f @ (step - before)) ** 2) < (0.1 * wanted.settled_px) ** 2:
            break
    return step, False


def _nearest(found: EdgeCandidates, at_px: Array) -> tuple[Array, Array]:
    """Of the candidates of each point the one nearest to a place (m,) along its normal; its contrast."""
    away = np.where(np.isnan(found.offset_px), np.inf, np.abs(found.offset_px - at_px[:, None]))
    which = np.argmin(away, axis=1)
    row = np.arange(len(at_px))
    return found.offset_px[row, which], found.contrast[row, which]


def _scale(residual: Array, length: Array, wanted: TrackerOptions) -> float:
    """Sigma of residuals [px]; each counts with the length of edge that it stands for."""
    return max(median_scale(residual, length), wanted.min_sigma_px)


def _solve(f: Array, d: Array, weight: Array, radius_m: float, scale: float) -> Array:
    """Weighted least squares in the directions that are seen; a step of half a radius is a sigma too far."""
    values, directions, seen = spectrum(observability(f, weight, radius_m).C, radius_m)
    unit = motion_scale(radius_m)
    v = directions.T @ (unit * (f.T @ (weight * d)))
    part = np.where(seen, v / (np.maximum(values, 0.0) + (scale / 0.5) ** 2), 0.0)
    return np.asarray(unit * (directions @ part))


def _told(
    model: EdgeModel,
    rig: RectifiedRig,
    view: _View,
    grey: Levels,
    X_RG: Array,
    steps: int,
    settled: bool,
    few: bool,
    wanted: TrackerOptions,
) -> TrackingResult:
    """The record of the last pose, measured once more there."""
    points = view.points
    found = _measure(view, grey, wanted.ranges_px[-1], wanted)
    d, contrast = _nearest(found, np.zeros(len(points)))
    seen = np.isfinite(d)
    robust = np.zeros(len(points))
    if seen.any():
        robust[seen] = robust_weight(d[seen] / wanted.min_sigma_px, narrow=True)
    f = edge_motion(points, rig, X_RG, model.centre_G)
    information = observability(f, points.weight * robust, model.radius_m)
    if few or seen.sum() < wanted.min_found:
        reason = f"edges were found at {seen.sum()} of {len(points)} control points: too few for a pose"
    elif not settled:
        reason = f"the pose has not settled after {steps} steps"
    else:
        reason = information.describe_unobservable()
    converged = settled and not few and seen.sum() >= wanted.min_found
    contrast = np.where(seen, contrast, 0.0)
    return TrackingResult(
        X_RG, points, f, d, contrast, robust, view.beside, information, steps, converged, reason
    )


def _too_few(points: int, wanted: TrackerOptions) -> str:
    if points == 0:
        return "no edge is in sight"
    return f"{points} control points are in sight, fewer than {wanted.min_found}"


def _nothing(X_RG: Array, radius_m: float, reason: str) -> TrackingResult:
    """No control points, no information."""
    none = np.zeros((0, 2))
    points = ControlPoints(
        np.zeros((0, 3)), none, none, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2, 3))
    )
    f = np.zeros((0, 6))
    information = observability(f, np.zeros(0), radius_m)
    empty = np.zeros(0)
    return TrackingResult(
        X_RG, points, f, empty, empty, empty, np.zeros((0, 2), dtype=bool), information, 0, False, reason
    )


def body_beside(points: ControlPoints, model: EdgeModel, rig: RectifiedRig, X_RG: Array) -> Bools:
    """(m, 2) whether a ray BESIDE_PX behind and before each point along its normal meets the body."""
    p_R = transform_points(X_RG, points.p_G)
    X_GR = inverse_pose(X_RG)
    out = np.zeros((len(points), 2), dtype=bool)
    for column, side in enumerate((-BESIDE_PX, BESIDE_PX)):
        beside = p_R.copy()
        beside[:, :2] += side * points.normal_px * (p_R[:, 2:] / rig.focal_px)
        # The occluder looks 2.5 radii back from a place: first before the point, then behind it.
        reach = 1.0 + 2.4 * model.radius_m / np.maximum(np.linalg.norm(beside, axis=1), 1e-9)
        for factor in np.ones_like(reach), reach:
            place_G = transform_points(X_GR, beside * factor[:, None])
            out[:, column] |= model.occluder.hides(X_GR[:3, 3], place_G, 0.0)
    return out


def polarity(beside: Bools) -> Ints:
    """(m,) 1 where the light grows along the normal, from a dark sky to the body; -1 the reverse; else 0."""
    return beside[:, 1].astype(np.int64) - beside[:, 0].astype(np.int64)
