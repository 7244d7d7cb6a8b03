"""What a camera sees of a mesh: rays to points, depth maps for many points at once, rendered views."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.geometry.rays import RayScene

Floats = NDArray[np.float32]

MIN_COSINE = 0.15
"""Cosine to the normal below which, beyond 81 degrees, a point does not count as seen."""
CLEARANCE = 2e-3
"""Distance before its point at which a ray may end, relative to the body's size."""
_MAP_PIXELS = 160
"""Pixels along a side of such a map."""


@dataclass(frozen=True)
class FrameView:
    """One frame: the rectified left image and where the target was."""

    image: NDArray[np.uint8]
    """(h, w) rectified left image, or a part of it"""
    silhouette: Bools
    """(h, w) true on the target"""
    X_RG: Array
    """(4, 4) pose of the target in the rectified left camera"""
    R_NR: Array
    """(3, 3) axes of that camera in N"""
    u0: int = 0
    """column of the whole image at which the part begins"""
    v0: int = 0
    lit_above: float = 12.0
    """intensity above which a pixel shows light"""
    frame: int = 0
    """its number in the run"""

    @cached_property
    def smooth(self) -> Floats:
        """(h, w) means over 3 x 3 pixels."""
        return np.asarray(uniform_filter(self.image.astype(np.float32), 3))

    @property
    def eye_G(self) -> Array:
        """(3,) the camera in G [m]."""
        return np.asarray(inverse_pose(self.X_RG)[:3, 3])


def light_level(left: NDArray[np.uint8]) -> float:
    """Intensity above which a pixel of a left image shows light: well above the sky's."""
    # intensity above the sky's that counts as lit [8-bit levels]
    return float(np.percentile(left, 5)) + 12.0


