"""The keep-out volume: the space that the target may sweep over a horizon, at a confidence.

Three steps. The body is grown until it contains the true one (``measured_body``). The volume that it sweeps
by the estimated motion is grown by c sigma of the pose, instant by instant. Members sampled from the
covariance then give the margin to be added: with it, all but the allowed share of them stay inside with
their whole sweep (``score_tail``). This also compensates errors of the grid and of the linearised sigma. Some
of the members choose the c of the smallest volume, on a coarse grid; the others, independent of that choice,
give the margin.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, hat
from polhode.planning.keep_out.distance_fields import (
    DEEP_CELLS,
    outermost_pairs,
    protrusion,
    protrusion_at_instants,
    sweep,
)
from polhode.planning.keep_out.measured_body import (
    Cover,
    MeasuredBody,
    ScalarGrid,
    cavities,
    grown_body,
    thinned_vertices,
)
from polhode.planning.keep_out.queries import InstantKeepOut, KeepOut, SweptKeepOut
from polhode.planning.keep_out.score_tail import ScoreTail
from polhode.planning.prediction import (
    BodyMotion,
    Ensemble,
    FinalEstimate,
    draw_ensemble,
    nominal_motion,
    pose_covariance,
)
from polhode.records.occupancy import Occupancy
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Advance, Progress, Silent

Floats = NDArray[np.float32]
FACTORS = np.array([1.5, 2.0, 3.0, 5.0, 9.0])
"""Candidates of c; the remaining margin is added uniformly."""
TAKEN_BACK_CELLS = DEEP_CELLS - 1.0
"""By which what c sigma grow may be taken back, where motions stay within less"""
COARSE_SIGMAS = 5.0
"""Of the centre of mass, as far as the grid reaches on which c is chosen, and as far as its members do"""
SURFACE_SHARE = 0.1
"""Of the allowed probability of a miss: the surface's; the pose has the rest."""
LEAST_STEPS, MAX_STEPS = 50, 4000
SHARE_OF_GROWTH = 0.3
MAX_MEMBER_STEPS = 1000
MAX_INSTANTS = 40
MEMBER_ROTATION_RAD = 0.05
"""Between two instants of the members, unless that takes too many steps."""
BAND_SIGMAS = 3.0
PARTS_OF_HORIZON = 6
"""Errors change slowly: of the points in a cell, one represents the others in each part of the horizon."""
BORDER_CELLS = 4.0
FAR_CELLS = 2.0
"""Beyond what may be added, as far as distances are known: what is farther costs as much and tells nothing"""
COARSE = 2.0
"""Edge of the cells on which c is chosen, over that of the others"""
MAX_CELLS = 20_000_000
"""Of a grid"""
MEMBERS, CHOOSING = 600, 200
"""Motions that are drawn up to 99 %, and those of them by which c is chosen"""
LEAST_MEMBERS, MOST_MEMBERS = 60, 2000
STEPS = 4
"""Of progress, for each hypothesis"""


@dataclass(frozen=True)
class KeepOutOptions:
    """Options of a keep-out volume."""

    horizon_s: float
    confidence: float
    members: int | None = None
    """None: as many as the confidence is worth"""
    cells: int = 36
    """along the longest side of the swept space"""
    cover: Cover = "auto"
    seed: int = 0

    @property
    def pose_miss(self) -> float:
        """Allowed probability that the pose leaves the volume."""
        return (1.0 - self.confidence) * (1.0 - SURFACE_SHARE)

    @property
    def drawn(self) -> int:
        """Number of motions: more where the tail beyond the draws is longer."""
        if self.members is not None:
            return self.members
        decades = max(0.0, -2.0 - float(np.log10(1.0 - self.confidence)))
        return round(min(MEMBERS * (1.0 + 0.75 * decades), MOST_MEMBERS))


def keep_out(
    surface: SurfaceModel,
    estimate: FinalEstimate,
    options: KeepOutOptions,
    occupied: Occupancy | None = None,
) -> KeepOut:
    """Both volumes. Raises ValueError without a surface, InputError where the motion is too uncertain."""
    return keep_out_of_all(surface, (estimate,), options, occupied)


