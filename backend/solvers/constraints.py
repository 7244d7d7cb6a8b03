"""Constraints of the nonlinear program: what is known of the target besides its motion (backend.bounds).

Each constraint is a vector of functions g(x) of the program's unknowns with limits low <= g <= high, and its
derivatives. They are switched on in the configuration; none is by default.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, XI, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import LN_MASS
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.config.backend_settings import Backend
from polhode.lie import Array, exp_so3, hat, right_jacobian_so3
from polhode.records import Ints

ACTIVE = 1e-5
"""A limit is reached when a function is this close to it [m, 1], or beyond."""
FREE = np.inf


class Constraint(Protocol):
    """low <= values(x) <= high; ``cells`` are rows and columns of the derivative's entries."""

    name: str
    low: Array
    """(m,)"""
    high: Array
    """(m,)"""

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(m,)"""
        ...

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        """Rows and columns (n,) of the derivatives that are not always zero."""
        ...

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(n,) in the order of ``cells``."""
        ...


class CentreOfMassInHull:
    """``normals @ com_G <= offsets``: the centre of mass inside a convex body in G."""

    name = "centre of mass in hull"

    def __init__(self, normals: Array, offsets: Array) -> None:
        """normals (H, 3) unit, outwards; offsets (H,) [m]."""
        self.normals, self.high = normals, offsets
        self.low = np.full(len(offsets), -FREE)

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        first = fixed.reference.n_states
        return np.asarray(self.normals @ x[first : first + 3])

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        m = len(self.high)
        return np.repeat(np.arange(m), 3), np.tile(reference.n_states + np.arange(3), m)

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        del fixed, x
        return np.asarray(self.normals.ravel())


class LandmarksInFront:
    """Depth of each observed landmark at least ``low``; it is the same in both rectified cameras."""

    name = "landmarks in front of the cameras"

    def __init__(self, data: MotionData, least_m: float) -> None:
        self.data = data
        self.low, self.high = np.full(len(data.frame), least_m), np.full(len(data.frame), FREE)

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        d = self.data
        p_NG, now, _, p_G = self._at(fixed, x)
        moved = np.einsum("fij,fj->fi", d.R_RN, p_NG) + d.t_R
        return np.asarray(np.einsum("mj,mj->m", now[d.frame, 2], p_G[d.landmark]) + moved[d.frame, 2])

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        d, s = self.data, reference.n_state
        poses = s * d.frame[:, None] + np.arange(6)
        marks = reference.n_dense + 3 * d.landmark[:, None] + np.arange(3)
        return np.repeat(np.arange(len(d.frame)), 9), np.concatenate([poses, marks], axis=1).ravel()

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        d = self.data
        _, now, theta, p_G = self._at(fixed, x)
        to_point = now[d.frame, 2]
        turned = -np.einsum("mi,mij->mj", to_point, hat(p_G[d.landmark]) @ right_jacobian_so3(theta)[d.frame])
        return np.asarray(np.concatenate([d.R_RN[d.frame, 2], turned, to_point], axis=1).ravel())

    def _at(self, fixed: LinearizationPoint, x: Array) -> tuple[Array, Array, Array, Array]:
        """p_NG (F, 3), attitudes in the camera (F, 3, 3), theta (F, 3), p_G (L, 3)."""
        at = fixed.reference
        states = x[: at.n_states].reshape(-1, at.n_state)
        theta = states[:, 3:6]
        return states[:, :3], fixed.A @ exp_so3(theta), theta, x[at.n_dense :].reshape(-1, 3)


