"""Closed meshes for spacecraft: bevelled boxes, solids of revolution, tubes, tapered prisms.

trimesh.creation has none with bevels, nor does it tell which faces make up a panel of a solid of revolution.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from polhode.lie import Array
from polhode.records import Ints

ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Revolved:
    """A solid of revolution about z, and the faces of each of its planar panels."""

    mesh: trimesh.Trimesh
    profile: Array
    """(n, 2) radius and height [m], from the lower end to the upper"""
    panels: Ints
    """(n - 1, sections, 2) faces of the panel between two profile points and two meridians; -1: none"""


def hull(points: ArrayLike) -> trimesh.Trimesh:
    """Convex hull of points (n, 3) as a closed mesh with outward faces."""
    corners = np.asarray(points, dtype=np.float64)
    shape = ConvexHull(corners)
    used = np.unique(shape.simplices)
    faces = np.searchsorted(used, shape.simplices)
    vertices = corners[used]
    middle = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = np.einsum("fk,fk->f", np.cross(b - a, c - a), a - middle) < 0
    faces[inward] = faces[inward][:, ::-1]
    return trimesh.Trimesh(vertices, faces, process=False)


def box(extents: ArrayLike, bevel: float = 0.06, at: ArrayLike = ORIGIN) -> trimesh.Trimesh:
    """A box around a point (3,) whose edges are chamfered at 45 degrees; bevel relative to its shortest side.

    Real edges catch the light: a box without bevels looks artificial.
    """
    half = 0.5 * np.asarray(extents, dtype=np.float64)
    cut = 2.0 * bevel * float(half.min())
    signs, inset = _box_corners()
    return _moved_to(at, trimesh.Trimesh(signs * (half - cut * inset), _box_faces(), process=False))


def _box_corners() -> tuple[Array, Array]:
    """Octant (24, 3) of each corner of a bevelled box, and (24, 3) 1 along axes in which it is set back."""
    octants = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    return np.repeat(octants, 3, axis=0), np.tile(1.0 - np.eye(3), (8, 1))


@lru_cache(maxsize=1)
def _box_faces() -> Ints:
    signs, inset = _box_corners()
    shape = hull(signs * (1.0 - 0.1 * inset))
    # The hull keeps the order: its vertices are all the corners.
    return np.asarray(shape.faces)


def prism(outline: ArrayLike, height: float, taper: float = 1.0, at: ArrayLike = ORIGIN) -> trimesh.Trimesh:
    """Convex outline (n, 2) at z = 0, scaled by ``taper`` at z = height [m]; then moved by ``at``."""
    flat = np.asarray(outline, dtype=np.float64)
    lower = np.column_stack([flat, np.zeros(len(flat))])
    upper = np.column_stack([taper * flat, np.full(len(flat), height)])
    return _moved_to(at, hull(np.vstack([lower, upper])))


def revolve(profile: ArrayLike, sections: int, closed: bool = False) -> Revolved:
    """Revolve a profile (n, 2) of radius and height [m] about z.

    Open profiles start and end on the axis; closed ones (rings) return to their first point.
    """
    line = np.asarray(profile, dtype=np.float64)
    if closed:
        line = np.vstack([line, line[:1]])
    angle = 2.0 * np.pi * np.arange(sections) / sections
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    vertices: list[Array] = []
    rings: list[Ints] = []
    count = 0
    for radius, height in line[:-1] if closed else line:
        if radius < 1e-12:
            vertices.append(np.array([[0.0, 0.0, height]]))
            rings.append(np.full(sections, count))
            count += 1
        else:
            vertices.append(np.column_stack([radius * circle, np.full(sections, height)]))
            rings.append(count + np.arange(sections))
            count += sections
    if closed:
        rings.append(rings[0])
    low, high = np.stack(rings[:-1]), np.stack(rings[1:])
    after_low, after_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    halves = np.stack(
        [np.stack([low, after_low, after_high], axis=-1), np.stack([low, after_high, high], axis=-1)], axis=2
    )
    a, b, c = (halves[..., k] for k in range(3))
    whole = (a != b) & (b != c) & (c != a)
    panels = np.where(whole, np.cumsum(whole.ravel()).reshape(whole.shape) - 1, -1)
    faces = halves[whole]
    mesh = trimesh.Trimesh(np.vstack(vertices), faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return Revolved(mesh, line, panels)


def drum(
    radius: float, height: float, sections: int = 24, bevel: float = 0.08, at: ArrayLike = ORIGIN
) -> trimesh.Trimesh:
    """A cylinder along z whose rims are chamfered; bevel relative to the smaller side.

    The middle of its lower end lies at the point (3,).
    """
    cut = bevel * min(radius, height)
    profile = [
        (0, 0),
        (radius - cut, 0),
        (radius, cut),
        (radius, height - cut),
        (radius - cut, height),
        (0, height),
    ]
    return _moved_to(at, revolve(profile, sections).mesh)


def ring(inner: float, outer: float, low: float, high: float, sections: int) -> Revolved:
    """A ring of rectangular section about z, from one radius to another and one height to another [m]."""
    return revolve([(inner, low), (outer, low), (outer, high), (inner, high)], sections, closed=True)


def ellipsoid_cap(radius: float, height: float, rings: int = 8) -> Array:
    """Profile (rings + 1, 2) of half an ellipse, from the axis at ``height`` to the radius at zero [m]."""
    angle = np.linspace(np.pi / 2, 0.0, rings + 1)
    profile = np.column_stack([radius * np.cos(angle), height * np.sin(angle)])
    profile[0, 0] = 0.0
    return profile


def ball(radius: float, sections: int = 20, rings: int = 10, at: ArrayLike = ORIGIN) -> trimesh.Trimesh:
    """A ball around a point (3,) [m]."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    return _moved_to(at, revolve(profile, sections).mesh)


