"""Edges of a mesh joined into chains of vertices, and chains cut into straight pieces."""

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from polhode.lie import Array
from polhode.records import Bools, Ints


def chains_of(edges: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Maximal chains of edges (m, 2): vertices (k + 1,) and the edges between them (k,).

    A chain ends where an edge ends or where three or more meet. A closed one returns to its first vertex.
    """
    at: dict[int, list[int]] = defaultdict(list)
    for number, (a, b) in enumerate(edges.tolist()):
        at[a].append(number)
        at[b].append(number)
    used = np.zeros(len(edges), dtype=bool)
    knots = [vertex for vertex, around in at.items() if len(around) != 2]
    for vertex in [*sorted(knots), *edges[:, 0].tolist()]:
        for number in at[vertex]:
            if not used[number]:
                yield _follow(edges, at, used, vertex, number)


def _follow(
    edges: Ints, at: dict[int, list[int]], used: Bools, vertex: int, number: int
) -> tuple[Ints, Ints]:
    """Walk from a vertex along an unused edge to the chain's end."""
    chain, members = [vertex], []
    while True:
        used[number] = True
        members.append(number)
        a, b = edges[number].tolist()
        vertex = b if a == vertex else a
        chain.append(vertex)
        onward = [n for n in at[vertex] if not used[n]]
        if len(at[vertex]) != 2 or not onward:
            return np.array(chain), np.array(members)
        number = onward[0]


def straight_pieces(points: Array, tolerance_m: float) -> list[tuple[int, int]]:
    """Cut a chain (k, 3) into pieces straight to the tolerance: index of first and last point.

    Douglas and Peucker, Cartographica 10, 1973. A closed chain is first cut at the point farthest from its
    first one.
    """
    last = len(points) - 1
    if np.array_equal(points[0], points[last]):
        far = int(np.argmax(np.linalg.norm(points - points[0], axis=1)))
        open_pieces = [(0, far), (far, last)]
    else:
        open_pieces = [(0, last)]
    done: list[tuple[int, int]] = []
    while open_pieces:
        a, b = open_pieces.pop()
        if b <= a:
            continue
        middle, off = _farthest(points, a, b)
        if off <= tolerance_m:
            done.append((a, b))
        else:
            open_pieces += [(a, middle), (middle, b)]
    return sorted(done)


def _farthest(points: Array, a: int, b: int) -> tuple[int, float]:
    """Index of the point between a and b farthest from their line, and its distance [m]."""
    if b - a < 2:
        return a, 0.0
    along = points[b] - points[a]
    length = float(np.linalg.norm(along))
    away = points[a + 1 : b] - points[a]
    if length < 1e-12:
        off = np.linalg.norm(away, axis=1)
    else:
        off = np.linalg.norm(np.cross(away, along / length), axis=1)
    at = int(np.argmax(off))
    return a + 1 + at, float(off[at])


ROUND_TURN_DEG = 30.0
"""Consecutive pieces with a smaller angle between them, and of similar length, approximate an arc."""
ROUND_LENGTHS = 3.0
"""Largest ratio of the lengths of consecutive pieces of an arc."""


def tangents_along(knots: Array) -> Array:
    """Directions (k, 2, 3) of a chain at both ends of its k pieces, from its knots (k + 1, 3).

    Along an arc the tangent at a knot is that of the circle through three knots; otherwise the corners of the
    polygon that approximates a circle would make the rotation about its axis observable, which it is not. At
    real corners and beside long straight pieces the tangent is the piece's own direction.
    """
    pieces = np.diff(knots, axis=0)
    length = np.linalg.norm(pieces, axis=1)
    along = pieces / np.maximum(length, 1e-12)[:, None]
    tangents = np.stack([along, along], axis=1)
    closed = len(pieces) > 2 and bool(np.array_equal(knots[0], knots[-1]))
    before = np.arange(len(pieces)) if closed else np.arange(len(pieces) - 1)
    after = (before + 1) % len(pieces)
    turn = np.einsum("kc,kc->k", along[before], along[after])
    like = np.maximum(length[before], length[after]) <= ROUND_LENGTHS * np.minimum(
        length[before], length[after]
    )
    round_ = (turn > np.cos(np.radians(ROUND_TURN_DEG))) & like
    before, after = before[round_], after[round_]
    tangent = along[before] * length[after, None] + along[after] * length[before, None]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    tangents[before, 1] = tangent
    tangents[after, 0] = tangent
    return tangents