class Caster:
    """Rays against a mesh in G, in single precision about the mesh's centre."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        self.middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self.radius_m = float(np.linalg.norm(vertices - self.middle, axis=1).max())
        self._scene = RayScene(vertices - self.middle, np.asarray(mesh.faces))

    def first(self, origin: Array, direction: Array) -> tuple[Array, Ints]:
        """Distance to the first hit (n,) [m], inf where there is none, and its face (n,), -1 where none.

        origin (n, 3) or (3,) [m]; direction (n, 3) of unit length.
        """
        if len(direction) == 0:
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        start = np.atleast_2d(origin) - self.middle
        # Start near the body: single precision is then enough at any range.
        skipped = np.maximum(np.linalg.norm(start, axis=1) - 1.5 * self.radius_m, 0.0)
        start = start + direction * skipped[:, None]
        hits = self._scene.first_hits(start, direction)
        return np.where(hits.face >= 0, hits.distance + skipped, np.inf), hits.face

    def sees(self, eye_G: Array, p_G: Array, normal_G: Array, clearance_m: float | None = None) -> Bools:
        """(n,) true where nothing occludes a point from the eye, and it is not seen edge-on.

        A ray may end ``clearance_m`` before its point. The cosine is not signed: sheets of a mesh are seen
        from both sides.
        """
        ray = p_G - eye_G
        distance = np.linalg.norm(ray, axis=1)
        direction = ray / np.maximum(distance, 1e-12)[:, None]
        cosine = np.abs(np.einsum("nk,nk->n", direction, normal_G))
        first, _ = self.first(eye_G, direction)
        clearance_m = 2.0 * CLEARANCE * self.radius_m if clearance_m is None else clearance_m
        return np.asarray((cosine > MIN_COSINE) & (first > distance - clearance_m))

    def lit_by(self, sun_G: Array, p_G: Array) -> Bools:
        """(n,) true where nothing occludes points (n, 3) from a distant light in the direction ``sun_G``."""
        step = 4.0 * CLEARANCE * self.radius_m
        direction = np.broadcast_to(sun_G, p_G.shape)
        first, _ = self.first(p_G + step * direction, direction)
        return ~np.isfinite(first)


class DepthPicture:
    """A coarse depth map of the mesh from a camera or a distant light: visibility of many points at once."""

    def __init__(self, caster: Caster, towards: Array, eye_G: Array | None = None) -> None:
        """Looks along ``towards`` (3,), from ``eye_G`` or, without, along parallel rays."""
        z = np.asarray(towards, dtype=np.float64) / np.linalg.norm(towards)
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
        x /= np.linalg.norm(x)
        self._axes = np.stack([x, np.cross(z, x), z], axis=1)
        self._eye = caster.middle if eye_G is None else np.asarray(eye_G, dtype=np.float64)
        self._parallel = eye_G is None
        # the same where a coarse depth map replaces the rays
        self._tolerance_m = 2.0 * 8e-3 * caster.radius_m
        reach = caster.radius_m
        if not self._parallel:
            distance = float(np.linalg.norm(caster.middle - self._eye))
            near = max(distance**2 - caster.radius_m**2, 1e-4 * distance**2)
            reach = caster.radius_m / float(np.sqrt(near))
        self._scale = 0.5 * (_MAP_PIXELS - 1) / reach
        centre = (np.arange(_MAP_PIXELS) - 0.5 * (_MAP_PIXELS - 1)) / self._scale
        x, y = (axis.reshape(-1) for axis in np.meshgrid(centre, centre))
        if self._parallel:
            far = 2.0 * caster.radius_m
            start = self._eye + np.stack([x, y, np.full_like(x, -far)], axis=1) @ self._axes.T
            found, _ = caster.first(start, np.broadcast_to(self._axes[:, 2], start.shape))
            depth = found - far
        else:
            ray = np.stack([x, y, np.ones_like(x)], axis=1)
            length = np.linalg.norm(ray, axis=1)
            found, _ = caster.first(self._eye, (ray / length[:, None]) @ self._axes.T)
            depth = found / length
        picture = depth.reshape(_MAP_PIXELS, _MAP_PIXELS).astype(np.float32)
        # A point is hidden only if all pixels around it are nearer: edges do not hide visible points.
        around = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)
        self._depth = maximum_filter(picture, footprint=around, mode="nearest").reshape(-1)

    def shows(self, p_G: Array | Floats) -> Bools:
        """(n,) true where points (n, 3) in G [m] are not hidden behind the mesh."""
        p = (p_G - self._eye.astype(p_G.dtype)) @ self._axes.astype(p_G.dtype)
        z = p[:, 2]
        flat = p[:, :2] if self._parallel else p[:, :2] / np.maximum(z, 1e-9)[:, None]
        cell = np.rint(flat * p.dtype.type(self._scale) + p.dtype.type(0.5 * (_MAP_PIXELS - 1)))
        column, row = cell.clip(0, _MAP_PIXELS - 1).astype(np.int32).T
        return np.asarray(z < self._depth[row * _MAP_PIXELS + column] + self._tolerance_m)


def pixels_of(view: FrameView, p_G: Array | Floats, rig: RectifiedRig) -> tuple[Ints, Ints, Bools]:
    """Row and column (n,) of the nearest pixels of the view, and whether they lie inside it (else 0)."""
    v, u = _projected(view, p_G, rig)
    row, column = np.rint(v), np.rint(u)
    height, width = view.image.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return (
        np.where(inside, row, 0.0).astype(np.int64),
        np.where(inside, column, 0.0).astype(np.int64),
        np.asarray(inside),
    )


def values_at(view: FrameView, image: Floats, p_G: Array | Floats, rig: RectifiedRig) -> tuple[Floats, Bools]:
    """What an image (h, w) of the view shows at points, between pixels (n,); whether inside (else 0)."""
    v, u = _projected(view, p_G, rig)
    height, width = image.shape
    inside = (v >= 0) & (v < height - 1) & (u >= 0) & (u < width - 1)
    v, u = np.where(inside, v, 0.0), np.where(inside, u, 0.0)
    row, column = v.astype(np.int64), u.astype(np.int64)
    down, right = (v - row).astype(np.float32), (u - column).astype(np.float32)
    flat, at = image.reshape(-1), row * width + column
    upper = flat[at] * (1.0 - right) + flat[at + 1] * right
    lower = flat[at + width] * (1.0 - right) + flat[at + width + 1] * right
    return np.where(inside, upper * (1.0 - down) + lower * down, np.float32(0.0)), np.asarray(inside)


def _projected(view: FrameView, p_G: Array | Floats, rig: RectifiedRig) -> tuple[Array, Array]:
    """Rows and columns (n,), not rounded; NaN behind the camera."""
    p = np.asarray(p_G @ view.X_RG[:3, :3].T.astype(p_G.dtype) + view.X_RG[:3, 3].astype(p_G.dtype))
    z = np.where(p[:, 2] > 1e-6, p[:, 2], np.nan)
    return (
        np.asarray(rig.focal_px * p[:, 1] / z + (rig.cy_px - view.v0)),
        np.asarray(rig.focal_px * p[:, 0] / z + (rig.cx_px - view.u0)),
    )


def sun_in_G(view: FrameView, sun_N: Array) -> Array:
    """A direction (3,) of N in G at this frame."""
    return np.asarray(view.X_RG[:3, :3].T @ (view.R_NR.T @ sun_N))


def towards_G(view: FrameView, p_G: Array) -> Array:
    """Unit vectors (n, 3) in G from points to the camera."""
    ray = view.eye_G - p_G
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


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
    """Renders one mesh, in its frame G [m], from any pose."""

    def __init__(self, mesh: trimesh.Trimesh, caster: Caster | None = None) -> None:
        """``caster``: of this mesh, if there is one already."""
        self._vertices = np.asarray(mesh.vertices, dtype=np.float64)
        self._faces = np.asarray(mesh.faces, dtype=np.int64)
        self._caster = (caster or Caster(mesh)) if len(self._faces) else None
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
    # A triangle seen exactly edge-on has no interior point: its first corner is used.
    scale = np.where(np.abs(volume) > 0.0, volume, np.inf)
    from_a = origin - a
    turned = np.cross(from_a, ab)
    b = (np.einsum("nk,nk->n", from_a, side) / scale).clip(0.0, 1.0)
    c = (np.einsum("nk,nk->n", ray, turned) / scale).clip(0.0, 1.0)
    travelled = np.einsum("nk,nk->n", ac, turned) / scale
    return travelled, np.stack([1.0 - b - c, b, c], axis=1), volume > 0.0


def directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere."""
    n = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * n / count), np.pi * (1.0 + 5.0**0.5) * n
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
