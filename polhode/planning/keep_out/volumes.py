"""The keep-out volume: the space that the target may sweep over a horizon, at a confidence.

Three steps. The measured surface is grown until it contains the true one (``measured_body``). The volume that
it sweeps by the estimated motion is grown by c sigma of the pose, instant by instant. Members sampled from
the covariance then give the margin to be added: with it, all but the allowed share of them stay inside with
their whole sweep (split conformal prediction: Vovk, Gammerman, Shafer 2005; Lei et al., J. Am. Stat. Assoc.
113, 2018). This also compensates errors of the grid and of the linearised sigma. One half of the members
chooses the c of the smallest volume; the other half, independent of that choice, gives the margin.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Ints
from polhode.planning.keep_out.distance_fields import (
    FAR,
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
from polhode.planning.keep_out.small_triangles import SmallTriangles
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
"""Beyond this from the surface the grid decides about the side, the triangles about the distance."""
MAX_CELLS = 20_000_000
"""Of a grid"""


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
    """negative inside, above 0 on the border; within two cells of the surface nearly the distance [m]"""
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

    def signed_distance(self, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from ``mesh``, negative inside; where the nearest triangle
        is not certain, a lower bound. Raises InputError.
        """
        p_N = _points(p_N)
        low, high = self._triangles.signed_distance(p_N)
        # far from the surface the grid knows the side as well
        least, most = np.sort(np.abs([low, high]), axis=0)
        by_grid = np.where(self.level.at(p_N) <= 0.0, -most, least)
        return np.where(least > BEYOND_CELLS * self.level.step_m, by_grid, low)

    @cached_property
    def _triangles(self) -> SmallTriangles:
        return SmallTriangles(self.mesh)


