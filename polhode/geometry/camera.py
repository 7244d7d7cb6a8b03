"""The rectified stereo camera: one pinhole, one baseline (thesis eqs. 4.83-4.85 after rectification).

Pixels are (u, v) with integer coordinates at pixel centres. A stereo measurement is
``uvd = (u_left, v, disparity)`` with ``disparity = u_left - u_right`` [px].
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.lie import Array


@dataclass(frozen=True)
class RectifiedRig:
    """Rectified stereo pair; frame R is the rectified left camera (x right, y down, z forward)."""

    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    width_px: int
    height_px: int
    disparity_offset_px: float = 0.0
    """Difference of the principal points cx_left - cx_right; disparity = f b / z + offset."""

    @property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3) [px]."""
        f = self.focal_px
        return np.array([[f, 0.0, self.cx_px], [0.0, f, self.cy_px], [0.0, 0.0, 1.0]])

    def project(self, p_R: ArrayLike) -> Array:
        """Points (..., 3) [m] in the rectified left camera -> uvd (..., 3) [px]."""
        p = np.asarray(p_R, dtype=np.float64)
        z = p[..., 2]
        u = self.focal_px * p[..., 0] / z + self.cx_px
        v = self.focal_px * p[..., 1] / z + self.cy_px
        d = self.focal_px * self.baseline_m / z + self.disparity_offset_px
        return np.stack([u, v, d], axis=-1)

    def triangulate(self, uvd_px: ArrayLike) -> Array:
        """uvd (..., 3) [px] -> points (..., 3) [m] in the rectified left camera."""
        uvd = np.asarray(uvd_px, dtype=np.float64)
        z = self.focal_px * self.baseline_m / (uvd[..., 2] - self.disparity_offset_px)
        x = (uvd[..., 0] - self.cx_px) * z / self.focal_px
        y = (uvd[..., 1] - self.cy_px) * z / self.focal_px
        return np.stack([x, y, z], axis=-1)

    def metres_per_px(self, depth_m: Array) -> Array:
        """Displacement (n, 2) [m/px] of points at depths (n,) by a pixel in the image, and of disparity."""
        along = depth_m**2 / (self.focal_px * self.baseline_m)
        return np.column_stack([depth_m / self.focal_px, along])

    def triangulation_jacobian(self, p_R: ArrayLike) -> Array:
        """d p_R / d uvd (..., 3, 3) [m/px] at points (..., 3) [m]: carries pixel noise into metres."""
        p = np.asarray(p_R, dtype=np.float64)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        f, dz = self.focal_px, -(p[..., 2] ** 2) / (self.focal_px * self.baseline_m)
        zero = np.zeros_like(z)
        rows = [
            np.stack([z / f, zero, x / z * dz], axis=-1),
            np.stack([zero, z / f, y / z * dz], axis=-1),
            np.stack([zero, zero, dz], axis=-1),
        ]
        return np.stack(rows, axis=-2)


def stereo_jacobian(p_R: Array, focal_px: float, baseline_m: float) -> Array:
    """d uvd / d p_R (n, 3, 3) [px/m] at points (n, 3) [m] in the rectified left camera."""
    x, y, z = p_R.T
    f = focal_px
    out = np.zeros((len(p_R), 3, 3))
    out[:, 0, 0] = out[:, 1, 1] = f / z
    out[:, 0, 2], out[:, 1, 2], out[:, 2, 2] = -f * x / z**2, -f * y / z**2, -f * baseline_m / z**2
    return out
