"""Rays against triangles, by embree: in single precision, so that the origin should be near the triangles."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from polhode.geometry.lie import Array, Bools, Ints


@dataclass(frozen=True)
class FirstHits:
    """The first hit of each of n rays."""

    face: Ints
    """(n,) -1 without a hit; the other values are meaningless there"""
    distance: Array
    """(n,) along the ray, in single precision"""
    u: Array
    """(n,) weight of the face's second corner"""
    v: Array
    """(n,) weight of the face's third corner"""


class RayScene:
    """Triangles in embree's hierarchy; no ray slips through between two that share an edge."""

    def __init__(self, triangles: ArrayLike, faces: Ints | None = None) -> None:
        """triangles (T, 3, 3); or with faces (T, 3) their vertices (V, 3): embree takes a third less time."""
        self._scene = EmbreeScene(robust=True)
        corners = _floats(triangles)
        if faces is not None and len(faces):
            TriangleMesh(self._scene, corners, np.ascontiguousarray(faces, dtype=np.int32))
        elif faces is None and len(corners):
            TriangleMesh(self._scene, corners)

    def first_hits(self, start: Array, direction: Array) -> FirstHits:
        """The nearest hits of rays from points (n, 3) along unit directions (n, 3)."""
        answer = self._scene.run(_floats(start), _floats(direction), output=True)
        floats = (np.asarray(answer[name], dtype=np.float64) for name in ("tfar", "u", "v"))
        return FirstHits(np.asarray(answer["primID"], dtype=np.int64), *floats)

    def blocked(self, start: ArrayLike, direction: ArrayLike, reach: ArrayLike | None = None) -> Bools:
        """(n,) whether rays (n, 3) hit anything within ``reach`` (n,); None: at any distance."""
        limits = () if reach is None else (_floats(reach),)
        found = self._scene.run(_floats(start), _floats(direction), *limits, query="OCCLUDED")
        return np.asarray(found >= 0)


def _floats(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)
