"""Edges of any mesh that a camera can see: creases and open boundaries, merged into straight segments.

Smooth parts have no edges of their own; their outlines depend on the view (`visible_edges.py`). Corners of
faces have the normal of the smooth part that they belong to: a crease separates them, and a cylinder's side
remains smooth.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from polhode.geometry.lie import Array, Bools, Ints
from polhode.geometry.rays import FirstHits, RayScene
from polhode.planning.edges.orientation import (
    Orientation,
    mesh_edges,
    outward_orientation,
    winding_number,
)
from polhode.runtime.errors import InputError


def unit_rows(vectors: Array) -> Array:
    """Vectors (..., k) divided by their lengths; zero where there is none."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


class Occluder:
    """A mesh in G that blocks rays."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        bounds = np.asarray(mesh.bounds)
        self._middle = bounds.mean(axis=0)
        self._radius_m = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
        self._scene = RayScene(np.asarray(mesh.triangles) - self._middle)

    def hides(self, eye_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body blocks the ray from the eye (3,) to points (m, 3), less the clearance."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        away = p_G - eye_G
        distance = np.linalg.norm(away, axis=1)
        along = away / np.maximum(distance, 1e-12)[:, None]
        # Start near the body: single precision is then enough at any range.
        skip = np.maximum(distance - 2.5 * self._radius_m, 0.0)
        start = eye_G + skip[:, None] * along - self._middle
        reach = np.maximum(distance - skip - clearance_m, 0.0)
        start, direction, reach = (each.astype(np.float32) for each in (start, along, reach))
        return self._scene.blocked(start, direction, reach)

    def first_hits(self, eye_G: Array, direction_G: Array) -> tuple[FirstHits, Array]:
        """What rays from the eye (3,) along unit directions (n, 3) hit, and where (n, 3)."""
        skip = max(float(np.linalg.norm(eye_G - self._middle)) - 2.5 * self._radius_m, 0.0)
        start = eye_G - self._middle + skip * direction_G
        hits = self._scene.first_hits(start, direction_G)
        reach = np.where(hits.face >= 0, hits.distance, 0.0)
        return hits, start + reach[:, None] * direction_G + self._middle

    def shades(self, towards_G: Array, p_G: Array, clearance_m: float) -> Bools:
        """(m,) true where the body blocks the light of a distant source towards (3,) from points (m, 3)."""
        if len(p_G) == 0:
            return np.zeros(0, dtype=bool)
        direction = np.broadcast_to(towards_G / np.linalg.norm(towards_G), p_G.shape)
        range_m = np.full(len(p_G), 4.0 * self._radius_m)
        return self._scene.blocked(p_G - self._middle + clearance_m * direction, direction, range_m)


def chains_of(edges: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Maximal chains of edges (m, 2): vertices (k + 1,) and the edges between them (k,).

    A chain ends where an edge ends or where three or more meet. A closed one returns to its first vertex.
    """
    at: dict[int, list[int]] = defaultdict(list)
    for number, (a, b) in enumerate(edges.tolist()):
        at[a].append(number)
        at[b].append(number)
    unused = set(range(len(edges)))
    knots = sorted(vertex for vertex, around in at.items() if len(around) != 2)
    for start in [*knots, *edges[:, 0].tolist()]:
        for first in at[start]:
            vertex, onward, chain, members = start, [first] if first in unused else [], [start], list[int]()
            while onward:
                number = onward[0]
                unused.remove(number)
                members.append(number)
                a, b = edges[number].tolist()
                vertex = b if a == vertex else a
                chain.append(vertex)
                onward = [n for n in at[vertex] if n in unused] if len(at[vertex]) == 2 else []
            if members:
                yield np.array(chain), np.array(members)


def straight_pieces(points: Array, tolerance_m: float) -> list[tuple[int, int]]:
    """Cut a chain (k, 3) into pieces straight to the tolerance: index of first and last point.

    Douglas and Peucker, Cartographica 10, 1973. A closed chain is first cut at the point farthest from its
    first one.
    """
    last = len(points) - 1
    waiting, done = [(0, last)], list[tuple[int, int]]()
    if np.array_equal(points[0], points[last]):
        far = int(np.argmax(np.linalg.norm(points - points[0], axis=1)))
        waiting = [(0, far), (far, last)]
    while waiting:
        a, b = waiting.pop()
        if b <= a:
            continue
        away = points[a + 1 : b] - points[a]
        along = points[b] - points[a]
        length = float(np.linalg.norm(along))
        off = np.linalg.norm(away if length < 1e-12 else np.cross(away, along / length), axis=1)
        if off.max(initial=0.0) <= tolerance_m:
            done.append((a, b))
        else:
            middle = a + 1 + int(np.argmax(off))
            waiting += [(a, middle), (middle, b)]
    return sorted(done)