class EqualMoments:
    """The two largest, or the two smallest, moments are equal: isotropy across the third principal axis.

    The axis is that of the linearization point; the passes of the solver renew it, so it remains free.
    """

    low = high = np.zeros(2)

    def __init__(self, form: InertiaForm, which: str) -> None:
        """which: "largest" or "smallest"."""
        self.form, self.which = form, which
        self.name = f"{which} moments equal"

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        second, _ = self._moments(fixed, x)
        return np.asarray(_unequal(second) / np.trace(second))

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        xi = reference.n_states + np.arange(N_CONSTANTS)[XI]
        return np.repeat(np.arange(2), len(xi)), np.tile(xi, 2)

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        second, by_xi = self._moments(fixed, x)
        trace = np.trace(second)
        traces = np.trace(by_xi, axis1=1, axis2=2)
        slopes = np.stack([_unequal(each) for each in by_xi], axis=1)
        return np.asarray((slopes / trace - np.outer(_unequal(second), traces) / trace**2).ravel())

    def _moments(self, fixed: LinearizationPoint, x: Array) -> tuple[Array, Array]:
        """Second moments (3, 3) and their derivatives (5, 3, 3), in axes of which the first two are equal."""
        reference = fixed.reference
        axes = np.linalg.eigh(reference.second_moments(self.form))[1]
        # second moments ascend as moments of inertia descend
        axes = axes if self.which == "largest" else axes[:, [1, 2, 0]]
        xi = x[reference.n_states : reference.n_states + N_CONSTANTS][XI]
        second = self.form.second_moments(xi, reference.R_inertia)
        by_xi = self.form.derivative(xi, reference.R_inertia)
        return axes.T @ second @ axes, axes.T @ by_xi @ axes


def _unequal(second: Array) -> Array:
    return np.array([second[0, 0] - second[1, 1], 2.0 * second[0, 1]])


class InertiaOfHull:
    """The inertia is that of a mass in a convex hull whose density is nonnegative and bounded.

    The parameters of the inertia have a mass of nonnegative density in any case, but perhaps far outside of
    the body. Per mass, and about its own centre, the second moment along a direction u is at most the square
    of half the hull's length along u. It is at least that of a slab, t^2 / 12: the cap on the density
    leaves at least the thickness t = V / (ratio A), with the hull's volume V and its shadow A across u. The
    scale is unknown, so what counts is ``least_i a_j <= most_j a_i`` with a = u^T Sigma u, for all pairs of
    some directions: necessary conditions, written as logarithms.
    """

    name = "inertia of a body in hull"

    def __init__(self, form: InertiaForm, directions: Array, least: Array, most: Array) -> None:
        """directions (D, 3) unit; least, most (D,) second moments per mass along them [m^2]."""
        self.form, self.directions = form, directions
        i, j = np.nonzero(~np.eye(len(directions), dtype=bool))
        self._pairs = i, j
        self._offset = np.log(least[i] / most[j])
        self.low, self.high = np.full(len(i), -FREE), np.zeros(len(i))

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        logarithms, _ = self._logarithms(fixed, x)
        i, j = self._pairs
        return np.asarray(self._offset + logarithms[j] - logarithms[i])

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        xi = reference.n_states + np.arange(N_CONSTANTS)[XI]
        m = len(self.high)
        return np.repeat(np.arange(m), len(xi)), np.tile(xi, m)

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        _, slopes = self._logarithms(fixed, x)
        i, j = self._pairs
        return np.asarray((slopes[j] - slopes[i]).ravel())

    def _logarithms(self, fixed: LinearizationPoint, x: Array) -> tuple[Array, Array]:
        """Of the second moments along the directions (D,), and their derivatives (D, 5)."""
        at, u = fixed.reference, self.directions
        xi = x[at.n_states : at.n_states + N_CONSTANTS][XI]
        along = np.einsum("di,ij,dj->d", u, self.form.second_moments(xi, at.R_inertia), u)
        slopes = np.einsum("di,kij,dj->dk", u, self.form.derivative(xi, at.R_inertia), u)
        return np.log(along), slopes / along[:, None]


class KnownMass:
    """The mass that known forces would determine is the given one."""

    name = "known mass"

    def __init__(self, mass_kg: float) -> None:
        self.low = self.high = np.log([mass_kg])

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        return np.asarray(x[self.cells(fixed.reference)[1]])

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        return np.zeros(1, dtype=np.int64), np.array([reference.n_states + N_CONSTANTS + LN_MASS])

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        del fixed, x
        return np.ones(1)


