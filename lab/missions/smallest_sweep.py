"""The smallest space that a keep-out volume could be: what the true body sweeps under a run's own covariance.

The true body is fixed in the run's G at the last pair. Members are drawn from the covariance of the run;
those that leave the estimated motion farthest are dropped, as many as the confidence allows. What the outer
surface of the body sweeps by all others, with all that it encloses, is counted in cells. Further draws leave
this union more often than the confidence allows, so it is grown by what keeps the stated share of them
inside, no more. Nothing is added for the surface, which a run does not know exactly, nor for the few draws by
which it knows the tail.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_fill_holes, distance_transform_edt

from polhode.geometry.lie import Array, Bools
from polhode.geometry.rays import RayScene
from polhode.mapping.visibility import directions
from polhode.planning.keep_out.distance_fields import outermost_pairs, protrusion
from polhode.planning.keep_out.measured_body import thinned_vertices
from polhode.planning.keep_out.volumes import fine_times
from polhode.planning.prediction import (
    BodyMotion,
    Ensemble,
    FinalEstimate,
    draw_ensemble,
    nominal_motion,
)
from polhode.records.mesh_metrics import sample_surface
from polhode.runtime.compiled import compiled_ieee

DRAWS, POSES = (400, 1600), 1_600_000
"""Members of the union, at least and at most, and their poses, if more are not needed for the least"""
FURTHER, SEED = 1000, 1000
"""Members that must stay inside; planning draws its own by other seeds"""
INSTANTS, PARTS = 200, 6
"""At which further members are looked at, and of the horizon, for each of which a cell keeps a point"""
SIDE_CELLS = 400
"""Cells along a side of the grid, at most"""
COARSE, FINE = 0.7, 0.35
"""Distance of the body's points in cells: for the members, and for the estimated motion, which must close"""
SAMPLES_EACH, LEAST_SAMPLES, MOST_SAMPLES = 6.0, 2_000, 600_000
"""Of the surface for each point that is kept of it"""
DIRECTIONS = 200
"""In which a point of the surface may be reached from outside"""
OFF_SURFACE = 1e-4
"""Where rays from a point of the surface start, over the body's size"""
BESIDE_CELLS = 2.0
"""By so much a place must be inside the estimated sweep beyond its deviation to count as covered"""
Cells = NDArray[np.bool_]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Smallest:
    """Sizes [m^3] of what the true body sweeps."""

    union_m3: float
    """of the members' union"""
    leaving: float
    """share of further members that leave it by more than a cell"""
    volume_m3: float
    """of that union, grown until they do not"""


def smallest_sweep(
    outer_G: Array, estimates: Sequence[FinalEstimate], horizon_s: float, confidence: float, step_m: float
) -> Smallest:
    """What points (n, 3) of a closed surface, in the run's G, sweep with all they enclose.

    By all hypotheses of the rotation. outer_G: about FINE ``step_m`` apart; cells are larger where a grid
    would have more than SIDE_CELLS along a side.
    """
    moving = [_Members.drawn(outer_G, each, horizon_s, confidence, step_m) for each in estimates]
    low = np.min([each.low for each in moving], axis=0)
    high = np.max([each.high for each in moving], axis=0)
    step_m = max(step_m, float((high - low).max()) / (SIDE_CELLS - 4))
    origin = low - 2.0 * step_m
    shape = tuple(np.ceil((high - low) / step_m).astype(int) + 4)
    cells = np.zeros(shape, dtype=np.bool_)
    for each in moving:
        cells |= each.swept(origin, step_m, shape)
    whole = _filled(cells)
    times = np.linspace(horizon_s / INSTANTS, horizon_s, INSTANTS)
    few = thinned_vertices(trimesh.Trimesh(outer_G, process=False), step_m)
    distance = _signed_distance(whole, step_m).astype(np.float32)
    beyond_m = [
        _beyond_m(distance, origin, step_m, nominal_motion(each, times), few,
                  draw_ensemble(each, times, FURTHER, SEED + 1))
        for each in estimates
    ]  # fmt: skip
    grown_m = max(np.sort(each)[int(np.ceil(confidence * (FURTHER + 1))) - 1] for each in beyond_m)
    border = max(int(np.ceil(grown_m / step_m)), 0) + 1
    leaving = float(max((each > step_m).mean() for each in beyond_m))
    return Smallest(_size_m3(whole, step_m), leaving, _size_m3(np.pad(whole, border), step_m, grown_m))


