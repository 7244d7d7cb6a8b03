"""Lens models and their derivatives: pinholes with Brown's distortion, and the equidistant fisheye.

The values of a lens are one vector: fu, fv, cu, cv [px], then the coefficients in OpenCV's order. Brown,
"Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, with the rational radial part of
OpenCV for eight coefficients; the fisheye is that of polhode/geometry/fisheye.py.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from polhode.geometry import fisheye
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

Model = Literal["brown5", "brown8", "fisheye"]
COEFFICIENTS: dict[Model, tuple[str, ...]] = {
    "brown5": ("k1", "k2", "p1", "p2", "k3"),
    "brown8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True)
class Lens:
    """A lens of one of the models."""

    model: Model
    values: Array
    """(4 + n,) fu, fv, cu, cv [px], and n coefficients"""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the values."""
        return ("fu", "fv", "cu", "cv", *COEFFICIENTS[self.model])

    @property
    def K(self) -> Array:
        """(3, 3) intrinsic matrix [px]."""
        fu, fv, cu, cv = self.values[:4]
        return np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]])

    @property
    def coefficients(self) -> Array:
        """(n,)"""
        return self.values[4:]

    @property
    def is_fisheye(self) -> bool:
        """Whether it is an equidistant fisheye."""
        return self.model == "fisheye"

    @property
    def prior_sigmas(self) -> Array:
        """(4 + n,) standard deviations of the prior of the values about 0; infinite: none."""
        # Prior of the coefficients k4, k5 and k6 about 0: a numerator and a denominator can grow together
        # without a trace in the image, and only their difference is determined
        return np.array(
            [1.0 if name in ("k4", "k5", "k6") and not self.is_fisheye else np.inf for name in self.names]
        )

    def moved(self, step: Array) -> "Lens":
        """The lens with changed values."""
        return replace(self, values=self.values + step)


def model_named(option: str, name: str) -> Model:
    """The model that an option names. Raises InputError."""
    for model in COEFFICIENTS:
        if model == name:
            return model
    raise InputError(f"{option} {name[:40]}: choose one of {', '.join(COEFFICIENTS)}")


def without_distortion(model: Model, focal_px: float, size_px: tuple[int, int]) -> Lens:
    """A lens with this focal length, its principal point in the middle of the image."""
    width, height = size_px
    start = [focal_px, focal_px, 0.5 * (width - 1), 0.5 * (height - 1)]
    return Lens(model, np.array([*start, *np.zeros(len(COEFFICIENTS[model]))]))


def project(lens: Lens, p_C: Array) -> Array:
    """Points (n, 3) in the camera -> pixels (n, 2); NaN behind a pinhole."""
    return project_with_derivatives(lens, p_C)[0]


def project_with_derivatives(lens: Lens, p_C: Array) -> tuple[Array, Array, Array]:
    """Points (n, 3) -> pixels (n, 2), their derivatives by the point (n, 2, 3) and by the values (n, 2, k).

    NaN behind a pinhole.
    """
    if lens.is_fisheye:
        flat, by_point, by_coefficient = _fisheye(lens.coefficients, p_C)
    else:
        flat, by_point, by_coefficient = _brown(lens.coefficients, p_C)
    focal = lens.values[:2]
    n = len(p_C)
    by_values = np.zeros((n, 2, len(lens.values)))
    by_values[:, 0, 0], by_values[:, 1, 1] = flat[:, 0], flat[:, 1]
    by_values[:, 0, 2] = by_values[:, 1, 3] = 1.0
    by_values[:, :, 4:] = focal[:, None] * by_coefficient
    return flat * focal + lens.values[2:4], focal[:, None] * by_point, by_values