def tangents_along(knots: Array) -> Array:
    """Directions (k, 2, 3) of a chain at both ends of its k pieces, from its knots (k + 1, 3).

    Along an arc the tangent at a knot is that of the circle through three knots; otherwise the corners of the
    polygon that approximates a circle would make the rotation about its axis observable, which it is not.
    Pieces at less than 30 degrees whose lengths differ by less than a factor of 3 are of an arc; elsewhere
    the tangent is the piece's own direction.
    """
    pieces = np.diff(knots, axis=0)
    length, along = np.linalg.norm(pieces, axis=1), unit_rows(pieces)
    tangents = np.stack([along, along], axis=1)
    closed = len(pieces) > 2 and bool(np.array_equal(knots[0], knots[-1]))
    before = np.arange(len(pieces) - (not closed))
    after = (before + 1) % len(pieces)
    turn = np.einsum("kc,kc->k", along[before], along[after])
    longer, shorter = (each(length[before], length[after]) for each in (np.maximum, np.minimum))
    arc = (turn > np.cos(np.radians(30.0))) & (longer <= 3.0 * shorter)
    before, after = before[arc], after[arc]
    tangents[before, 1] = unit_rows(along[before] * length[after, None] + along[after] * length[before, None])
    tangents[after, 0] = tangents[before, 1]
    return tangents


CREASE_DEG = 30.0
"""Faces that meet at more than this angle form an edge."""


class EdgeKind(IntEnum):
    """Origin of an edge."""

    CREASE = 0
    """two faces that meet at an angle"""
    BOUNDARY = 1
    """boundary of an open mesh"""


@dataclass(frozen=True)
class EdgeModel:
    """Edges in G and the surface that occludes them. Feature i < n is a segment, i >= n a smooth part."""

    ends_G: Array
    """(n, 2, 3) [m]"""
    tangents_G: Array
    """(n, 2, 3) unit direction of the edge at both ends: along arcs they differ from the chord"""
    sides_G: Array
    """(n, 2, 3) outward normals of the faces at both sides; a boundary has its only face twice"""
    kind: Ints
    """(n,) of EdgeKind"""
    surface: trimesh.Trimesh
    """faces in G; all of them occlude, whichever edges are used"""
    corner_normals_G: Array
    """(f, 3, 3) unit normals of the smooth part at the corners of the faces"""
    part: Ints
    """(f,) curved part of each face, numbered from 0; -1 where the face is flat or belongs to a plane"""
    tolerance_m: float
    """largest deviation of a segment from the mesh's edge"""
    outlined: Bools
    """(parts,) which curved parts have outlines"""
    soft: Ints
    """(k, 4) edges that are not creases: two vertices of the surface, the faces on both sides"""
    faceted: bool
    """outlines follow the edges of the faces, not a smooth surface that these approximate"""
    closed: Bools
    """(f,) faces of closed patches: within them there is material"""
    occluder: Occluder = field(repr=False, compare=False)
    notes: tuple[str, ...] = ()
    """what was corrected in the mesh, and what in it is doubtful"""

    @property
    def size(self) -> int:
        """Number of features: segments, then smooth parts."""
        return len(self.ends_G) + len(self.outlined)

    @cached_property
    def lift_G(self) -> Array:
        """(n, 3) outwards, from a segment to the arc that it approximates: a chord lies inside."""
        lift = np.where(self.kind == EdgeKind.BOUNDARY, 0.0, 1.5 * self.tolerance_m)
        return np.asarray(lift[:, None] * unit_rows(self.sides_G[:, 0] + self.sides_G[:, 1]))

    @cached_property
    def outlined_faces(self) -> Bools:
        """(f,) faces of the curved parts that have outlines."""
        return np.append(self.outlined, False)[self.part]

    @property
    def lengths_m(self) -> Array:
        """(n,) of the segments."""
        return np.asarray(np.linalg.norm(self.ends_G[:, 1] - self.ends_G[:, 0], axis=1))

    @property
    def centre_G(self) -> Array:
        """(3,) centre of the surface's bounding box [m]: the default reference point of motions."""
        return np.asarray(self.surface.bounds.mean(axis=0))

    @property
    def radius_m(self) -> float:
        """Half the diagonal of the bounding box."""
        return 0.5 * float(np.linalg.norm(np.ptp(self.surface.bounds, axis=0)))

    def encloses(self, p_G: Array) -> bool:
        """Whether a point (3,) lies inside the body: within its closed parts, however these overlap."""
        lowest, highest = self.surface.bounds
        if not self.closed.any() or (p_G < lowest).any() or (p_G > highest).any():
            return False
        return winding_number(np.asarray(self.surface.triangles)[self.closed], p_G) > 0.5

    def seen(self, eye_G: Array, direction_G: Array) -> tuple[Bools, Array, Array, Array]:
        """Which rays from the eye (3,) along unit directions (n, 3) hit the body (n,), and what they see.

        Of those h: the points (h, 3), normals of the faces (h, 3) and of the smooth surface (h, 3), on the
        side of the eye.
        """
        hits, p_G = self.occluder.first_hits(eye_G, direction_G)
        hit = hits.face >= 0
        face, u, v = hits.face[hit], hits.u[hit], hits.v[hit]
        weight = np.stack([1.0 - u - v, u, v], axis=1)
        smooth_G = unit_rows(np.einsum("hc,hck->hk", weight, self.corner_normals_G[face]))
        flat_G = np.asarray(self.surface.face_normals)[face]
        # an open sheet is also seen from behind
        behind = np.einsum("hk,hk->h", flat_G, direction_G[hit]) > 0.0
        sign = np.where(behind, -1.0, 1.0)[:, None]
        return hit, p_G[hit], sign * flat_G, sign * smooth_G

    def only(self, features: Ints | Bools) -> "EdgeModel":
        """The model with these features (indices or mask of ``size``); the whole surface still occludes."""
        keep = np.zeros(self.size, dtype=bool)
        keep[features] = True
        n = len(self.ends_G)
        return replace(
            self,
            ends_G=self.ends_G[keep[:n]],
            tangents_G=self.tangents_G[keep[:n]],
            sides_G=self.sides_G[keep[:n]],
            kind=self.kind[keep[:n]],
            outlined=self.outlined & keep[n:],
        )


