"""Where nothing may be: the space that the target sweeps over a horizon, at a confidence.

Three steps. The measured surface is grown until it holds the true one (``measured_body``). What the
estimate's motion sweeps is grown by c sigma of the pose, instant by instant. Then members drawn from the
covariance tell how much more is needed: by so much that all but the wanted share of them stay inside with
their whole sweep (split conformal prediction: Vovk, Gammerman, Shafer 2005; Lei et al., J. Am. Stat. Assoc.
113, 2018). What the grid and the linear sigma get wrong is thereby made up for. One half of the members
chooses c, the one of the least volume; the other half, which had no say in it, tells the rest.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.spatial import cKDTree

from polhode.lie import Array
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
from polhode.records import SurfaceModel

Floats = NDArray[np.float32]
FACTORS = np.array([0.0, 1.5, 2.5, 3.5])
"""Of the pose's sigma; what is still missing is added evenly."""
SURFACE_SHARE = 0.1
"""Of the allowed misses: those that the surface may have, the pose has the others."""
MAX_STEPS = 4000
MAX_MEMBER_STEPS = 1000
MAX_INSTANTS = 40
MEMBER_TURN_RAD = 0.05
"""Members are looked at this often, or at the most steps."""
BAND_SIGMAS = 3.0
PARTS_OF_HORIZON = 6
"""Errors change slowly: of the points near a place, one in each part of the horizon stands for the others."""
INSTANT_POINTS_CELLS = 4.0
BEYOND_CELLS = 2.0
"""Farther off than this the points of the surface tell the distance, not the grid."""


@dataclass(frozen=True)
class KeepOutOptions:
    """What is asked of a keep-out."""

    horizon_s: float
    confidence: float
    members: int = 800
    cells: int = 72
    """along the longest side of the swept space"""
    cover: Cover = "auto"
    seed: int = 0

    @property
    def pose_miss(self) -> float:
        """Probability that the pose may leave."""
        return (1.0 - self.confidence) * (1.0 - SURFACE_SHARE)


@dataclass(frozen=True)
class SweptKeepOut:
    """The volume over the whole horizon, in N."""

    level: ScalarGrid
    """negative inside; within two cells of the surface nearly the distance [m]"""
    factor: float
    """sigmas of the pose"""
    added_m: float
    """beyond them, for the confidence"""

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
        """Distance (n,) [m] of points (n, 3) in N from the volume, negative inside."""
        level, p_N = self.level, np.asarray(p_N, dtype=np.float64)
        q = (p_N - level.origin) / level.step_m
        outside = ((q < 0.0) | (q > np.array(level.values.shape) - 1.0)).any(axis=1)
        out = self.distance.at(p_N)
        if outside.any():
            out[outside] = cKDTree(self.mesh.vertices).query(p_N[outside])[0]
        return out


