"""Exponential and logarithm of SO(3) for many rotations at once, compiled: ``polhode.geometry.lie`` for
inner loops.

``polhode.geometry.lie`` uses SciPy's general conversions, whose overhead dominates for a dozen rotations.
Arrays of any memory layout are taken, but copied to be contiguous, since the functions would be compiled for
each.
"""

import numpy as np

from polhode.geometry.lie import Array
from polhode.runtime.compiled import compiled

SMALL_RAD = 1e-3
"""Below this angle series to the 4th order replace quotients, with errors of 1e-14."""


@compiled
def _fill(out: Array, x: float, y: float, z: float, a: float, b: float) -> None:
    """I + a hat + b hat^2 of (x, y, z) into out (3, 3)."""
    out[0, 0], out[1, 1], out[2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (x * x + z * z),
        1.0 - b * (x * x + y * y),
    )
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


def rotation_matrices(theta: Array) -> Array:
    """Rotation vectors [rad] (n, 3) -> matrices (n, 3, 3)."""
    return contiguous_rotation_matrices(np.ascontiguousarray(theta))


@compiled
def contiguous_rotation_matrices(theta: Array) -> Array:
    """``rotation_matrices`` of a contiguous array, for compiled loops."""
    out = np.empty((len(theta), 3, 3))
    for n in range(len(theta)):
        x, y, z = theta[n, 0], theta[n, 1], theta[n, 2]
        s = x * x + y * y + z * z
        angle = np.sqrt(s)
        if angle < SMALL_RAD:
            a, b = 1.0 - s / 6.0 + s * s / 120.0, 0.5 - s / 24.0 + s * s / 720.0
        else:
            a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / s
        _fill(out[n], x, y, z, a, b)
    return out


@compiled
def matrices_from_quaternions(q: Array) -> Array:
    """Quaternions (n, 4), scalar first, of any length -> matrices (n, 3, 3)."""
    out = np.empty((len(q), 3, 3))
    for n in range(len(q)):
        w, x, y, z = q[n, 0], q[n, 1], q[n, 2], q[n, 3]
        k = 2.0 / (w * w + x * x + y * y + z * z)
        out[n, 0, 0], out[n, 1, 1], out[n, 2, 2] = (
            1.0 - k * (y * y + z * z),
            1.0 - k * (x * x + z * z),
            1.0 - k * (x * x + y * y),
        )
        out[n, 0, 1], out[n, 1, 0] = k * (x * y - w * z), k * (x * y + w * z)
        out[n, 0, 2], out[n, 2, 0] = k * (x * z + w * y), k * (x * z - w * y)
        out[n, 1, 2], out[n, 2, 1] = k * (y * z - w * x), k * (y * z + w * x)
    return out


@compiled
def rotation_vectors(R: Array) -> Array:
    """Matrices (n, 3, 3) -> rotation vectors [rad] (n, 3), angle in [0, pi].

    By the largest component of the quaternion: exact near half a turn too.
    """
    out = np.empty((len(R), 3))
    q = np.empty(4)
    for n in range(len(R)):
        trace = R[n, 0, 0] + R[n, 1, 1] + R[n, 2, 2]
        largest, best = 0, trace
        for i in range(3):
            if R[n, i, i] > best:
                largest, best = i + 1, R[n, i, i]
        if largest == 0:
            q[0] = 1.0 + trace
            q[1], q[2], q[3] = R[n, 2, 1] - R[n, 1, 2], R[n, 0, 2] - R[n, 2, 0], R[n, 1, 0] - R[n, 0, 1]
        else:
            i = largest - 1
            j, k = (i + 1) % 3, (i + 2) % 3
            q[0] = R[n, k, j] - R[n, j, k]
            q[1 + i] = 1.0 + R[n, i, i] - R[n, j, j] - R[n, k, k]
            q[1 + j], q[1 + k] = R[n, j, i] + R[n, i, j], R[n, k, i] + R[n, i, k]
        if q[0] < 0.0:
            for i in range(4):
                q[i] = -q[i]
        v = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
        scale = 2.0 * np.arctan2(v, q[0]) / v if v > 0.0 else 0.0
        for i in range(3):
            out[n, i] = scale * q[1 + i]
    return out


def right_jacobians(theta: Array) -> Array:
    """``Exp(theta + d) ~ Exp(theta) Exp(Jr(theta) d)``: (n, 3) -> (n, 3, 3)."""
    return contiguous_right_jacobians(np.ascontiguousarray(theta))


def inverse_right_jacobians(theta: Array) -> Array:
    """``Log(R Exp(d)) ~ Log(R) + Jr^-1 d`` at theta = Log(R) (n, 3), below a revolution -> (n, 3, 3)."""
    return _inverse_right_jacobians(np.ascontiguousarray(theta))


@compiled
def contiguous_right_jacobians(theta: Array) -> Array:
    """``right_jacobians`` of a contiguous array, for compiled loops: I - a hat + b hat^2."""
    out = np.empty((len(theta), 3, 3))
    for n in range(len(theta)):
        x, y, z = theta[n, 0], theta[n, 1], theta[n, 2]
        s = x * x + y * y + z * z
        angle = np.sqrt(s)
        if angle < 10.0 * SMALL_RAD:
            a, b = 0.5 - s / 24.0 + s * s / 720.0, 1.0 / 6.0 - s / 120.0 + s * s / 5040.0
        else:
            a, b = (1.0 - np.cos(angle)) / s, (angle - np.sin(angle)) / (s * angle)
        _fill(out[n], x, y, z, -a, b)
    return out


@compiled
def _inverse_right_jacobians(theta: Array) -> Array:
    """I + hat / 2 + c hat^2"""
    out = np.empty((len(theta), 3, 3))
    for n in range(len(theta)):
        x, y, z = theta[n, 0], theta[n, 1], theta[n, 2]
        s = x * x + y * y + z * z
        angle = np.sqrt(s)
        if angle < 10.0 * SMALL_RAD:
            c = 1.0 / 12.0 + s / 720.0 + s * s / 30240.0
        else:
            c = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / s
        _fill(out[n], x, y, z, 0.5, c)
    return out
