"""The keep-out volume: the space that the target may sweep over a horizon, at a confidence.

Three steps. The measured surface is grown until it contains the true one (``measured_body``). The volume that
it sweeps by the estimated motion is grown by c sigma of the pose, instant by instant. Members sampled from
the covariance then give the margin to be added: with it, all but the allowed share of them stay inside with
their whole sweep (split conformal prediction: Vovk, Gammerman, Shafer 2005; Lei et al., J. Am. Stat. Assoc.
113, 2018). This also compensates errors of the grid and of the linearised sigma. One half of the members
chooses the c of the smallest volume; the other half, independent of that choice, gives the margin.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array
from polhode.planning.keep_out.distance_fields import (
    FAR,
    closest,
    linear,
    protrusion,
    protrusion_at_instants,
    sigma_along,
    sweep,
    values_at,
)
from polhode.planning.keep_out.measured_body import (
    Cover,
    MeasuredBody,
    ScalarGrid,
    cavities,
    grown_body,
    thinned_vertices,
)
from polhode.planning.prediction import (
    BodyMotion,
    Ensemble,
    FinalEstimate,
    draw_ensemble,
    nominal_motion,
    pose_covariance,
)
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError

Floats = NDArray[np.float32]
FACTORS = np.array([0.0, 1.5, 2.5, 3.5])
"""Candidates of c; the remaining margin is added uniformly."""
SURFACE_SHARE = 0.1
"""Of the allowed probability of a miss: the surface's; the pose has the rest."""
MAX_STEPS = 4000
MAX_MEMBER_STEPS = 1000
MAX_INSTANTS = 40
MEMBER_ROTATION_RAD = 0.05
"""Between two instants of the members, unless that takes too many steps."""
BAND_SIGMAS = 3.0
PARTS_OF_HORIZON = 6
"""Errors change slowly: of the points in a cell, one represents the others in each part of the horizon."""
INSTANT_POINTS_CELLS = 4.0
BEYOND_CELLS = 2.0
"""Beyond this the distance is that to the points of the surface, not the grid's."""


@dataclass(frozen=True)
class KeepOutOptions:
    """Options of a keep-out volume."""

    horizon_s: float
    confidence: float
    members: int = 800
    cells: int = 72
    """along the longest side of the swept space"""
    cover: Cover = "auto"
    seed: int = 0

    @property
    def pose_miss(self) -> float:
        """Allowed probability that the pose leaves the volume."""
        return (1.0 - self.confidence) * (1.0 - SURFACE_SHARE)

    @property
    def members_needed(self) -> int:
        """Least number of members for the confidence."""
        return 2 * (int(np.ceil(1.0 / self.pose_miss)) + 1)