@dataclass(frozen=True)
class InstantKeepOut:
    """The volume at each instant, for a planner with a clock; the confidence is that of all instants."""

    body: MeasuredBody
    motion: BodyMotion
    covariance: Array
    """(T, 6, 6) of the pose, shift and turn along G"""
    factor: float
    added_m: float
    others: tuple["InstantKeepOut", ...] = ()
    """Of other hypotheses of the rotation, at the same instants: the volume is the union of all"""

    @cached_property
    def hypotheses(self) -> tuple["InstantKeepOut", ...]:
        """This one and the others."""
        return (replace(self, others=()), *self.others) if self.others else (self,)

    def signed_distance(self, k: int, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from the volume at the motion's instant k, negative inside.

        Raises InputError for points of another shape, or an instant that there is not.
        """
        if not 0 <= k < len(self.motion.p_NG):
            raise InputError(
                f"instant {k}: give 0 to {len(self.motion.p_NG) - 1}, an index into motion.time_s"
            )
        if self.others:
            distances = [each.signed_distance(k, p_N) for each in self.hypotheses]
            return np.asarray(np.min(distances, axis=0))
        p_G = (_points(p_N) - self.motion.p_NG[k]) @ self.motion.R_NG[k]
        out, sigma, found, grid = np.empty(len(p_G)), np.empty(len(p_G)), np.empty(4), self.body.grid
        for n, g in enumerate(p_G):
            linear(grid.values, grid.origin, grid.step_m, g[0], g[1], g[2], found)
            out[n], sigma[n] = found[0], sigma_along(self.covariance[k], g[0], g[1], g[2], found)
        # the members were held against the grid, which tells little of places far outside
        outside = np.flatnonzero(out > 0.0)
        least, most = self._triangles.signed_distance(p_G[outside])
        near = least <= BEYOND_CELLS * grid.step_m
        out[outside] = np.where(near, np.minimum(out[outside], most), least)
        out -= self.factor * sigma
        return out - self.added_m

    @cached_property
    def _triangles(self) -> SmallTriangles:
        return SmallTriangles(self.body.grid.mesh())

    def margin_m(self) -> Array:
        """(T,) the largest growth of the body for its pose, by the motion of this hypothesis."""
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
        """The same, by the motions of all of them, whose instants are the same."""
        if not others:
            return self
        levels = [self.swept.level, *(each.swept.level for each in others)]
        instant = replace(self.instant, others=tuple(each.instant for each in others))
        return replace(self, swept=replace(self.swept, level=union_of(levels)), instant=instant)

    def __repr__(self) -> str:
        horizon_s = self.instant.motion.time_s[-1]
        return f"KeepOut({self.swept.volume_m3:.4g} m^3 swept over {horizon_s:g} s)"


def union_of(levels: list[ScalarGrid]) -> ScalarGrid:
    """The level of the union of volumes, on a grid that contains all of them, with their coarsest step.

    Half a step is added to them, which is more than interpolation on the new grid takes away.
    """
    step = max(each.step_m for each in levels)
    low = np.min([each.origin for each in levels], axis=0) - 2.0 * step
    high = np.max([each.origin + each.step_m * (np.array(each.values.shape) - 1) for each in levels], axis=0)
    high += 2.0 * step
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
    """Both volumes. Raises ValueError without a surface, or with too few members for the confidence,
    InputError where the motion is too uncertain.
    """
    return keep_out_of_all(surface, (estimate,), options)


def keep_out_of_all(
    surface: SurfaceModel, estimates: Sequence[FinalEstimate], options: KeepOutOptions
) -> KeepOut:
    """Both volumes, of all hypotheses of the rotation; errors as ``keep_out``."""
    if options.members < options.members_needed:
        raise ValueError(f"a confidence of {options.confidence:g} needs {options.members_needed} members")
    body = grown_body(surface, (1.0 - options.confidence) * SURFACE_SHARE, cover=options.cover)
    times = member_times(estimates, options.horizon_s)
    first, *others = (_keep_out(body, estimate, times, options) for estimate in estimates)
    return first.united_with(others)


def _keep_out(body: MeasuredBody, estimate: FinalEstimate, times: Array, options: KeepOutOptions) -> KeepOut:
    half = options.members // 2
    members = draw_ensemble(estimate, times, options.members, options.seed)
    motion = nominal_motion(estimate, times)
    halves = members.part(slice(0, half)), members.part(slice(half, None))
    covariance = pose_covariance(halves[0], motion)
    instant = _instant(body, motion, covariance, halves, options)
    swept = _swept(body, estimate, motion, covariance, halves, options)
    return KeepOut(body, swept, instant)


def member_times(estimates: Sequence[FinalEstimate], horizon_s: float) -> Array:
    """Instants (T,) > 0, the last at the horizon [s]."""
    rate = max(float(np.linalg.norm(each.last.w_G)) for each in estimates)
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
    radius, grid = body.radius_m, body.grid
    spread_m = np.sqrt(np.trace(P[:, :3, :3], axis1=1, axis2=2)) + radius * np.sqrt(
        np.trace(P[:, 3:, 3:], axis1=1, axis2=2)
    )
    # of all members, and as far from the estimate as the largest factor grows it
    centres = np.concatenate([half.p_NG + half.R_NG @ body.centre_G for half in halves])
    middle = (motion.p_NG + motion.R_NG @ body.centre_G)[:, None]
    far = (FACTORS[-1] * spread_m + radius)[:, None, None]
    low = np.minimum(centres.min(axis=(0, 1)) - radius, (middle - far).min(axis=(0, 1)))
    high = np.maximum(centres.max(axis=(0, 1)) + radius, (middle + far).max(axis=(0, 1)))
    step = float((high - low).max()) / options.cells
    fine = fine_times(motion, radius, step, options.horizon_s)
    at = np.clip(np.searchsorted(motion.time_s, fine), 0, len(motion.time_s) - 1)
    states, more_m = nominal_motion(estimate, fine), 4.0 * step
    while True:
        origin = low - more_m
        shape = tuple(np.ceil((high - low + 2.0 * more_m) / step).astype(int) + 1)
        if np.prod(shape) > MAX_CELLS:
            raise InputError(f"--horizon {options.horizon_s:g}: too uncertain for a volume; look less far")
        fields = np.full((*shape, len(FACTORS)), FAR, dtype=np.float32)
        sweep(
            fields, origin, step, FACTORS, states.R_NG, states.p_NG, P[at],
            FACTORS[-1] * spread_m[at] + more_m, grid.values, grid.origin, grid.step_m, body.centre_G, radius,
        )  # fmt: skip
        band_m = BAND_SIGMAS * spread_m
        pairs = points_near_surface(fields[..., 0], origin, step, motion, body.points_G, band_m)

        def bound(fields: Floats, half: Ensemble, origin: Array = origin, pairs: Ints = pairs) -> Array:
            beyond = protrusion(fields, origin, step, half.R_NG, half.p_NG, pairs, body.points_G)
            return np.maximum(conformal(beyond, options.pose_miss), -step)

        allowed = bound(fields, halves[0])
        best = int(np.argmin([int((fields[..., c] <= allowed[c]).sum()) for c in range(len(FACTORS))]))
        added = float(bound(np.ascontiguousarray(fields[..., best : best + 1]), halves[1])[0])
        level = fields[..., best] - np.float32(added)
        if added <= more_m and not reaches_border(level):
            level = np.where(cavities(level), -np.float32(step), level)
            # bounded values: finite slopes at the surface between far cells and near ones
            whole = ScalarGrid(origin, step, np.minimum(level, np.float32(8.0 * step)))
            return SweptKeepOut(whole, float(FACTORS[best]), added)
        more_m = float(np.clip(1.1 * added, 2.0 * more_m, 4.0 * more_m))


def reaches_border(level: Floats) -> bool:
    """Whether the volume, where the level is not above 0, goes on beyond its grid."""
    ends = (level[0], level[-1], level[:, 0], level[:, -1], level[:, :, 0], level[:, :, -1])
    return any(bool((end <= 0.0).any()) for end in ends)


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
