"""What a camera sees of a mesh: rays cast with embree, values of the vertices interpolated where they hit."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from polhode.camera import RectifiedRig
from polhode.lie import Array, inverse_pose
from polhode.mapping.visibility import Caster
from polhode.records import Bools, Ints


@dataclass(frozen=True)
class MeshView:
    """The first hit of a grid of rays."""

    depth_m: Array
    """(H, W) along the viewing direction, in perspective from the camera; NaN where no ray hits"""
    corner: Ints
    """(n, 3) for each ray that hits, the vertices of its triangle"""
    share: Array
    """(n, 3) barycentric coordinates there"""
    front: Bools
    """(n,) whether the ray meets the triangle's outer side; through a hole it meets an inner one"""

    @property
    def hit(self) -> Bools:
        """(H, W) the silhouette."""
        return np.isfinite(self.depth_m)

    def values(self, per_vertex: ArrayLike, background: float = 0.0) -> Array:
        """Values (V,) or (V, c) of the vertices, interpolated: (H, W) or (H, W, c)."""
        given = np.asarray(per_vertex, dtype=np.float64)
        out = np.full((*self.depth_m.shape, *given.shape[1:]), background)
        out[self.hit] = np.einsum("nk,nk...->n...", self.share, given[self.corner])
        return out


class MeshViewer:
    """Looks at one mesh, in its frame G [m], from many places."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._vertices = np.asarray(mesh.vertices, dtype=np.float64)
        self._faces = np.asarray(mesh.faces, dtype=np.int64)
        self._caster = Caster(mesh) if len(self._faces) else None
        used = self._vertices[self._faces].reshape(-1, 3) if len(self._faces) else np.zeros((1, 3))
        low, high = used.min(axis=0), used.max(axis=0)
        self._centre, self._radius_m = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))

    def perspective(self, rig: RectifiedRig, X_RG: Array, u_px: ArrayLike, v_px: ArrayLike) -> MeshView:
        """Through the rectified left camera at pixels of columns u (W,) and rows v (H,), of any spacing."""
        u, v = np.meshgrid(np.asarray(u_px, dtype=np.float64), np.asarray(v_px, dtype=np.float64))
        x, y = (u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px
        ray_R = np.stack([x, y, np.ones_like(x)], axis=-1)
        X_GR = inverse_pose(X_RG)
        ray_G = ray_R.reshape(-1, 3) @ X_GR[:3, :3].T
        return self._cast(np.broadcast_to(X_GR[:3, 3], ray_G.shape), ray_G, 0.0, u.shape)

    def orthographic(
        self, centre_G: ArrayLike, right_G: ArrayLike, up_G: ArrayLike, half_m: float, side_px: int
    ) -> MeshView:
        """By parallel rays: a square of 2 ``half_m`` about the centre, ``right_G`` to the right, ``up_G`` up.

        Depth counts from the plane through the centre, away from the eye.
        """
        right, up = np.asarray(right_G, dtype=np.float64), np.asarray(up_G, dtype=np.float64)
        place = half_m * ((2.0 * np.arange(side_px) + 1.0) / side_px - 1.0)
        x, y = np.meshgrid(place, -place)
        inwards = np.cross(up, right)
        away = self._radius_m + float(np.linalg.norm(np.asarray(centre_G) - self._centre))
        plane = np.asarray(centre_G) + x.reshape(-1, 1) * right + y.reshape(-1, 1) * up
        ray = np.broadcast_to(inwards, plane.shape)
        return self._cast(plane - away * inwards, ray, -away, x.shape)

    def _cast(self, origin: Array, ray: Array, start: float, shape: tuple[int, ...]) -> MeshView:
        """Rays (n, 3) [m]; ``start`` is the depth of their origins in lengths of the ray."""
        depth = np.full(len(origin), np.nan)
        if self._caster is None:
            none = np.zeros((0, 3))
            return MeshView(depth.reshape(shape), none.astype(np.int64), none, np.zeros(0, dtype=bool))
        _, first = self._caster.first(origin, ray / np.linalg.norm(ray, axis=1, keepdims=True))
        at = np.flatnonzero(first >= 0)
        corner = self._faces[first[at]]
        travelled, share, front = _meet(origin[at], ray[at], self._vertices[corner])
        depth[at] = start + travelled
        return MeshView(depth.reshape(shape), corner, share, front)


def _meet(origin: Array, ray: Array, triangle: Array) -> tuple[Array, Array, Bools]:
    """Where rays (n, 3) meet their triangles (n, 3, 3), in double precision (Moeller and Trumbore 1997).

    Returns lengths of the ray (n,), barycentric coordinates (n, 3) and whether it comes from outside (n,).
    """
    a = triangle[:, 0]
    ab, ac = triangle[:, 1] - a, triangle[:, 2] - a
    side = np.cross(ray, ac)
    volume = np.einsum("nk,nk->n", ab, side)
    # A triangle seen exactly edge-on has no inside: its first corner stands for it.
    scale = np.where(np.abs(volume) > 0.0, volume, np.inf)
    from_a = origin - a
    turned = np.cross(from_a, ab)
    b = (np.einsum("nk,nk->n", from_a, side) / scale).clip(0.0, 1.0)
    c = (np.einsum("nk,nk->n", ray, turned) / scale).clip(0.0, 1.0)
    travelled = np.einsum("nk,nk->n", ac, turned) / scale
    return travelled, np.stack([1.0 - b - c, b, c], axis=1), volume > 0.0