@dataclass(frozen=True)
class SweptKeepOut:
    """The volume over the whole horizon, in N."""

    level: ScalarGrid
    """negative inside; within two cells of the surface nearly the distance [m]"""
    factor: float
    """c: sigmas of the pose"""
    added_m: float
    """margin in addition, for the confidence"""

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """Closed surface in N."""
        return self.level.mesh()

    @property
    def volume_m3(self) -> float:
        return float(abs(self.mesh.volume))

    @cached_property
    def distance(self) -> ScalarGrid:
        """Signed distance [m] to the surface, negative inside: exact to a fraction of a cell."""
        level = self.level
        V = np.asarray(self.mesh.vertices, dtype=np.float64)
        near = closest(level.origin, level.step_m, level.values.shape, V, np.zeros(len(V))).reshape(-1)
        away = np.linalg.norm(level.corners() - V[near], axis=1).reshape(level.values.shape)
        close = np.abs(level.values) < 1.5 * level.step_m
        signed = np.where(close, level.values, np.sign(level.values) * away)
        return ScalarGrid(level.origin, level.step_m, signed.astype(np.float32))

    def signed_distance(self, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from the volume, negative inside. Raises InputError."""
        level, p_N = self.level, _points(p_N)
        q = (p_N - level.origin) / level.step_m
        outside = ((q < 0.0) | (q > np.array(level.values.shape) - 1.0)).any(axis=1)
        out = self.distance.at(p_N)
        if outside.any():
            out[outside] = cKDTree(self.mesh.vertices).query(p_N[outside])[0]
        return out


@dataclass(frozen=True)
class InstantKeepOut:
    """The volume at each instant, for a planner with a clock; the confidence is that of all instants."""

    body: MeasuredBody
    motion: BodyMotion
    covariance: Array
    """(T, 6, 6) of the pose, shift and turn along G"""
    factor: float
    added_m: float

    def signed_distance(self, k: int, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from the volume at the motion's instant k, negative inside.

        Raises InputError for points of another shape, or an instant that there is not.
        """
        if not 0 <= k < len(self.motion.p_NG):
            raise InputError(
                f"instant {k}: give 0 to {len(self.motion.p_NG) - 1}, an index into motion.time_s"
            )
        p_G = (_points(p_N) - self.motion.p_NG[k]) @ self.motion.R_NG[k]
        away, nearest = self._tree.query(p_G)
        out, found, grid = np.empty(len(p_G)), np.empty(4), self.body.grid
        for n, g in enumerate(p_G):
            if away[n] > BEYOND_CELLS * grid.step_m:
                # far from the surface: the sign is that of the grid, the distance that to the nearest point
                q = self.body.points_G[nearest[n]]
                found[0] = away[n] * np.sign(grid.at(g[None])[0])
                found[1:] = (g - q) / found[0]
            else:
                linear(grid.values, grid.origin, grid.step_m, g[0], g[1], g[2], found)
            out[n] = found[0] - self.factor * sigma_along(self.covariance[k], g[0], g[1], g[2], found)
        return out - self.added_m

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.body.points_G)

    def margin_m(self) -> Array:
        """(T,) the largest growth of the body for its pose."""
        lever_m = np.linalg.norm(self.body.points_G, axis=1).max()
        biggest = np.empty(len(self.covariance))
        for k, P in enumerate(self.covariance):
            # the largest eigenvalue of each point's covariance, bounded by parts
            shift, turn = np.linalg.eigvalsh(P[:3, :3])[-1], np.linalg.eigvalsh(P[3:, 3:])[-1]
            biggest[k] = np.sqrt(shift) + np.sqrt(turn) * lever_m
        return np.asarray(self.factor * biggest + self.added_m)


@dataclass(frozen=True, repr=False)
class KeepOut:
    """Both volumes and the body that they were made of."""

    body: MeasuredBody
    swept: SweptKeepOut
    instant: InstantKeepOut

    def united_with(self, others: list["KeepOut"]) -> "KeepOut":
        """The same, swept over the motions of all of them; at an instant it stays that of this motion."""
        if not others:
            return self
        levels = [self.swept.level, *(each.swept.level for each in others)]
        return replace(self, swept=replace(self.swept, level=union_of(levels)))

    def __repr__(self) -> str:
        horizon_s = self.instant.motion.time_s[-1]
        return f"KeepOut({self.swept.volume_m3:.4g} m^3 swept over {horizon_s:g} s)"


def union_of(levels: list[ScalarGrid]) -> ScalarGrid:
    """The level of the union of volumes, on a grid that contains all of them, with their coarsest step.

    Half a step is added to them, which is more than interpolation on the new grid takes away.
    """
    step = max(each.step_m for each in levels)
    low = np.min([each.origin for each in levels], axis=0)
    high = np.max([each.origin + each.step_m * (np.array(each.values.shape) - 1) for each in levels], axis=0)
    shape = tuple(np.ceil((high - low) / step).astype(int) + 1)
    corners = ScalarGrid(low, step, np.zeros(shape, dtype=np.float32)).corners()
    nearest = np.min([each.at(corners) for each in levels], axis=0)
    return ScalarGrid(
        low, step, np.minimum(nearest - 0.5 * step, 8.0 * step).astype(np.float32).reshape(shape)
    )