@dataclass(frozen=True)
class Constraints:
    """All constraints of a program, one below the other."""

    parts: tuple[Constraint, ...]

    def __bool__(self) -> bool:
        return bool(self.parts)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Low and high (m,)."""
        return (
            np.concatenate([part.low for part in self.parts]),
            np.concatenate([part.high for part in self.parts]),
        )

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(m,)"""
        return np.concatenate([part.values(fixed, x) for part in self.parts])

    def cells(self, reference: Iterate) -> tuple[Ints, Ints]:
        """Rows and columns (n,) of the derivatives."""
        rows, columns, first = [], [], 0
        for part in self.parts:
            own_rows, own_columns = part.cells(reference)
            rows.append(first + own_rows)
            columns.append(own_columns)
            first += len(part.low)
        return np.concatenate(rows), np.concatenate(columns)

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(n,)"""
        return np.concatenate([part.derivatives(fixed, x) for part in self.parts])

    def reached(self, fixed: LinearizationPoint, x: Array) -> dict[str, bool]:
        """By name, whether x is at a limit of a constraint or beyond."""
        found = {}
        for part in self.parts:
            values = part.values(fixed, x)
            room = np.minimum(values - part.low, part.high - values)
            found[part.name] = bool(room.min(initial=FREE) <= ACTIVE)
        return found

    def hold(self, fixed: LinearizationPoint, x: Array) -> bool:
        """Whether x violates none."""
        values, (low, high) = self.values(fixed, x), self.limits
        return bool(np.all(values >= low - ACTIVE) and np.all(values <= high + ACTIVE))


def constraints_of(data: MotionData, iterate: Iterate, config: Backend) -> Constraints:
    """Those that the configuration asks for, and the problem has unknowns for."""
    bounds, parts = config.bounds, list[Constraint]()
    if bounds.com_in == "landmarks":
        hull = _hull_of_landmarks(iterate.p_G, bounds.hull_growth)
        parts += [] if hull is None else [hull]
    elif bounds.com_in == "box" and bounds.com_box_G is not None:
        low, high = np.array(bounds.com_box_G)
        parts.append(
            CentreOfMassInHull(np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([high, -low]))
        )
    if bounds.least_depth_m is not None:
        parts.append(LandmarksInFront(data, bounds.least_depth_m))
    if bounds.equal_moments != "none":
        parts.append(EqualMoments(data.form, bounds.equal_moments))
    if bounds.inertia_in == "landmarks":
        limits = second_moment_limits(iterate.p_G, bounds.hull_growth, bounds.max_density_ratio)
        parts += [] if limits is None else [InertiaOfHull(data.form, *limits)]
    if bounds.known_mass and config.mass_kg is not None and iterate.wrench is not None:
        parts.append(KnownMass(config.mass_kg))
    return Constraints(tuple(parts))


def _hull_of_landmarks(p_G: Array, growth: float) -> CentreOfMassInHull | None:
    """The convex hull of landmarks (L, 3), enlarged about its middle; None: they lie in a plane."""
    try:
        hull = ConvexHull(p_G)
    except (QhullError, ValueError):
        return None
    rows = np.unique(np.round(hull.equations, 12), axis=0)
    normals, offsets = rows[:, :3], -rows[:, 3]
    middle = p_G[hull.vertices].mean(axis=0)
    depth = offsets - normals @ middle
    return CentreOfMassInHull(normals, normals @ middle + growth * depth)


def second_moment_limits(
    p_G: Array, growth: float, max_density_ratio: float
) -> tuple[Array, Array, Array] | None:
    """Directions (13, 3), least and largest second moments (13,) per mass [m^2] of a body.

    Its convex hull is between that of the landmarks (L, 3) over ``growth`` and that times ``growth``. None:
    they lie in a plane.
    """
    try:
        hull = ConvexHull(p_G)
    except (QhullError, ValueError):
        return None
    corners = p_G[hull.vertices]
    axes = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    grid = np.stack(np.meshgrid(*3 * [[-1.0, 0.0, 1.0]], indexing="ij"), axis=-1).reshape(-1, 3)
    # one of each pair of opposite directions
    grid = grid[len(grid) // 2 + 1 :]
    directions = grid @ axes / np.linalg.norm(grid, axis=1, keepdims=True)
    length_m = growth * np.ptp(corners @ directions.T, axis=0)
    shadow_m2 = np.array([_shadow(corners, u) for u in directions])
    slab_m = hull.volume / (max_density_ratio * shadow_m2 * growth)
    return directions, slab_m**2 / 12.0, (0.5 * length_m) ** 2


def _shadow(corners: Array, u: Array) -> float:
    """Area [m^2] of the projection of points (n, 3) across a unit vector."""
    across = np.linalg.svd(u[None])[2][1:]
    # in the plane Qhull's volume is an area
    return float(ConvexHull(corners @ across.T).volume)