def tube(path: ArrayLike, radius: float, sections: int = 8) -> trimesh.Trimesh:
    """A closed round bar along a path (n, 3) [m], its ends flat."""
    points = np.asarray(path, dtype=np.float64)
    ahead = np.diff(points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    tangent = np.vstack([ahead[:1], ahead[:-1] + ahead[1:], ahead[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], np.eye(3)[int(np.argmin(np.abs(tangent[0])))])
    angle = 2.0 * np.pi * np.arange(sections) / sections
    rings = []
    for point, direction in zip(points, tangent, strict=True):
        # Each ring's axis is that of the last one, projected onto the new plane: the bar does not twist.
        side = side - (side @ direction) * direction
        side /= np.linalg.norm(side)
        other = np.cross(direction, side)
        rings.append(point + radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * other))
    vertices = np.vstack([*rings, points[:1], points[-1:]])
    first, last = len(points) * sections, len(points) * sections + 1
    faces = []
    for s in range(len(points) - 1):
        for k in range(sections):
            a, b = s * sections + k, s * sections + (k + 1) % sections
            faces += [(a, b, b + sections), (a, b + sections, a + sections)]
    top = (len(points) - 1) * sections
    for k in range(sections):
        n = (k + 1) % sections
        faces += [(first, n, k), (last, top + k, top + n)]
    return trimesh.Trimesh(vertices, faces, process=False)


def strut(start: ArrayLike, end: ArrayLike, radius: float, sections: int = 8) -> trimesh.Trimesh:
    """A straight round bar between two points [m]."""
    return tube([np.asarray(start), np.asarray(end)], radius, sections)


def _moved_to(at: ArrayLike, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    if at is not ORIGIN:
        mesh.apply_translation(at)
    return mesh


def radial(angle: float) -> Array:
    """Unit vector (3,) across z at an angle from x [rad]."""
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def frame(x_G: ArrayLike, z_G: ArrayLike, position_G: ArrayLike) -> Array:
    """Pose (4, 4) of a frame with these x and z axes (3,), unit and perpendicular."""
    x, z = np.asarray(x_G, dtype=np.float64), np.asarray(z_G, dtype=np.float64)
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = x, np.cross(z, x), z, position_G
    return X


def pose(direction_G: ArrayLike, position_G: ArrayLike, turn: float = 0.0) -> Array:
    """Pose (4, 4): rotation about z [rad], then of z to a direction, then translation of the origin."""
    z = np.array(direction_G, dtype=np.float64)
    z /= np.sqrt(z @ z)
    # Any x perpendicular to z will do; this one is smooth over the upper hemisphere.
    reference = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = reference - (reference @ z) * z
    x /= np.sqrt(x @ x)
    y = np.array([z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]])
    c, s = np.cos(turn), np.sin(turn)
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = c * x + s * y, c * y - s * x, z, position_G
    return X