def _points(p_N: Array) -> Array:
    """(n, 3) in N. Raises InputError for another shape."""
    points = np.asarray(p_N, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points of shape {points.shape}: give coordinates (n, 3) in N [m]")
    return points


def keep_out(surface: SurfaceModel, estimate: FinalEstimate, options: KeepOutOptions) -> KeepOut:
    """Both volumes. Raises ValueError without a surface, or with too few members for the confidence."""
    if options.members < options.members_needed:
        raise ValueError(f"a confidence of {options.confidence:g} needs {options.members_needed} members")
    half = options.members // 2
    body = grown_body(surface, (1.0 - options.confidence) * SURFACE_SHARE, cover=options.cover)
    times = member_times(estimate, options.horizon_s)
    members = draw_ensemble(estimate, times, options.members, options.seed)
    motion = nominal_motion(estimate, times)
    halves = members.part(slice(0, half)), members.part(slice(half, None))
    covariance = pose_covariance(halves[0], motion)
    instant = _instant(body, motion, covariance, halves, options)
    swept = _swept(body, estimate, motion, covariance, halves, options)
    return KeepOut(body, swept, instant)


def member_times(estimate: FinalEstimate, horizon_s: float) -> Array:
    """Instants (T,) > 0, the last at the horizon [s]."""
    rate = float(np.linalg.norm(estimate.last.w_G))
    steps = int(np.clip(np.ceil(horizon_s * rate / MEMBER_ROTATION_RAD), 100, MAX_MEMBER_STEPS))
    return np.asarray(np.linspace(horizon_s / steps, horizon_s, steps))


def conformal(scores: Array, miss: float) -> Array:
    """Bound (C,) that a further row of scores (n, C) exceeds with at most the probability ``miss``."""
    rank = int(np.ceil((len(scores) + 1) * (1.0 - miss)))
    return np.asarray(np.sort(scores, axis=0)[rank - 1])


def _instant(
    body: MeasuredBody,
    motion: BodyMotion,
    P: Array,
    halves: tuple[Ensemble, Ensemble],
    options: KeepOutOptions,
) -> InstantKeepOut:
    chosen = np.unique(np.linspace(0, len(motion.time_s) - 1, MAX_INSTANTS).round().astype(int))
    grid = body.grid
    points = thinned_vertices(trimesh.Trimesh(body.points_G), INSTANT_POINTS_CELLS * grid.step_m)

    def bound(part: Ensemble, factors: Array) -> Array:
        R, p = np.ascontiguousarray(part.R_NG[:, chosen]), np.ascontiguousarray(part.p_NG[:, chosen])
        scores = protrusion_at_instants(
            factors, R, p, motion.R_NG[chosen], motion.p_NG[chosen], P[chosen],
            grid.values, grid.origin, grid.step_m, points,
        )  # fmt: skip
        return conformal(scores, options.pose_miss)

    first = bound(halves[0], FACTORS)
    lever = np.sqrt(np.mean(np.sum(points**2, axis=1)) / 3.0)
    typical = np.sqrt((np.trace(P[:, :3, :3], axis1=1, axis2=2) / 3.0).mean()) + lever * np.sqrt(
        (np.trace(P[:, 3:, 3:], axis1=1, axis2=2) / 3.0).mean()
    )
    best = int(np.argmin(first + FACTORS * typical))
    added = max(float(bound(halves[1], FACTORS[best : best + 1])[0]), 0.0)
    return InstantKeepOut(body, motion, P, float(FACTORS[best]), added)


def _swept(
    body: MeasuredBody,
    estimate: FinalEstimate,
    motion: BodyMotion,
    P: Array,
    halves: tuple[Ensemble, Ensemble],
    options: KeepOutOptions,
) -> SweptKeepOut:
    centres = np.concatenate([half.p_NG + half.R_NG @ body.centre_G for half in halves])
    radius, grid = body.radius_m, body.grid
    low, high = centres.min(axis=(0, 1)) - radius, centres.max(axis=(0, 1)) + radius
    step = float((high - low).max()) / options.cells
    low, high = low - 4.0 * step, high + 4.0 * step
    shape = tuple(np.ceil((high - low) / step).astype(int) + 1)
    spread_m = np.sqrt(np.trace(P[:, :3, :3], axis1=1, axis2=2)) + radius * np.sqrt(
        np.trace(P[:, 3:, 3:], axis1=1, axis2=2)
    )
    fine = fine_times(motion, radius, step, options.horizon_s)
    at = np.clip(np.searchsorted(motion.time_s, fine), 0, len(motion.time_s) - 1)
    states = nominal_motion(estimate, fine)
    fields = np.full((*shape, len(FACTORS)), FAR, dtype=np.float32)
    sweep(
        fields, low, step, FACTORS, states.R_NG, states.p_NG, P[at], FACTORS[-1] * spread_m[at],
        grid.values, grid.origin, grid.step_m, body.centre_G, radius,
    )  # fmt: skip
    pairs = points_near_surface(fields[..., 0], low, step, motion, body.points_G, BAND_SIGMAS * spread_m)

    def bound(fields: Floats, half: Ensemble) -> Array:
        beyond = protrusion(fields, low, step, half.R_NG, half.p_NG, pairs, body.points_G)
        return np.maximum(conformal(beyond, options.pose_miss), -step)

    allowed = bound(fields, halves[0])
    best = int(np.argmin([int((fields[..., c] <= allowed[c]).sum()) for c in range(len(FACTORS))]))
    added = float(bound(np.ascontiguousarray(fields[..., best : best + 1]), halves[1])[0])
    level = fields[..., best] - np.float32(added)
    level = np.where(cavities(level), -np.float32(step), level)
    # bounded values: finite slopes at the surface between far cells and near ones
    return SweptKeepOut(
        ScalarGrid(low, step, np.minimum(level, np.float32(8.0 * step))), float(FACTORS[best]), added
    )


def fine_times(motion: BodyMotion, radius: float, step: float, horizon_s: float) -> Array:
    """Instants (T,) from 0, between which no point moves by more than about a cell."""
    fastest = np.linalg.norm(motion.v_N, axis=1) + radius * np.linalg.norm(motion.w_N, axis=1)
    steps = int(np.clip(np.ceil(horizon_s * fastest.max() / (0.75 * step)), 50, MAX_STEPS))
    return np.asarray(np.linspace(0.0, horizon_s, steps + 1))


def points_near_surface(
    field: Floats, origin: Array, step: float, motion: BodyMotion, points: Array, band_m: Array
) -> NDArray[np.int64]:
    """Pairs (k, 2) of instant and point within the band of the swept surface.

    Of each cell and part of the horizon the one that protrudes most.
    """
    grid, shape = np.ascontiguousarray(field), np.array(field.shape)
    values, keys, pairs = [], [], []
    for k, (R, p) in enumerate(zip(motion.R_NG, motion.p_NG, strict=True)):
        p_N = points @ R.T + p
        value = values_at(grid, origin, step, p_N)
        near = np.flatnonzero(value > -band_m[k] - step)
        cell = np.clip(((p_N[near] - origin) / step).astype(np.int64), 0, shape - 1)
        key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        keys.append(key * PARTS_OF_HORIZON + k * PARTS_OF_HORIZON // len(band_m))
        values.append(value[near])
        pairs.append(np.stack([np.full(len(near), k), near], axis=1))
    value, key, pair = np.concatenate(values), np.concatenate(keys), np.concatenate(pairs)
    order = np.lexsort((-value, key))
    _, first = np.unique(key[order], return_index=True)
    return np.asarray(pair[order[first]])