def _brown(k: Array, p_C: Array) -> tuple[Array, Array, Array]:
    """Distorted normalized coordinates (n, 2), by the point (n, 2, 3), by the coefficients (n, 2, 5 or 8)."""
    depth = np.where(p_C[:, 2] > 0.0, p_C[:, 2], np.nan)
    x, y = p_C[:, 0] / depth, p_C[:, 1] / depth
    r2 = x * x + y * y
    k1, k2, p1, p2, k3 = k[:5]
    k4, k5, k6 = k[5:8] if len(k) == 8 else (0.0, 0.0, 0.0)
    above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    # by r^2
    slope = (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2) - radial * (k4 + r2 * (2.0 * k5 + 3.0 * k6 * r2))) / below
    flat = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=1,
    )
    J = np.empty((len(x), 2, 2))
    J[:, 0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    J[:, 0, 1] = J[:, 1, 0] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    J[:, 1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_point = np.empty((len(x), 2, 3))
    by_point[:, :, :2] = J / depth[:, None, None]
    by_point[:, :, 2] = -(J[:, :, 0] * x[:, None] + J[:, :, 1] * y[:, None]) / depth[:, None]
    xy = np.stack([x, y], axis=1)
    by_k = np.empty((len(x), 2, len(k)))
    for column, power in ((0, 1), (1, 2), (4, 3)):
        by_k[:, :, column] = xy * (r2**power / below)[:, None]
    by_k[:, 0, 2], by_k[:, 1, 2] = 2.0 * x * y, r2 + 2.0 * y * y
    by_k[:, 0, 3], by_k[:, 1, 3] = r2 + 2.0 * x * x, 2.0 * x * y
    for power in range(1, len(k) - 4):
        by_k[:, :, 4 + power] = -xy * (radial * r2**power / below)[:, None]
    return flat, by_point, by_k


def normalized_by_newton(lens: Lens, uv_px: Array) -> Array:
    """Pixels (n, 2) of a pinhole -> where their rays meet the plane z = 1, (n, 2); NaN: nowhere."""
    flat = (uv_px - lens.values[2:4]) / lens.values[:2]
    xy = flat.copy()
    for _ in range(12):
        at, J, _ = _brown(lens.coefficients, np.column_stack([xy, np.ones(len(xy))]))
        a, b, c, d = J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1]
        off = flat - at
        det = a * d - b * c
        # below this determinant the image folds over itself
        det = np.where(np.abs(det) > 1e-6, det, np.nan)
        step = np.column_stack([d * off[:, 0] - b * off[:, 1], a * off[:, 1] - c * off[:, 0]]) / det[:, None]
        xy = xy + step
    missed = np.abs(_brown(lens.coefficients, np.column_stack([xy, np.ones(len(xy))]))[0] - flat) > 1e-9
    return np.asarray(np.where(missed.any(axis=1, keepdims=True), np.nan, xy))


def _fisheye(k: Array, p_C: Array) -> tuple[Array, Array, Array]:
    """The same for the fisheye, (n, 2), (n, 2, 3), (n, 2, 4)."""
    xy, z = p_C[:, :2], p_C[:, 2]
    square = (p_C * p_C).sum(axis=1)
    # sine of the angle below which a ray is taken to be on the axis
    rho = np.maximum(np.hypot(xy[:, 0], xy[:, 1]), 1e-9 * np.sqrt(square))
    theta = np.arctan2(rho, z)
    t2 = theta * theta
    powers = theta[:, None] * np.stack([t2, t2**2, t2**3, t2**4], axis=1)
    radius = theta + powers @ k
    slope = 1.0 + np.stack([t2, t2**2, t2**3, t2**4], axis=1) @ (np.array([3.0, 5.0, 7.0, 9.0]) * k)
    share = radius / rho
    along = xy / rho[:, None]
    # derivatives of share: across the axis through rho and theta, along it through theta alone
    across = slope * z / square / rho - share / rho
    by_point = np.empty((len(z), 2, 3))
    by_point[:, :, :2] = share[:, None, None] * np.eye(2) + np.einsum(
        "ni,nj->nij", xy, along * across[:, None]
    )
    by_point[:, :, 2] = -xy * (slope / square)[:, None]
    by_k = along[:, :, None] * powers[:, None, :]
    return xy * share[:, None], by_point, by_k


def rays(lens: Lens, uv_px: Array) -> Array:
    """Unit rays (n, 3) of pixels (n, 2); NaN: there is none."""
    if lens.is_fisheye:
        return fisheye.rays(uv_px, lens.K, lens.coefficients)
    flat = normalized_by_newton(lens, uv_px)
    ray = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))