@dataclass(frozen=True)
class InstantKeepOut:
    """The volume at each instant, for a planner that knows the time. All instants at once hold with the
    confidence."""

    body: MeasuredBody
    motion: BodyMotion
    covariance: Array
    """(T, 6, 6) of the pose, shift and turn along G"""
    factor: float
    added_m: float

    def signed_distance(self, k: int, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from the volume at the motion's instant k."""
        p_G = (np.asarray(p_N) - self.motion.p_NG[k]) @ self.motion.R_NG[k]
        away, nearest = self._tree.query(p_G)
        out, found, grid = np.empty(len(p_G)), np.empty(4), self.body.grid
        for n, g in enumerate(p_G):
            if away[n] > BEYOND_CELLS * grid.step_m:
                # far off, or inside: the sign is that of the grid, the distance that to the nearest point
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
        """(T,) the most by which the body is grown for its pose."""
        lever = self.body.points_G
        biggest = np.empty(len(self.covariance))
        for k, P in enumerate(self.covariance):
            # the largest eigenvalue of each point's covariance, bounded by parts
            shift, turn = np.linalg.eigvalsh(P[:3, :3])[-1], np.linalg.eigvalsh(P[3:, 3:])[-1]
            biggest[k] = np.sqrt(shift) + np.sqrt(turn) * np.linalg.norm(lever, axis=1).max()
        return np.asarray(self.factor * biggest + self.added_m)


@dataclass(frozen=True)
class KeepOut:
    """Both, with what they were made of."""

    wanted: KeepOutOptions
    body: MeasuredBody
    swept: SweptKeepOut
    instant: InstantKeepOut


def keep_out(surface: SurfaceModel, estimate: FinalEstimate, wanted: KeepOutOptions) -> KeepOut:
    """Both volumes. Raises ValueError without a surface, or with too few members for the confidence."""
    half = wanted.members // 2
    needed = int(np.ceil(1.0 / wanted.pose_miss)) + 1
    if half < needed:
        raise ValueError(f"a confidence of {wanted.confidence:g} needs {2 * needed} members")
    body = grown_body(surface, (1.0 - wanted.confidence) * SURFACE_SHARE, cover=wanted.cover)
    times = member_times(estimate, wanted.horizon_s)
    members = draw_ensemble(estimate, times, wanted.members, wanted.seed)
    motion = nominal_motion(estimate, times)
    covariance = pose_covariance(members.part(slice(0, half)), motion)
    halves = members.part(slice(0, half)), members.part(slice(half, None))
    instant = _instant(body, motion, covariance, halves, wanted)
    swept = _swept(body, estimate, motion, covariance, members, half, wanted)
    return KeepOut(wanted, body, swept, instant)


def member_times(estimate: FinalEstimate, horizon_s: float) -> Array:
    """Instants (T,) > 0, the last at the horizon [s]."""
    rate = float(np.linalg.norm(estimate.last.w_G))
    steps = int(np.clip(np.ceil(horizon_s * rate / MEMBER_TURN_RAD), 100, MAX_MEMBER_STEPS))
    return np.asarray(np.linspace(horizon_s / steps, horizon_s, steps))


def conformal(scores: Array, miss: float) -> Array:
    """The least bound (C,) on scores (n, C) that one more exceeds with at most the probability ``miss``."""
    rank = int(np.ceil((len(scores) + 1) * (1.0 - miss)))
    return np.asarray(np.sort(scores, axis=0)[rank - 1])


def _instant(
    body: MeasuredBody,
    motion: BodyMotion,
    P: Array,
    halves: tuple[Ensemble, Ensemble],
    wanted: KeepOutOptions,
) -> InstantKeepOut:
    chosen = np.unique(np.linspace(0, len(motion.time_s) - 1, MAX_INSTANTS).round().astype(int))
    grid = body.grid
    points = thinned_vertices(trimesh.Trimesh(body.points_G), INSTANT_POINTS_CELLS * grid.step_m)

    def scores(part: Ensemble, factors: Array) -> Array:
        return protrusion_at_instants(
            factors,
            np.ascontiguousarray(part.R_NG[:, chosen]),
            np.ascontiguousarray(part.p_NG[:, chosen]),
            motion.R_NG[chosen],
            motion.p_NG[chosen],
            P[chosen],
            grid.values,
            grid.origin,
            grid.step_m,
            points,
        )

    first = conformal(scores(halves[0], FACTORS), wanted.pose_miss)
    lever = np.sqrt(np.mean(np.sum(points**2, axis=1)) / 3.0)
    typical = np.sqrt((np.trace(P[:, :3, :3], axis1=1, axis2=2) / 3.0).mean()) + lever * np.sqrt(
        (np.trace(P[:, 3:, 3:], axis1=1, axis2=2) / 3.0).mean()
    )
    best = int(np.argmin(first + FACTORS * typical))
    chosen_factor = FACTORS[best : best + 1]
    added = max(float(conformal(scores(halves[1], chosen_factor), wanted.pose_miss)[0]), 0.0)
    return InstantKeepOut(body, motion, P, float(FACTORS[best]), added)


def _swept(
    body: MeasuredBody,
    estimate: FinalEstimate,
    motion: BodyMotion,
    P: Array,
    members: Ensemble,
    half: int,
    wanted: KeepOutOptions,
) -> SweptKeepOut:
    middles = members.p_NG + members.R_NG @ body.middle_G
    radius = body.radius_m
    low, high = middles.min(axis=(0, 1)) - radius, middles.max(axis=(0, 1)) + radius
    step = float((high - low).max()) / wanted.cells
    low, high = low - 4.0 * step, high + 4.0 * step
    shape = tuple(np.ceil((high - low) / step).astype(int) + 1)
    spread_m = np.sqrt(np.trace(P[:, :3, :3], axis1=1, axis2=2)) + radius * np.sqrt(
        np.trace(P[:, 3:, 3:], axis1=1, axis2=2)
    )
    fine = fine_times(motion, radius, step, wanted.horizon_s)
    at = np.clip(np.searchsorted(motion.time_s, fine), 0, len(motion.time_s) - 1)
    states = nominal_motion(estimate, fine)
    fields = np.full((*shape, len(FACTORS)), FAR, dtype=np.float32)
    grid = body.grid
    sweep(
        fields, low, step, FACTORS, states.R_NG, states.p_NG, P[at], FACTORS[-1] * spread_m[at],
        grid.values, grid.origin, grid.step_m, body.middle_G, radius,
    )  # fmt: skip
    pairs = points_near_surface(fields[..., 0], low, step, motion, body.points_G, BAND_SIGMAS * spread_m)
    first, second = members.part(slice(0, half)), members.part(slice(half, None))
    stick = protrusion(fields, low, step, first.R_NG, first.p_NG, pairs, body.points_G)
    allowed = np.maximum(conformal(stick, wanted.pose_miss), -step)
    cells = [int((fields[..., c] <= allowed[c]).sum()) for c in range(len(FACTORS))]
    best = int(np.argmin(cells))
    one = np.ascontiguousarray(fields[..., best : best + 1])
    stick = protrusion(one, low, step, second.R_NG, second.p_NG, pairs, body.points_G)
    added = max(float(conformal(stick, wanted.pose_miss)[0]), -step)
    level = fields[..., best] - np.float32(added)
    free, _ = label(level > 0.0)
    level = np.where((free != free[0, 0, 0]) & (level > 0.0), -np.float32(step), level)
    # a far cell is not farther than the grid is wide: finite slopes for the surface between
    return SweptKeepOut(
        ScalarGrid(low, step, np.minimum(level, np.float32(8.0 * step))), float(FACTORS[best]), added
    )


def fine_times(motion: BodyMotion, radius: float, step: float, horizon_s: float) -> Array:
    """Instants (T,) from 0 so close that no point moves more than about a cell between them."""
    fastest = np.linalg.norm(motion.v_N, axis=1) + radius * np.linalg.norm(motion.w_N, axis=1)
    steps = int(np.clip(np.ceil(horizon_s * fastest.max() / (0.75 * step)), 50, MAX_STEPS))
    return np.asarray(np.linspace(0.0, horizon_s, steps + 1))


def points_near_surface(
    field: Floats, origin: Array, step: float, motion: BodyMotion, points: Array, band_m: Array
) -> NDArray[np.int64]:
    """Pairs (k, 2) of instant and point within the band of the sweep's surface: of each place and part of the
    horizon the one that sticks out most."""
    grid, shape = np.ascontiguousarray(field), np.array(field.shape)
    values, keys, pairs = [], [], []
    for k, (R, p) in enumerate(zip(motion.R_NG, motion.p_NG, strict=True)):
        places = points @ R.T + p
        value = values_at(grid, origin, step, places)
        near = np.flatnonzero(value > -band_m[k] - step)
        cell = np.clip(((places[near] - origin) / step).astype(np.int64), 0, shape - 1)
        key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        keys.append(key * PARTS_OF_HORIZON + k * PARTS_OF_HORIZON // len(band_m))
        values.append(value[near])
        pairs.append(np.stack([np.full(len(near), k), near], axis=1))
    value, key, pair = np.concatenate(values), np.concatenate(keys), np.concatenate(pairs)
    order = np.lexsort((-value, key))
    _, first = np.unique(key[order], return_index=True)
    return np.asarray(pair[order[first]])