def keep_out_of_all(
    surface: SurfaceModel,
    estimates: Sequence[FinalEstimate],
    options: KeepOutOptions,
    occupied: Occupancy | None = None,
    progress: Progress | None = None,
) -> KeepOut:
    """Both volumes, of all hypotheses of the rotation; errors as ``keep_out``.

    occupied: None for a run without it.
    """
    with (progress or Silent()).stage("keep-out volume", STEPS * len(estimates) + 1) as advance:
        body = grown_body(
            surface, (1.0 - options.confidence) * SURFACE_SHARE, cover=options.cover, occupied=occupied
        )
        advance()
        times = member_times(estimates, options.horizon_s)
        first, *others = (_keep_out(body, each, times, options, advance) for each in estimates)
    return first.united_with(others)


def _keep_out(
    body: MeasuredBody, estimate: FinalEstimate, times: Array, options: KeepOutOptions, advance: Advance
) -> KeepOut:
    members = draw_ensemble(estimate, times, options.drawn, options.seed)
    advance()
    choosing = min(CHOOSING, options.drawn // 2)
    motion = nominal_motion(estimate, times)
    halves = members.part(slice(0, choosing)), members.part(slice(choosing, None))
    covariance = pose_covariance(halves[0], motion, estimate.com_G)
    instant = _instant(body, motion, covariance, halves, options)
    advance()
    swept = _swept(body, estimate, motion, covariance, halves, options, advance)
    return KeepOut(body, swept, instant, (estimate,), options.confidence, options.drawn)


def member_times(estimates: Sequence[FinalEstimate], horizon_s: float) -> Array:
    """Instants (T,) > 0, the last at the horizon [s]."""
    rate = max(float(np.linalg.norm(each.last.w_G)) for each in estimates)
    steps = int(np.clip(np.ceil(horizon_s * rate / MEMBER_ROTATION_RAD), 100, MAX_MEMBER_STEPS))
    return np.asarray(np.linspace(horizon_s / steps, horizon_s, steps))


def _instant(
    body: MeasuredBody,
    motion: BodyMotion,
    P: Array,
    halves: tuple[Ensemble, Ensemble],
    options: KeepOutOptions,
) -> InstantKeepOut:
    chosen = np.unique(np.linspace(0, len(motion.time_s) - 1, MAX_INSTANTS).round().astype(int))
    grid = body.grid
    points = body.sparse_points_G

    def scores(part: Ensemble, factors: Array) -> Array:
        R, p = np.ascontiguousarray(part.R_NG[:, chosen]), np.ascontiguousarray(part.p_NG[:, chosen])
        return protrusion_at_instants(
            factors, R, p, motion.R_NG[chosen], motion.p_NG[chosen], P[chosen],
            grid.values, grid.origin, grid.step_m, points,
        )  # fmt: skip

    few = halves[0].part(slice(None, None, 4))
    first = np.array([ScoreTail.of(each).bound(options.pose_miss) for each in scores(few, FACTORS).T])
    lever = np.sqrt(np.mean(np.sum(points**2, axis=1)) / 3.0)
    typical = np.sqrt((np.trace(P[:, :3, :3], axis1=1, axis2=2) / 3.0).mean()) + lever * np.sqrt(
        (np.trace(P[:, 3:, 3:], axis1=1, axis2=2) / 3.0).mean()
    )
    best = int(np.argmin(first + FACTORS * typical))
    tail = ScoreTail.of(scores(halves[1], FACTORS[best : best + 1])[:, 0])
    return InstantKeepOut(body, motion, P, float(FACTORS[best]), max(tail.bound(options.pose_miss), 0.0))


@dataclass(frozen=True)
class _Sweep:
    """The body swept on a grid of one step, and how far members leave it."""

    body: MeasuredBody
    estimate: FinalEstimate
    motion: BodyMotion
    P: Array
    low: Array
    high: Array
    """(3,) corners of what the body, its members and the largest growth reach"""
    step_m: float
    horizon_s: float

    def fields(self, more_m: float, factors: Array) -> tuple[Array, Floats]:
        """Origin (3,) of the grid, and its values (nx, ny, nz, C). Raises InputError: it is too large."""
        body, origin = self.body, self.low - more_m
        shape = tuple(np.ceil((self.high - self.low + 2.0 * more_m) / self.step_m).astype(int) + 1)
        if np.prod(shape) > MAX_CELLS:
            raise InputError(f"--horizon {self.horizon_s:g}: too uncertain for a volume; look less far")
        # what is grown by more may be swept in larger steps: the members tell what that leaves out
        allowed_m = self.step_m + SHARE_OF_GROWTH * factors[0] * self.spread_m
        fine = fine_times(self.motion, body.radius_m, allowed_m, self.horizon_s)
        at = np.clip(np.searchsorted(self.motion.time_s, fine), 0, len(self.motion.time_s) - 1)
        states, grid = nominal_motion(self.estimate, fine), body.grid
        fields = np.full((*shape, len(factors)), more_m + FAR_CELLS * self.step_m, dtype=np.float32)
        sweep(
            fields, origin, self.step_m, factors, states.R_NG, states.p_NG, self.P[at],
            grid.values, grid.origin, grid.step_m, self.estimate.com_G, _radius_m(body, self.estimate),
        )  # fmt: skip
        return origin, fields

    @cached_property
    def spread_m(self) -> Array:
        """(T,) the body's uncertainty by its pose"""
        return _spread_m(self.P, self.body.radius_m)

    @cached_property
    def points(self) -> Array:
        """(m, 3) of the body's surface, no nearer to each other than the grid can tell"""
        apart_m = 0.5 * self.step_m
        if apart_m <= self.body.grid.step_m:
            return self.body.points_G
        return thinned_vertices(trimesh.Trimesh(self.body.points_G), apart_m)

    def scores(self, origin: Array, fields: Floats, part: Ensemble) -> Array:
        """How far members (n,) leave each field (n, C)."""
        motion, band_m = self.motion, BAND_SIGMAS * self.spread_m + self.step_m
        first = np.ascontiguousarray(fields[..., 0])
        R, p = np.ascontiguousarray(motion.R_NG), np.ascontiguousarray(motion.p_NG)
        pairs = outermost_pairs(first, origin, self.step_m, R, p, self.points, band_m, PARTS_OF_HORIZON)
        return protrusion(fields, origin, self.step_m, part.R_NG, part.p_NG, pairs, self.points)


def _swept(
    body: MeasuredBody,
    estimate: FinalEstimate,
    motion: BodyMotion,
    P: Array,
    halves: tuple[Ensemble, Ensemble],
    options: KeepOutOptions,
    advance: Advance,
) -> SweptKeepOut:
    sweep_of = partial(_Sweep, body, estimate, motion, P, horizon_s=options.horizon_s)
    radius_m, sigma_m = _radius_m(body, estimate), _com_sigma_m(P, estimate)
    members_N = halves[0].p_NG + halves[0].R_NG @ estimate.com_G
    far_m = COARSE_SIGMAS * sigma_m + radius_m
    low, high = _box(motion.com_N, far_m, members_N, radius_m)
    coarse = sweep_of(low, high, COARSE * float((high - low).max()) / options.cells)
    origin, fields = coarse.fields(BORDER_CELLS * coarse.step_m, FACTORS)
    scores = coarse.scores(origin, fields, halves[0])
    bounds = np.array([ScoreTail.of(each).bound(options.pose_miss) for each in scores.T])
    allowed = np.maximum(bounds, -TAKEN_BACK_CELLS * coarse.step_m)
    sizes = [
        np.inf if reaches_border(field - np.float32(most)) else (field <= most).sum()
        for field, most in zip(np.moveaxis(fields, -1, 0), allowed, strict=True)
    ]
    best = int(np.argmin(sizes))
    advance()
    most_m = max(float(allowed[best]), 0.0)
    far_m = FACTORS[best] * sigma_m + radius_m + most_m
    low, high = _box(motion.com_N, far_m, motion.com_N, radius_m)
    step = float((high - low).max()) / options.cells
    fine = sweep_of(low, high, step)
    more_m = 1.5 * max(most_m, float(scores[:, best].max())) + BORDER_CELLS * step
    factors = FACTORS[best : best + 1]
    while True:
        origin, fields = fine.fields(more_m, factors)
        beyond = fine.scores(origin, fields, halves[1])[:, 0]
        tail = ScoreTail.of(beyond)
        added = max(tail.bound(options.pose_miss), -TAKEN_BACK_CELLS * step)
        level = fields[..., 0] - np.float32(added)
        if max(added, float(beyond.max())) <= more_m and not reaches_border(level):
            level = np.where(cavities(level), -np.float32(step), level)
            # bounded values: finite slopes at the surface between far cells and near ones
            whole = ScalarGrid(origin, step, np.minimum(level, np.float32(8.0 * step)))
            advance()
            return SweptKeepOut(whole, float(factors[0]), added, tail.sigma(options.pose_miss))
        more_m = float(np.clip(1.1 * added, 2.0 * more_m, 4.0 * more_m))


def _spread_m(P: Array, radius_m: float) -> Array:
    """Uncertainty (T,) [m] of a body with this radius by the covariance of its pose (T, 6, 6)."""
    shift, turn = (np.sqrt(np.trace(part, axis1=1, axis2=2)) for part in (P[:, :3, :3], P[:, 3:, 3:]))
    return np.asarray(shift + radius_m * turn)


def _radius_m(body: MeasuredBody, estimate: FinalEstimate) -> float:
    """Of the sphere about the estimated centre of mass that contains the body."""
    return float(np.linalg.norm(body.points_G - estimate.com_G, axis=1).max())


def _com_sigma_m(P: Array, estimate: FinalEstimate) -> Array:
    """Uncertainty (T,) [m] of that centre by the covariance of the pose (T, 6, 6)."""
    J = np.concatenate([np.eye(3), -hat(estimate.com_G)], axis=1)
    return np.asarray(np.sqrt(np.trace(J @ P @ J.T, axis1=1, axis2=2)))


def _box(middle: Array, far_m: Array, others: Array, radius_m: float) -> tuple[Array, Array]:
    """Corners (3,) of what spheres about middles (T, 3), and about others (..., 3), reach."""
    low, high = middle - far_m[:, None], middle + far_m[:, None]
    rest = others.reshape(-1, 3)
    return (
        np.minimum(low.min(axis=0), rest.min(axis=0) - radius_m),
        np.maximum(high.max(axis=0), rest.max(axis=0) + radius_m),
    )


def reaches_border(level: Floats) -> bool:
    """Whether the volume, where the level is not above 0, goes on beyond its grid."""
    ends = (level[0], level[-1], level[:, 0], level[:, -1], level[:, :, 0], level[:, :, -1])
    return any(bool((end <= 0.0).any()) for end in ends)


def fine_times(motion: BodyMotion, radius: float, allowed_m: Array, horizon_s: float) -> Array:
    """Instants from 0, between which no point moves by more than about ``allowed_m`` (T,) [m], which is given
    at the motion's instants.
    """
    speed = np.linalg.norm(motion.v_N, axis=1) + radius * np.linalg.norm(motion.w_N, axis=1)
    time_s = np.concatenate([[0.0], motion.time_s])
    steps = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * speed / allowed_m)])
    count = int(np.clip(np.ceil(steps[-1]), LEAST_STEPS, MAX_STEPS))
    # a body at rest, too, has its instants
    progress = steps / max(steps[-1], 1e-12) + 1e-3 * time_s / horizon_s
    return np.asarray(np.interp(np.linspace(0.0, progress[-1], count + 1), progress, time_s))