def edge_model(
    mesh: trimesh.Trimesh,
    crease_deg: float = CREASE_DEG,
    tolerance_m: float | None = None,
    min_length_m: float | None = None,
    flat_deg: float = 0.5,
    faceted: bool = False,
) -> EdgeModel:
    """Edges of a mesh in G; smooth parts whose normals differ by less than ``flat_deg`` have no outlines.

    ``tolerance_m``: deviation of a straight piece from the edge, unless given 5e-4 of the body's diameter;
    ``min_length_m``: edges that are shorter are omitted (an arc counts as a whole), unless given 0.01 of it.
    Duplicate faces are removed, and faces are turned so that neighbours agree and normals point outward.

    Raises InputError for a mesh without faces or with numbers that are not finite.
    """
    if len(mesh.faces) == 0:
        raise InputError("the mesh has no faces: an edge model needs a surface")
    if not np.isfinite(mesh.vertices).all():
        raise InputError("the mesh has vertices with non-finite coordinates")
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    surface.merge_vertices(merge_norm=True, merge_tex=True)
    surface.update_faces(surface.nondegenerate_faces() & surface.unique_faces())
    surface.remove_unreferenced_vertices()
    if len(surface.faces) == 0:
        raise InputError("all faces of the mesh are degenerate: an edge model needs a surface")
    occluder = Occluder(surface)
    orientation = outward_orientation(surface, occluder.shades)
    if orientation.reverse.any():
        faces = np.asarray(surface.faces)
        turned = np.where(orientation.reverse[:, None], faces[:, ::-1], faces)
        surface = trimesh.Trimesh(surface.vertices, turned, process=False)
    diameter = float(np.linalg.norm(np.ptp(surface.bounds, axis=0)))
    tolerance_m = 5e-4 * diameter if tolerance_m is None else tolerance_m
    min_length_m = 0.01 * diameter if min_length_m is None else min_length_m

    edges, n = mesh_edges(surface), np.asarray(surface.face_normals)
    cosine = np.einsum("nk,nk->n", n[edges.first], n[edges.second])
    rim = edges.count == 1
    sharp = (cosine < np.cos(np.radians(crease_deg))) | (edges.count > 2) | rim
    sides = np.stack([n[edges.first], n[edges.second]], axis=1)[sharp]
    kind = np.where(rim, EdgeKind.BOUNDARY, EdgeKind.CREASE)[sharp]
    soft = np.column_stack([edges.vertices, edges.first, edges.second])[~sharp]
    count = len(surface.faces)
    joined = coo_matrix((np.ones(len(soft)), (soft[:, 2], soft[:, 3])), shape=(count, count))
    part = np.asarray(connected_components(joined, directed=False)[1], dtype=np.int64)
    corners = _corner_normals(surface, part)
    # parts with a corner normal that deviates from the part's mean
    mean, lowest = np.zeros((int(part.max()) + 1, 3)), np.ones(int(part.max()) + 1)
    np.add.at(mean, part, np.asarray(surface.area_faces)[:, None] * n)
    np.minimum.at(lowest, part, np.einsum("fck,fk->fc", corners, unit_rows(mean)[part]).min(axis=1))
    curved = lowest < np.cos(np.radians(flat_deg))
    return EdgeModel(
        *_segments(surface, edges.vertices[sharp], sides, kind, tolerance_m, min_length_m),
        surface,
        corners,
        np.where(curved, np.cumsum(curved) - 1, -1)[part],
        tolerance_m,
        np.ones(int(curved.sum()), dtype=bool),
        soft,
        faceted,
        orientation.closed,
        occluder,
        _doubts(orientation, kind, len(soft)),
    )


