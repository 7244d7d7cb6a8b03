"""Closed meshes for spacecraft, and the plane and smooth regions of a mesh.

trimesh.creation has no solids with bevels, and does not give the faces of a panel of a solid of revolution.
trimesh's facets leave out single faces and faces that are not adjacent; its vertex normals round off sharp
edges.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled

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
    used, faces = np.unique(shape.simplices, return_inverse=True)
    faces, vertices = faces.reshape(-1, 3), corners[used]
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
    signs, inset, faces = _box_corners()
    return _moved_to(at, trimesh.Trimesh(signs * (half - cut * inset), faces, process=False))


@lru_cache(maxsize=1)
def _box_corners() -> tuple[Array, Array, Ints]:
    """Octants of a bevelled box's corners (24, 3), 1 along axes in which each is set back (24, 3), faces."""
    octants = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    signs, inset = np.repeat(octants, 3, axis=0), np.tile(1.0 - np.eye(3), (8, 1))
    # The hull keeps the order: its vertices are all the corners.
    return signs, inset, np.asarray(hull(signs * (1.0 - 0.1 * inset)).faces)


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
        on_axis = radius < 1e-12
        ring = np.column_stack([radius * circle, np.full(sections, height)])
        vertices.append(np.array([[0.0, 0.0, height]]) if on_axis else ring)
        rings.append(count + (np.zeros(sections, np.int64) if on_axis else np.arange(sections)))
        count += len(vertices[-1])
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
    profile = [(0, 0), (radius - cut, 0), (radius, cut), (radius, height - cut), (radius - cut, height),
               (0, height)]  # fmt: skip
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
    first = len(points) * sections
    top, k = first - sections, np.arange(sections)
    n = (k + 1) % sections
    a, b = (np.arange(len(points) - 1)[:, None] * sections + side for side in (k, n))
    walls = np.stack([a, b, b + sections, a, b + sections, a + sections], axis=-1).reshape(-1, 3)
    ends = np.stack([np.full_like(k, first), n, k, np.full_like(k, first + 1), top + k, top + n], axis=-1)
    return trimesh.Trimesh(vertices, np.vstack([walls, ends.reshape(-1, 3)]), process=False)


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


SMOOTH_BELOW_DEG, SAME_PLANE_DEG = 40.0, 1.0
CURVED_BELOW_DEG = 30.0
"""Neighbouring facets of a curved wall meet at less than this."""


def smooth_corner_normals(mesh: trimesh.Trimesh) -> Array:
    """Normals per corner (F, 3, 3): mean of the neighbouring faces less than 40 degrees away.

    Faces of opposite winding count with the opposite sign: real meshes have inconsistent windings.
    """
    faces = np.ascontiguousarray(mesh.faces)
    order = np.argsort(faces.ravel(), kind="stable")
    start = np.searchsorted(faces.ravel()[order], np.arange(len(mesh.vertices) + 1))
    normals, area = np.ascontiguousarray(mesh.face_normals), np.ascontiguousarray(mesh.area_faces)
    return np.asarray(_smooth(faces, order // 3, start, normals, area))


@compiled
def _smooth(faces: Ints, face_at: Ints, start: Ints, normals: Array, area: Array) -> Array:
    """``face_at[start[v] : start[v + 1]]`` are the faces around vertex v."""
    out = np.empty((len(faces), 3, 3))
    limit = np.cos(np.deg2rad(SMOOTH_BELOW_DEG))
    for f in range(len(faces)):
        for c in range(3):
            x, y, z = 0.0, 0.0, 0.0
            for at in range(start[faces[f, c]], start[faces[f, c] + 1]):
                g = face_at[at]
                n, m = normals[f], normals[g]
                cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
                if abs(cosine) > limit:
                    weight = area[g] if cosine > 0.0 else -area[g]
                    x += weight * normals[g, 0]
                    y += weight * normals[g, 1]
                    z += weight * normals[g, 2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
            else:
                out[f, c] = normals[f]
    return out


def flat_facets(mesh: trimesh.Trimesh) -> list[Ints]:
    """Coplanar faces, one array per plane, in order of the first face."""
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    offset = np.einsum("fk,fk->f", mesh.face_normals, mesh.triangles[:, 0]) / extent
    # Adding zero turns -0 into 0.
    key = np.round(np.column_stack([mesh.face_normals, offset]), 5) + 0.0
    group = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)
    return [np.flatnonzero(group == g) for g in dict.fromkeys(group.tolist())]


def flat_regions(mesh: trimesh.Trimesh, smallest_m2: float) -> list[Ints]:
    """Flat sides: connected coplanar faces of at least smallest_m2 [m^2], the largest first.

    Facets of a curved wall are left out: more than half of their boundary is a smooth transition to the next.
    """
    if len(mesh.faces) < 2:
        return []
    angle = np.abs(mesh.face_adjacency_angles)
    same = angle < np.deg2rad(0.5 * SAME_PLANE_DEG)
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency[same], node_count=len(mesh.faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    # Length of each region's boundary, and of its part that is a smooth transition to another region.
    a, b, c = (mesh.triangles[:, k] for k in range(3))
    around = np.linalg.norm(b - a, axis=1) + np.linalg.norm(c - b, axis=1) + np.linalg.norm(a - c, axis=1)
    ends = mesh.vertices[mesh.face_adjacency_edges]
    edge = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    one, other = labels[mesh.face_adjacency.T]
    inner = np.bincount(one[same], weights=2.0 * edge[same], minlength=len(area))
    rim = np.bincount(labels, weights=around) - inner
    bent = (angle < np.deg2rad(CURVED_BELOW_DEG)) & ~same
    both = np.r_[one[bent], other[bent]]
    soft = np.bincount(both, weights=np.r_[edge[bent], edge[bent]], minlength=len(area))
    regions = []
    for label in np.argsort(-area, kind="stable"):
        if area[label] < smallest_m2:
            break
        faces = np.flatnonzero(labels == label)
        normal = mesh.area_faces[faces] @ mesh.face_normals[faces]
        length, limit = np.linalg.norm(normal), np.cos(np.deg2rad(SAME_PLANE_DEG))
        flat = length > 0 and (mesh.face_normals[faces] @ normal).min() > length * limit
        if flat and soft[label] <= 0.5 * rim[label]:
            regions.append(faces)
    return regions