def _signed_distance(cells: Cells, step_m: float) -> Array:
    """Of the centres of cells from the surface, which lies within the outermost ones, negative inside [m]."""
    deep = np.maximum(distance_transform_edt(cells) - 1.0, 0.0)
    return np.asarray(step_m * (distance_transform_edt(~cells) - deep))


def _size_m3(cells: Cells, step_m: float, grown_m: float = 0.0) -> float:
    """Half of a cell counts in which the surface is, as much of it lies within as beyond."""
    beyond = (_signed_distance(cells, step_m) - grown_m) / step_m
    return float(np.clip(0.5 - beyond, 0.0, 1.0).sum() * step_m**3)


def _beyond_m(
    distance: Floats, origin: Array, step_m: float, motion: BodyMotion, points_G: Array, further: Ensemble
) -> Array:
    """How far members (n,) come out of a volume that is given by its distance."""
    R, p = np.ascontiguousarray(motion.R_NG), np.ascontiguousarray(motion.p_NG)
    band_m = np.full(len(p), np.inf)
    corner = origin + 0.5 * step_m
    pairs = outermost_pairs(distance, corner, step_m, R, p, points_G, band_m, PARTS)
    found = protrusion(distance[..., None], corner, step_m, further.R_NG, further.p_NG, pairs, points_G)
    return np.asarray(found[:, 0])


def outer_surface(mesh: trimesh.Trimesh, spacing_m: float) -> Array:
    """Points (n, 3) of a mesh that are reached from outside, about ``spacing_m`` apart."""
    count = int(np.clip(SAMPLES_EACH * mesh.area / spacing_m**2, LEAST_SAMPLES, MOST_SAMPLES))
    points, _ = sample_surface(mesh, count)
    few = thinned_vertices(trimesh.Trimesh(points, process=False), spacing_m)
    return few[is_outer(mesh, few)]


def is_outer(mesh: trimesh.Trimesh, p_G: Array) -> Bools:
    """(n,) whether a straight line leads away from points (n, 3) of the surface: not within other parts."""
    middle, off_m = mesh.bounds.mean(axis=0), OFF_SURFACE * mesh.scale
    scene = RayScene(np.asarray(mesh.vertices) - middle, np.asarray(mesh.faces))
    found = np.zeros(len(p_G), dtype=np.bool_)
    for direction in directions(DIRECTIONS):
        open_ = np.flatnonzero(~found)
        start = p_G[open_] - middle + off_m * direction
        found[open_] = ~scene.blocked(start, np.broadcast_to(direction, start.shape))
    return found