def _doubts(orientation: Orientation, sharp: Ints, soft: int) -> tuple[str, ...]:
    notes, faces = [], len(orientation.reverse)
    turned, one_sided = int(orientation.reverse.sum()), int(orientation.one_sided.sum())
    if turned:
        notes.append(
            "faces of the mesh turned so that neighbours agree and normals point outward: "
            f"{turned} of {faces}"
        )
    if one_sided:
        notes.append(
            f"{one_sided} of the mesh's {faces} faces form a one-sided surface, whose orientation cannot be "
            "made consistent: edges where it changes may be false"
        )
    edges, rims = len(sharp) + soft, int((sharp == EdgeKind.BOUNDARY).sum())
    # a mesh whose faces are not connected; a rough or noisy one
    if faces > 50 and rims > 0.5 * edges:
        notes.append(
            f"{rims} of the mesh's {edges} edges belong to one face only and count as rims: if the surface "
            "is closed, neighbouring faces do not share their vertices; merge these"
        )
    elif edges > 2000 and len(sharp) > 0.5 * edges:
        notes.append(
            f"{len(sharp)} of the mesh's {edges} edges are sharp, as on a rough or noisy surface, and all "
            "count as edges of the body: smooth or simplify the mesh, or raise the crease angle"
        )
    return tuple(notes)


def _corner_normals(surface: trimesh.Trimesh, part: Ints) -> Array:
    """Mean normal around a vertex within its part (f, 3, 3): weights of Max, J. Graphics Tools 4, 1999."""
    triangles = np.asarray(surface.triangles)
    onward, back = (np.roll(triangles, step, axis=1) - triangles for step in (-1, 1))
    squares = np.einsum("fck,fck->fc", onward, onward) * np.einsum("fck,fck->fc", back, back)
    weighted = np.cross(onward, back) / np.maximum(squares, 1e-300)[..., None]
    key = np.asarray(surface.faces) * (part.max() + 1) + part[:, None]
    _, corner = np.unique(key.reshape(-1), return_inverse=True)
    total = np.zeros((corner.max() + 1, 3))
    np.add.at(total, corner.reshape(-1), weighted.reshape(-1, 3))
    normal = total[corner.reshape(-1)].reshape(-1, 3, 3)
    flat = np.asarray(surface.face_normals)[:, None, :]
    return np.where(normal.any(axis=2, keepdims=True), unit_rows(normal), flat)


def _segments(
    surface: trimesh.Trimesh, edges: Ints, sides: Array, kind: Ints, tolerance_m: float, min_length_m: float
) -> tuple[Array, Array, Array, Ints]:
    """Chains of sharp edges, cut into straight pieces: ends, tangents, sides (n, 2, 3), kinds (n,)."""
    vertices = np.asarray(surface.vertices)
    ends, tangents, normals, kinds = [], [np.zeros((0, 2, 3))], [], []
    for which in EdgeKind.CREASE, EdgeKind.BOUNDARY:
        own = np.flatnonzero(kind == which)
        for chain, members in chains_of(edges[own]):
            pieces = straight_pieces(vertices[chain], tolerance_m)
            knots = vertices[chain[[0, *(b for _, b in pieces)]]]
            if np.linalg.norm(np.diff(knots, axis=0), axis=1).sum() < min_length_m:
                continue
            tangents.append(tangents_along(knots))
            for a, b in pieces:
                ends.append(vertices[[chain[a], chain[b]]])
                # the order of the sides may differ from edge to edge
                two = sides[own[members[a:b]]]
                swapped = (two[:, 0] - two[:, 1]) @ (two[0, 0] - two[0, 1]) < 0.0
                normals.append(unit_rows(np.where(swapped[:, None, None], two[:, ::-1], two).mean(axis=0)))
                kinds.append(int(which))
    shape = (-1, 2, 3)
    return (
        np.array(ends).reshape(shape),
        np.concatenate(tangents),
        np.array(normals).reshape(shape),
        np.array(kinds, dtype=np.int64),
    )
