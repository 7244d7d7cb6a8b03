"""Constraints of the nonlinear program: what is known of the target besides its motion (backend.bounds).

Each constraint is a vector of functions g(x) of the program's unknowns with limits low <= g <= high, and its
derivatives. They are switched on in the configuration; none is by default.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from polhode.backend.problem.inertia import InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, XI, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import LN_MASS
from polhode.backend.solvers.linearization_point import LinearizationPoint, MotionFit
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Ints, exp_so3, hat, right_jacobian_so3

LIMIT_TOLERANCE = 1e-5
"""A limit is reached when a function is this close to it [m, 1], or beyond."""


@dataclass(frozen=True)
class Constraint:
    """low <= values(x) <= high."""

    name: str
    low: Array
    """(m,)"""
    high: Array
    """(m,)"""
    columns: Ints
    """(m, width) unknowns that each function depends on"""
    evaluate: Callable[[LinearizationPoint, Array], tuple[Array, Array]]
    """(fixed, x) -> values (m,), and their derivatives (m, width) in the columns"""


def linear(name: str, columns: Ints, A: Array, low: Array, high: Array) -> Constraint:
    """``low <= A x[columns] <= high``, A (m, width), columns (width,)."""
    every = np.broadcast_to(columns, A.shape)
    return Constraint(name, low, high, every, lambda _, x: (np.asarray(A @ x[columns]), A))


def centre_of_mass_in_hull(at: Iterate, normals: Array, offsets: Array) -> Constraint:
    """The centre of mass in a convex body in G; normals (H, 3) unit, outwards; offsets (H,) [m]."""
    low = np.full(len(offsets), -np.inf)
    return linear("centre of mass in hull", at.n_states + np.arange(3), normals, low, offsets)


def known_mass(at: Iterate, mass_kg: float) -> Constraint:
    """The mass that known forces would determine is the given one."""
    logarithm = np.log([mass_kg])
    column = np.array([at.n_states + N_CONSTANTS + LN_MASS])
    return linear("known mass", column, np.eye(1), logarithm, logarithm)


def landmarks_in_front(data: MotionData, at: Iterate, least_m: float) -> Constraint:
    """Depth of each observed landmark at least ``least_m``; it is the same in both rectified cameras."""
    frame, mark, m = data.frame, data.landmark, len(data.frame)
    poses = at.n_state * frame[:, None] + np.arange(6)
    columns = np.concatenate([poses, at.n_dense + 3 * mark[:, None] + np.arange(3)], axis=1)

    def evaluate(fixed: LinearizationPoint, x: Array) -> tuple[Array, Array]:
        states, p_G = x[: at.n_states].reshape(-1, at.n_state), x[at.n_dense :].reshape(-1, 3)
        p_NG, theta = states[:, :3], states[:, 3:6]
        to_point = (fixed.A @ exp_so3(theta))[frame, 2]
        moved = np.einsum("fij,fj->fi", data.R_RN, p_NG) + data.t_R
        depth = np.einsum("mj,mj->m", to_point, p_G[mark]) + moved[frame, 2]
        turned = -np.einsum("mi,mij->mj", to_point, hat(p_G[mark]) @ right_jacobian_so3(theta)[frame])
        return depth, np.concatenate([data.R_RN[frame, 2], turned, to_point], axis=1)

    name = "landmarks in front of the cameras"
    return Constraint(name, np.full(m, least_m), np.full(m, np.inf), columns, evaluate)


def _of_inertia(
    name: str, at: Iterate, limits: tuple[Array, Array], evaluate: Callable[..., tuple[Array, Array]]
) -> Constraint:
    """Functions of the inertia: ``evaluate(fixed, xi)`` gives values (m,) and derivatives (m, 5)."""
    xi = at.n_states + np.arange(N_CONSTANTS)[XI]
    columns = np.broadcast_to(xi, (len(limits[0]), len(xi)))
    return Constraint(name, *limits, columns, lambda fixed, x: evaluate(fixed, x[xi]))


def equal_moments(form: InertiaForm, at: Iterate, which: str) -> Constraint:
    """The two "largest", or "smallest", moments are equal: isotropy across the third principal axis.

    The axis is that of the linearization point; the passes of the solver renew it, so it remains free.
    """

    def unequal(second: Array) -> Array:
        return np.array([second[0, 0] - second[1, 1], 2.0 * second[0, 1]])

    def evaluate(fixed: LinearizationPoint, xi: Array) -> tuple[Array, Array]:
        reference = fixed.reference
        axes = np.linalg.eigh(reference.second_moments(form))[1]
        # second moments ascend as moments of inertia descend: the first two are to be equal
        axes = axes if which == "largest" else axes[:, [1, 2, 0]]
        second = axes.T @ form.second_moments(xi, reference.R_inertia) @ axes
        by_xi = axes.T @ form.derivative(xi, reference.R_inertia) @ axes
        trace, traces = np.trace(second), np.trace(by_xi, axis1=1, axis2=2)
        slopes = np.stack([unequal(each) for each in by_xi], axis=1)
        return unequal(second) / trace, slopes / trace - np.outer(unequal(second), traces) / trace**2

    return _of_inertia(f"{which} moments equal", at, (np.zeros(2), np.zeros(2)), evaluate)


def inertia_of_hull(
    form: InertiaForm, at: Iterate, directions: Array, least: Array, most: Array
) -> Constraint:
    """The inertia is that of a mass in a convex hull whose density is nonnegative and bounded.

    directions (D, 3) unit; least, most (D,) second moments per mass along them [m^2].

    The parameters of the inertia have a mass of nonnegative density in any case, but perhaps far outside of
    the body. Per mass, and about its own centre, the second moment along a direction u is at most the square
    of half the hull's length along u. It is at least that of a slab, t^2 / 12: the cap on the density
    leaves at least the thickness t = V / (ratio A), with the hull's volume V and its shadow A across u. The
    scale is unknown, so what counts is ``least_i a_j <= most_j a_i`` with a = u^T Sigma u, for all pairs of
    some directions: necessary conditions, written as logarithms.
    """
    i, j = np.nonzero(~np.eye(len(directions), dtype=bool))
    offset = np.log(least[i] / most[j])

    def evaluate(fixed: LinearizationPoint, xi: Array) -> tuple[Array, Array]:
        u, R_ref = directions, fixed.reference.R_inertia
        along = np.einsum("di,ij,dj->d", u, form.second_moments(xi, R_ref), u)
        slopes = np.einsum("di,kij,dj->dk", u, form.derivative(xi, R_ref), u) / along[:, None]
        logarithms = np.log(along)
        return offset + logarithms[j] - logarithms[i], slopes[j] - slopes[i]

    limits = np.full(len(i), -np.inf), np.zeros(len(i))
    return _of_inertia("inertia of a body in hull", at, limits, evaluate)


@dataclass(frozen=True)
class Constraints:
    """All constraints of a program, one below the other."""

    parts: tuple[Constraint, ...]

    def __bool__(self) -> bool:
        return bool(self.parts)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Low and high (m,)."""
        low, high = ([getattr(part, name) for part in self.parts] for name in ("low", "high"))
        return np.concatenate(low), np.concatenate(high)

    def values(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(m,)"""
        return np.concatenate([part.evaluate(fixed, x)[0] for part in self.parts])

    def cells(self) -> tuple[Ints, Ints]:
        """Rows and columns (n,) of the derivatives."""
        widths = np.concatenate([np.full(len(part.low), part.columns.shape[1]) for part in self.parts])
        columns = np.concatenate([part.columns.ravel() for part in self.parts])
        return np.repeat(np.arange(len(widths)), widths), columns

    def derivatives(self, fixed: LinearizationPoint, x: Array) -> Array:
        """(n,) in the order of ``cells``."""
        return np.concatenate([part.evaluate(fixed, x)[1].ravel() for part in self.parts])

    def reached(self, fixed: LinearizationPoint, x: Array) -> dict[str, bool]:
        """By name, whether x is at a limit of a constraint or beyond."""
        found = {}
        for part in self.parts:
            values = part.evaluate(fixed, x)[0]
            room = np.minimum(values - part.low, part.high - values)
            found[part.name] = bool(room.min(initial=np.inf) <= LIMIT_TOLERANCE)
        return found

    def hold(self, fixed: LinearizationPoint, x: Array) -> bool:
        """Whether x violates none."""
        values, (low, high) = self.values(fixed, x), self.limits
        return bool(np.all(values >= low - LIMIT_TOLERANCE) and np.all(values <= high + LIMIT_TOLERANCE))


def constraints_of(start: MotionFit, config: Backend) -> Constraints:
    """Those that the configuration asks for, and the problem has unknowns for."""
    bounds, data, at = config.bounds, start.data, start.iterate
    parts = list[Constraint]()
    if bounds.com_in == "landmarks":
        hull = _hull_of_landmarks(at.p_G, bounds.hull_growth)
        parts += [] if hull is None else [centre_of_mass_in_hull(at, *hull)]
    elif bounds.com_in == "box" and bounds.com_box_G is not None:
        low, high = np.array(bounds.com_box_G)
        faces = np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([high, -low])
        parts.append(centre_of_mass_in_hull(at, *faces))
    if bounds.least_depth_m is not None:
        parts.append(landmarks_in_front(data, at, bounds.least_depth_m))
    if bounds.equal_moments != "none":
        parts.append(equal_moments(data.form, at, bounds.equal_moments))
    if bounds.inertia_in == "landmarks":
        limits = second_moment_limits(at.p_G, bounds.hull_growth, bounds.max_density_ratio)
        parts += [] if limits is None else [inertia_of_hull(data.form, at, *limits)]
    if bounds.known_mass and config.mass_kg is not None and at.wrench is not None:
        parts.append(known_mass(at, config.mass_kg))
    return Constraints(tuple(parts))


def _hull_of_landmarks(p_G: Array, growth: float) -> tuple[Array, Array] | None:
    """Normals and offsets of the convex hull of landmarks (L, 3), enlarged about its middle.

    None: they lie in a plane.
    """
    try:
        hull = ConvexHull(p_G)
    except (QhullError, ValueError):
        return None
    rows = np.unique(np.round(hull.equations, 12), axis=0)
    normals, offsets = rows[:, :3], -rows[:, 3]
    middle = p_G[hull.vertices].mean(axis=0)
    depth = offsets - normals @ middle
    return normals, normals @ middle + growth * depth


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
    # in the plane across a direction Qhull's volume is an area
    across = [np.linalg.svd(u[None])[2][1:] for u in directions]
    shadow_m2 = np.array([ConvexHull(corners @ plane.T).volume for plane in across])
    slab_m = hull.volume / (max_density_ratio * shadow_m2 * growth)
    return directions, slab_m**2 / 12.0, (0.5 * length_m) ** 2
