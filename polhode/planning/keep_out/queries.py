"""The keep-out volumes, and what a planner asks of them: inside, clearance, contact along a trajectory.

Points are in N [m], times in seconds after the last pair. Without a time a question is about the swept
volume, which holds the target at all instants of the horizon; with one, about the volume at that instant. A
clearance is never above that from the volume; its gradient is the unit vector away from it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from polhode.geometry.lie import Array, Bools, exp_so3, log_so3, transform_points
from polhode.planning.keep_out.distance_fields import (
    grown_distances,
    nearest_approach,
    nearest_with_sigma,
    reasons_of,
)
from polhode.planning.keep_out.measured_body import MeasuredBody, ScalarGrid, sample_surface
from polhode.planning.keep_out.score_tail import ScoreTail
from polhode.planning.keep_out.small_triangles import SmallTriangles
from polhode.planning.prediction import BodyMotion, FinalEstimate, draw_ensemble
from polhode.runtime.errors import InputError

BEYOND_CELLS = 2.0
"""Beyond this from the surface the grid decides about the side, the triangles about the distance."""
CHASER_POINTS = 1500
"""That stand for the surface of a body"""
CONTACT_SEED = 1_000_003
REASON_INSTANTS, INSTANT_CELLS = 200, 64


@dataclass(frozen=True)
class Clearance:
    """Of n places."""

    distance_m: Array
    """(n,) from the volume, negative inside"""
    gradient_N: Array
    """(n, 3) unit vectors away from it"""


@dataclass(frozen=True)
class Contact:
    """Of a trajectory and the target, as it is predicted."""

    first_s: float | None
    """When the probability of a contact so far exceeds what the confidence allows; None: it never does"""
    probability: float
    """Of a contact along the whole trajectory"""
    probability_by: Array
    """(n,) of a contact until each time"""


@dataclass(frozen=True)
class SweptKeepOut:
    """The volume over the whole horizon, in N."""

    level: ScalarGrid
    """negative inside, above 0 on the border; within two cells of the surface nearly the distance [m]"""
    factor: float
    """c: sigmas of the pose"""
    added_m: float
    """margin in addition, for the confidence"""
    sigma_added_m: float
    """by the number of members"""

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """Closed surface in N."""
        return self.level.mesh()

    @property
    def volume_m3(self) -> float:
        return float(abs(self.mesh.volume))

    def field(self) -> ScalarGrid:
        """Distance from the volume [m] on the grid of ``level``, never above the true one."""
        outside, step = self.level.values > 0.0, self.level.step_m
        far, deep = (distance_transform_edt(each, sampling=step) for each in (outside, ~outside))
        # the surface is less than a cell's diagonal before the first corner behind it
        values = np.where(outside, far, -deep) - np.sqrt(3.0) * step
        near = np.abs(self.level.values) < step
        values[near] = self.signed_distance(self.level.corners()[near.reshape(-1)])
        return ScalarGrid(self.level.origin, step, values.astype(np.float32))

    def signed_distance(self, p_N: Array) -> Array:
        """Distance (n,) [m] of points (n, 3) in N from ``mesh``, negative inside. Raises InputError."""
        return self.clearance(p_N).distance_m

    def clearance(self, p_N: Array) -> Clearance:
        """As ``signed_distance``, with its gradient."""
        p_N = points_in_N(p_N)
        distance, outwards = self._triangles.signed_distance(p_N)
        # far from the surface the grid knows the side as well
        is_far = np.abs(distance) > BEYOND_CELLS * self.level.step_m
        turned = is_far & ((self.level.at(p_N) <= 0.0) != (distance < 0.0))
        sign = np.where(turned, -1.0, 1.0)
        return Clearance(sign * distance, sign[:, None] * outwards)

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
        return self.clearance(p_N, self.motion.time_s[k]).distance_m

    def clearance(self, p_N: Array, time_s: ArrayLike) -> Clearance:
        """Of points (n, 3) in N at times (n,), or one time. Raises InputError: wrong shapes, or a time beyond
        the horizon.
        """
        p_N = points_in_N(p_N)
        time = self._times(time_s, len(p_N))
        found = [each._clearance(p_N, time) for each in self.hypotheses]
        nearest = np.argmin([each.distance_m for each in found], axis=0)
        rows = np.arange(len(p_N))
        return Clearance(
            np.stack([each.distance_m for each in found])[nearest, rows],
            np.stack([each.gradient_N for each in found])[nearest, rows],
        )

    def level(self, time_s: float, cells: int = INSTANT_CELLS) -> ScalarGrid:
        """The volume at a time, where the values are not above 0: a grid in N that contains it."""
        time = self._times(time_s, 1)
        poses = [each._at(time) for each in self.hypotheses]
        centres = np.stack([R[0] @ self.body.centre_G + p[0] for R, p, _ in poses])
        reach_m = np.array([float(each.margin_m().max()) + self.body.radius_m for each in self.hypotheses])
        low, high = (centres - reach_m[:, None]).min(axis=0), (centres + reach_m[:, None]).max(axis=0)
        step = float((high - low).max()) / cells
        shape = tuple(np.ceil((high - low) / step).astype(int) + 7)
        empty = ScalarGrid(low - 3.0 * step, step, np.zeros(shape, dtype=np.float32))
        values, grid, corners = np.full(shape, np.inf).reshape(-1), self.body.grid, empty.corners()
        for each, (R, p, P) in zip(self.hypotheses, poses, strict=True):
            p_G = (corners - p[0]) @ R[0]
            all_P = np.broadcast_to(P[0], (len(p_G), 6, 6))
            distance, sigma, _ = grown_distances(grid.values, grid.origin, grid.step_m, p_G, all_P)
            values = np.minimum(values, distance - each.factor * sigma - each.added_m - each._between_m)
        # more than what interpolation takes away
        values -= 0.5 * step
        return replace(empty, values=values.reshape(shape).astype(np.float32))

    def poses(self, time_s: ArrayLike) -> list[tuple[Array, Array]]:
        """Attitude (n, 3, 3) and position (n, 3) of G in N at times (n,), by each hypothesis."""
        time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        return [each._at(time)[:2] for each in self.hypotheses]

    def _times(self, time_s: ArrayLike, count: int) -> Array:
        time, last_s = np.asarray(time_s, dtype=np.float64), float(self.motion.time_s[-1])
        if time.ndim > 1 or (time.ndim == 1 and len(time) != count):
            raise InputError(f"times of shape {time.shape}: give one, or one for each of the {count} places")
        if not np.all((time >= 0.0) & (time <= last_s * (1.0 + 1e-9))):
            raise InputError(f"times must be from 0 to {last_s:g} s, the horizon")
        return np.broadcast_to(time, (count,))

    def _clearance(self, p_N: Array, time: Array) -> Clearance:
        R, p, P = self._at(time)
        p_G = np.einsum("nji,nj->ni", R, p_N - p)
        grid = self.body.grid
        distance, sigma, gradient_G = grown_distances(grid.values, grid.origin, grid.step_m, p_G, P)
        # the members were held against the grid, which tells little of places far outside
        outside = np.flatnonzero(distance > 0.0)
        exact, outwards = self._triangles.signed_distance(p_G[outside])
        near = exact <= BEYOND_CELLS * grid.step_m
        distance[outside] = np.where(near, np.minimum(distance[outside], exact), exact)
        gradient_G[outside[~near]] = outwards[~near]
        distance -= self.factor * sigma + self.added_m + self._between_m
        outside = np.flatnonzero(distance > 0.0)
        least, away = nearest_with_sigma(self.body.sparse_points_G, P[outside], p_G[outside], self.factor)
        least = np.maximum(least - self.added_m - self._between_m, 0.0)
        other = least < distance[outside]
        distance[outside[other]], gradient_G[outside[other]] = least[other], away[other]
        return Clearance(distance, np.einsum("nij,nj->ni", R, gradient_G))

    def _at(self, time: Array) -> tuple[Array, Array, Array]:
        """Attitude (n, 3, 3), position (n, 3) and covariance (n, 6, 6), linear between the instants."""
        motion = self.motion
        k = np.clip(np.searchsorted(motion.time_s, time, side="right") - 1, 0, len(motion.time_s) - 2)
        before, after = motion.time_s[k], motion.time_s[k + 1]
        share = ((time - before) / (after - before))[:, None]
        turn = log_so3(np.swapaxes(motion.R_NG[k], 1, 2) @ motion.R_NG[k + 1])
        R = motion.R_NG[k] @ exp_so3(share * turn)
        p = (1.0 - share) * motion.p_NG[k] + share * motion.p_NG[k + 1]
        # before the first instant the covariance is no smaller than there
        grown = np.clip(share, 0.0, 1.0)[..., None]
        return R, p, (1.0 - grown) * self.covariance[k] + grown * self.covariance[k + 1]

    @cached_property
    def _between_m(self) -> float:
        """How far the body is at most from its linear motion between two instants."""
        step = float(np.diff(self.motion.time_s, prepend=0.0).max())
        rate = float(np.linalg.norm(self.motion.w_N, axis=1).max())
        reach_m = float(np.linalg.norm(self.motion.com_N[0] - self.motion.p_NG[0])) + 2.0 * self.body.radius_m
        return min(0.125 * (rate * step) ** 2, 2.0) * reach_m

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
    """Both volumes and the body that they were made of; the object that a planner asks."""

    body: MeasuredBody
    swept: SweptKeepOut
    instant: InstantKeepOut
    estimates: tuple[FinalEstimate, ...]
    """The end of each hypothesis's motion, from which members are drawn"""
    confidence: float
    members: int

    @cached_property
    def swept_reasons(self) -> NDArray[np.uint8]:
        """``reasons`` (V,) of the vertices of ``swept.mesh``."""
        return self.reasons(np.asarray(self.swept.mesh.vertices, dtype=np.float64))

    def reasons(self, places_N: Array, time_s: ArrayLike | None = None) -> NDArray[np.uint8]:
        """Why places (n, 3) on the surface of the volume are there, as numbers of ``REASONS`` (n,): by the
        part of the body that is nearest, at any instant or at the time that is given.
        """
        last_s = self.instant.motion.time_s[-1]
        time = np.linspace(0.0, last_s, REASON_INSTANTS) if time_s is None else np.atleast_1d(time_s)
        grid, nearest, found = (
            self.body.grid,
            np.full(len(places_N), np.inf),
            np.zeros(len(places_N), np.uint8),
        )
        for R, p in self.instant.poses(time):
            why, distance = reasons_of(
                places_N, R, p, grid.values, grid.origin, grid.step_m, self.body.reason
            )
            found = np.where(distance < nearest, why, found)
            nearest = np.minimum(nearest, distance)
        return found

    def united_with(self, others: list["KeepOut"]) -> "KeepOut":
        """The same, by the motions of all of them, whose instants are the same."""
        if not others:
            return self
        levels = [self.swept.level, *(each.swept.level for each in others)]
        instant = replace(self.instant, others=tuple(each.instant for each in others))
        estimates = self.estimates + tuple(end for each in others for end in each.estimates)
        swept = replace(self.swept, level=union_of(levels))
        return replace(self, swept=swept, instant=instant, estimates=estimates)

    def contains(self, p_N: Array, time_s: ArrayLike | None = None) -> Bools:
        """Whether points (n, 3) in N lie in the volume, at times (n,) or one time; None: in the swept one.

        Raises InputError: wrong shapes, or a time beyond the horizon.
        """
        return np.asarray(self.clearance(p_N, time_s).distance_m <= 0.0)

    def clearance(self, p_N: Array, time_s: ArrayLike | None = None, radius_m: float = 0.0) -> Clearance:
        """Of points (n, 3) in N, or spheres about them, at times (n,) or one time; None: of the swept volume.

        Raises InputError: wrong shapes, or a time beyond the horizon.
        """
        found = self.swept.clearance(p_N) if time_s is None else self.instant.clearance(p_N, time_s)
        return replace(found, distance_m=found.distance_m - radius_m)

    def clearance_of_body(
        self, mesh_B: trimesh.Trimesh, X_NB: Array, time_s: ArrayLike | None = None
    ) -> Clearance:
        """Of a body at n poses X_NB (n, 4, 4), its mesh in its own frame B [m]: that of its nearest point.

        Raises InputError: wrong shapes, or a time beyond the horizon.
        """
        poses = _poses(X_NB)
        q_B, apart_m = surface_points(mesh_B)
        place = np.concatenate([transform_points(X, q_B) for X in poses])
        time = None if time_s is None else np.repeat(self.instant._times(time_s, len(poses)), len(q_B))
        found = self.clearance(place, time, apart_m)
        rows = found.distance_m.reshape(len(poses), -1)
        nearest = np.argmin(rows, axis=1) + np.arange(len(poses)) * len(q_B)
        return Clearance(found.distance_m[nearest], found.gradient_N[nearest])

    def contact(
        self,
        X_NB: Array,
        time_s: Array,
        radius_m: float = 0.0,
        mesh_B: trimesh.Trimesh | None = None,
    ) -> Contact:
        """Of a chaser at poses X_NB (n, 4, 4), or positions (n, 3), at increasing times (n,): a sphere about
        its origin, or a mesh in its own frame B [m]. Between two times it is where it is at the nearer one.

        The probability is that of the predicted motion, of members drawn for this question; among several
        hypotheses it is the largest. Raises InputError: wrong shapes, or times that do not increase or are
        beyond the horizon.
        """
        poses, time = _poses(X_NB), np.asarray(time_s, dtype=np.float64)
        if time.shape != (len(poses),) or np.any(np.diff(time) <= 0.0):
            raise InputError(f"times: give {len(poses)} that increase, one for each pose")
        self.instant._times(time, len(poses))
        q_B, apart_m = (np.zeros((1, 3)), radius_m) if mesh_B is None else surface_points(mesh_B)
        place = np.stack([transform_points(X, q_B) for X in poses])
        by = np.max([self._contact_by(each, place, time, apart_m) for each in self.estimates], axis=0)
        late = np.flatnonzero(by > 1.0 - self.confidence)
        return Contact(float(time[late[0]]) if len(late) else None, float(by[-1]), by)

    def _contact_by(self, estimate: FinalEstimate, place: Array, time: Array, apart_m: float) -> Array:
        """(n,) probability of a contact until each time of points (n, m, 3), each with a sphere about it."""
        # members are drawn for times above 0
        later = np.maximum(time, 1e-6 * np.arange(1, len(time) + 1))
        members = draw_ensemble(estimate, later, self.members, CONTACT_SEED)
        grid = self.body.grid
        near_m = nearest_approach(members.R_NG, members.p_NG, place, grid.values, grid.origin, grid.step_m)
        so_far = np.maximum.accumulate(apart_m - near_m, axis=1)
        return np.array([ScoreTail.of(scores).exceeded(0.0) for scores in so_far.T])

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


