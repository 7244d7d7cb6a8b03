"""The equidistant fisheye lens: rays to pixels and back, up to behind the camera.

A ray at an angle theta from the optical axis is seen at the distance
theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) from the principal point, in focal lengths.
Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and fish-eye
lenses", IEEE PAMI 28(8), 2006; OpenCV's and Kalibr's parameters.
"""

import numpy as np

from polhode.geometry.lie import Array


def widest_angle_rad(k: Array) -> float:
    """Up to this angle from the axis the image of a ray moves outwards with the angle; pi at most."""
    square = np.roots([9 * k[3], 7 * k[2], 5 * k[1], 3 * k[0], 1.0])
    turning = square.real[(np.abs(square.imag) < 1e-9 * (1.0 + np.abs(square.real))) & (square.real > 0)]
    return float(min(np.sqrt(turning.min()), np.pi)) if len(turning) else float(np.pi)


def radius(theta_rad: Array, k: Array) -> Array:
    """Distance from the principal point (n,), in focal lengths, at angles (n,) from the axis."""
    x = theta_rad * theta_rad
    return np.asarray(theta_rad * (1.0 + x * (k[0] + x * (k[1] + x * (k[2] + x * k[3])))))


def project(p_K: Array, K: Array, k: Array) -> Array:
    """Points (n, 3) in the camera -> pixels (n, 2); NaN beyond ``widest_angle_rad``, where nothing is seen.

    K (3, 3) intrinsic matrix [px], k (4,).
    """
    across = np.hypot(p_K[:, 0], p_K[:, 1])
    theta = np.arctan2(across, p_K[:, 2])
    share = np.where(across > 0, radius(theta, k) / np.maximum(across, 1e-300), 0.0)
    share = np.where(theta <= widest_angle_rad(k), share, np.nan)
    return np.asarray(p_K[:, :2] * share[:, None] * K[[0, 1], [0, 1]] + K[:2, 2])


def rays(uv_px: Array, K: Array, k: Array) -> Array:
    """Pixels (n, 2) -> unit rays (n, 3) in the camera; NaN beyond ``widest_angle_rad``."""
    flat = (uv_px - K[:2, 2]) / K[[0, 1], [0, 1]]
    distance = np.hypot(flat[:, 0], flat[:, 1])
    theta = _angle(distance, k)
    share = np.where(distance > 0, np.sin(theta) / np.maximum(distance, 1e-300), 0.0)
    return np.column_stack([flat * share[:, None], np.cos(theta)])


def _angle(distance: Array, k: Array) -> Array:
    """Angles (n,) of ``radius``, by Newton's method from a table; NaN where there is none."""
    table = np.linspace(0.0, widest_angle_rad(k), 2048)
    at = radius(table, k)
    theta = np.interp(distance, at, table)
    for _ in range(6):
        x = theta * theta
        slope = 1.0 + x * (3 * k[0] + x * (5 * k[1] + x * (7 * k[2] + x * 9 * k[3])))
        step = (radius(theta, k) - distance) / np.maximum(slope, 1e-9)
        theta = np.clip(theta - step, 0.0, table[-1])
    return np.where(distance <= at[-1], theta, np.nan)