@dataclass(frozen=True)
class _Members:
    """The body's points and the motions of one hypothesis that count."""

    points_G: Array
    nominal: Ensemble
    """The estimate alone"""
    members: Ensemble
    deviation_m: Array
    """(n, T) the farthest that any part of the body is from its estimated place"""

    @classmethod
    def drawn(
        cls, points_G: Array, estimate: FinalEstimate, horizon_s: float, confidence: float, step_m: float
    ) -> "_Members":
        """The members that remain at a confidence, at instants a cell of motion apart."""
        coarse = nominal_motion(estimate, np.linspace(horizon_s / 400, horizon_s, 400))
        radius_m = float(np.linalg.norm(points_G - estimate.com_G, axis=1).max())
        times = fine_times(coarse, radius_m, np.full(len(coarse.time_s), step_m), horizon_s)[1:]
        motion = nominal_motion(estimate, times)
        draws = int(np.clip(POSES // len(times), *DRAWS))
        members = draw_ensemble(estimate, times, draws, SEED)
        corners = trimesh.bounds.corners(np.array([points_G.min(axis=0), points_G.max(axis=0)]))
        at = motion.R_NG @ corners.T + motion.p_NG[..., None]
        # no point of the box is farther from its place than the farthest corner
        away = np.stack([
            np.linalg.norm(R @ corners.T + p[..., None] - at, axis=1)
            for R, p in zip(members.R_NG, members.p_NG, strict=True)
        ])  # fmt: skip
        usual = np.maximum(np.sqrt(np.mean(away**2, axis=0)), 1e-12)
        rank = np.argsort((away / usual).max(axis=(1, 2)))
        kept = np.sort(rank[: round(confidence * draws)])
        chosen = Ensemble(members.R_NG[kept], members.p_NG[kept])
        return cls(points_G, Ensemble(motion.R_NG[None], motion.p_NG[None]), chosen, away[kept].max(axis=2))

    @cached_property
    def low(self) -> Array:
        """(3,) least coordinates that any of them may have"""
        return np.asarray(self._centres.min(axis=(0, 1)) - self._radius_m)

    @cached_property
    def high(self) -> Array:
        """(3,) and the largest"""
        return np.asarray(self._centres.max(axis=(0, 1)) + self._radius_m)

    @property
    def _middle_G(self) -> Array:
        return np.asarray(0.5 * (self.points_G.min(axis=0) + self.points_G.max(axis=0)))

    @property
    def _radius_m(self) -> float:
        return float(np.linalg.norm(self.points_G - self._middle_G, axis=1).max())

    @property
    def _centres(self) -> Array:
        both = (self.members, self.nominal)
        return np.concatenate([each.p_NG + each.R_NG @ self._middle_G for each in both])

    def swept(self, origin: Array, step_m: float, shape: tuple[int, ...]) -> Cells:
        """The cells that their surfaces touch, with those that the estimated motion encloses."""
        cells = np.zeros(shape, dtype=np.bool_)
        depth = np.zeros(shape, dtype=np.float32)
        at_rest, always = np.zeros((1, len(self.nominal.p_NG[0]))), np.float32(-1.0)
        R, p = self.nominal.R_NG, self.nominal.p_NG
        _touch(cells, depth + always, origin, step_m, R[0], p[0], R, p, at_rest, self.points_G)
        cells = _filled(cells)
        # what is deeper within the estimated sweep than a member deviates adds nothing
        depth = (distance_transform_edt(cells) - BESIDE_CELLS).astype(np.float32) * np.float32(step_m)
        few = thinned_vertices(trimesh.Trimesh(self.points_G, process=False), COARSE * step_m)
        R_all, p_all = self.members.R_NG, self.members.p_NG
        _touch(cells, depth, origin, step_m, R[0], p[0], R_all, p_all, self.deviation_m, few)
        return cells


def _filled(cells: Cells) -> Cells:
    """With their cavities, which a gap of a cell does not open."""
    closed = binary_closing(cells)
    return np.asarray(cells | (binary_fill_holes(closed) & ~closed))


@compiled_ieee
def _touch(
    cells: Cells,
    depth: NDArray[np.float32],
    origin: Array,
    step: float,
    R_nominal: Array,
    p_nominal: Array,
    R: Array,
    p: Array,
    deviation: Array,
    points: Array,
) -> None:
    """Set the cells that points (m, 3) come to by the motions R (n, T, 3, 3), p (n, T, 3), where the
    deviation (n, T) exceeds the depth of their nominal place.
    """
    most = np.empty(R.shape[1])
    for t in range(R.shape[1]):
        most[t] = np.max(deviation[:, t])
    for t in range(R.shape[1]):
        A = R_nominal[t]
        for m in range(len(points)):
            x, y, z = points[m]
            i = int((A[0, 0] * x + A[0, 1] * y + A[0, 2] * z + p_nominal[t, 0] - origin[0]) / step)
            j = int((A[1, 0] * x + A[1, 1] * y + A[1, 2] * z + p_nominal[t, 1] - origin[1]) / step)
            k = int((A[2, 0] * x + A[2, 1] * y + A[2, 2] * z + p_nominal[t, 2] - origin[2]) / step)
            inside = depth[i, j, k]
            if inside >= most[t]:
                continue
            for n in range(len(R)):
                if inside >= deviation[n, t]:
                    continue
                B = R[n, t]
                i = int((B[0, 0] * x + B[0, 1] * y + B[0, 2] * z + p[n, t, 0] - origin[0]) / step)
                j = int((B[1, 0] * x + B[1, 1] * y + B[1, 2] * z + p[n, t, 1] - origin[1]) / step)
                k = int((B[2, 0] * x + B[2, 1] * y + B[2, 2] * z + p[n, t, 2] - origin[2]) / step)
                cells[i, j, k] = True