def surface_points(mesh: trimesh.Trimesh) -> tuple[Array, float]:
    """Points (m, 3) on a surface, and the distance [m] within which one of them is, everywhere on it."""
    if len(mesh.faces) == 0:
        raise InputError("the mesh has no faces")
    spacing_m = float(np.sqrt(mesh.area / CHASER_POINTS)) + 1e-12
    points, _, _ = sample_surface(mesh, np.zeros(len(mesh.vertices)), spacing_m)
    cell = np.unique(np.floor(points / spacing_m).astype(np.int64), axis=0, return_index=True)[1]
    # a place is no farther from a point of the lattice than its spacing, and this from the one of its cube
    # no farther than the diagonal
    return points[np.sort(cell)], (np.sqrt(3.0) + 1.0) * spacing_m


def points_in_N(p_N: Array) -> Array:
    """(n, 3) in N. Raises InputError for another shape."""
    points = np.asarray(p_N, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points of shape {points.shape}: give coordinates (n, 3) in N [m]")
    return points


def _poses(X_NB: Array) -> Array:
    """(n, 4, 4) of poses or positions. Raises InputError for another shape."""
    given = np.asarray(X_NB, dtype=np.float64)
    if given.ndim == 2 and given.shape[1] == 3:
        poses = np.tile(np.eye(4), (len(given), 1, 1))
        poses[:, :3, 3] = given
        return poses
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise InputError(f"poses of shape {given.shape}: give X_NB (n, 4, 4), or positions (n, 3) in N [m]")
    return given
