"""The stereo rig (intrinsics, poses, rays of all samples of a pixel) and its sensor (light to grey values).

Pixel centres are integers. Distortion is inverted numerically, so that images have the exact distortion.
Grey values are in DN, 1/255 of full scale, whatever the number of bits.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from polhode.config import scene_settings as config
from polhode.geometry import fisheye
from polhode.geometry.lie import Array, Ints, exp_so3, make_pose
from polhode.runtime.compiled import compiled
from polhode.runtime.errors import InputError

# Chosen by search: uncorrelated with the position across and down the pixel (0.4 at most for 4 samples, the
# optimum for four), and with successive samples far apart in the pixel.
_TIME_ORDER = {
    1: (0,),
    4: (0, 2, 3, 1),
    9: (0, 6, 2, 8, 5, 7, 4, 1, 3),
    16: (3, 6, 10, 12, 14, 4, 7, 2, 11, 13, 8, 1, 0, 5, 15, 9),
}


NOT_INVERTIBLE = "scene.rig.distortion cannot be inverted over the whole image: use smaller coefficients"


@dataclass(frozen=True)
class Camera:
    """A pinhole with radial-tangential distortion, or an equidistant fisheye."""

    K: Array
    """(3, 3) [px]"""
    dist: Array
    """(4,) k1, k2, p1, p2; of a fisheye k1, k2, k3, k4"""
    X_CK: Array
    """(4, 4) pose of this camera in the left one"""
    width_px: int
    height_px: int
    fisheye: bool = False

    @property
    def distorted(self) -> bool:
        """Whether straight lines are seen bent."""
        return self.fisheye or bool(self.dist.any())

    @cached_property
    def pixel_directions(self) -> Array:
        """Unit rays through the pixel centres (H*W, 3), row by row, in this camera."""
        return self.directions(self.pixel_grid().reshape(-1, 2))

    def pixel_grid(self, step: int = 1) -> Array:
        """Pixel centres (H, W, 2), or every ``step``-th row and column of them."""
        v, u = np.mgrid[: self.height_px : step, : self.width_px : step]
        return np.stack([u, v], axis=-1).astype(np.float64)

    def directions(self, uv_px: Array) -> Array:
        """Pixels (n, 2) -> unit rays (n, 3) in this camera.

        Raises InputError where the distortion is not invertible: no direction, or two, map to a point.
        """
        if self.fisheye:
            rays = fisheye.rays(uv_px, self.K, self.dist)
            if np.isnan(rays).any():
                raise InputError(NOT_INVERTIBLE)
            return rays
        flat = (uv_px - self.K[:2, 2]) / self.K[[0, 1], [0, 1]]
        if self.dist.any():
            flat, folded = _inverted(np.ascontiguousarray(flat), *self.dist)
            if folded:
                raise InputError(NOT_INVERTIBLE)
        rays = np.column_stack([flat, np.ones(len(uv_px))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    @cached_property
    def half_angle_rad(self) -> float:
        """Angle between the optical axis and the image's farthest corner."""
        right, bottom = self.width_px - 0.5, self.height_px - 0.5
        corners = np.array([[-0.5, -0.5], [right, -0.5], [-0.5, bottom], [right, bottom]])
        return float(np.arccos(self.directions(corners)[:, 2].min()))

    def project_visible(self, p_K: Array, margin_px: float = 0.0) -> tuple[Array, Ints]:
        """Points (n, 3) -> pixels (m, 2) of those in the image or within a margin of it, and their indices.

        Directions far outside the image, which the distortion folds back into it, are left out.
        """
        widest = fisheye.widest_angle_rad(self.dist) if self.fisheye else np.pi / 2
        wide = min(self.half_angle_rad + margin_px / self.K[0, 0], widest - 1e-3)
        ahead = np.flatnonzero(p_K[:, 2] > np.cos(wide) * np.linalg.norm(p_K, axis=1))
        if len(ahead) == 0:
            return np.empty((0, 2)), ahead
        uv = self.project(p_K[ahead])
        inside = (uv > -0.5 - margin_px).all(axis=1)
        inside &= (uv < np.array([self.width_px, self.height_px]) - 0.5 + margin_px).all(axis=1)
        return uv[inside], ahead[inside]

    def project(self, p_K: Array) -> Array:
        """Points (n, 3) [m] in this camera -> pixels (n, 2), distorted."""
        if self.fisheye:
            return fisheye.project(p_K, self.K, self.dist)
        uv, _ = cv2.projectPoints(np.ascontiguousarray(p_K), np.zeros(3), np.zeros(3), self.K, self.dist)
        return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


@compiled
def _inverted(distorted: Array, k1: float, k2: float, p1: float, p2: float) -> tuple[Array, bool]:
    """Newton's iteration from the distorted points; true if the Jacobian's determinant reaches zero."""
    points = distorted.copy()
    for n in range(len(points)):
        x, y = distorted[n]
        for _ in range(50):
            r2 = x * x + y * y
            radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * r2 * k2)
            off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - distorted[n, 0]
            off_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - distorted[n, 1]
            xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            determinant = xx * yy - xy * xy
            if not (determinant > 1e-6 and xx > 0.0):
                return points, True
            step_x, step_y = (yy * off_x - xy * off_y) / determinant, (xx * off_y - xy * off_x) / determinant
            x, y = x - step_x, y - step_y
            if abs(step_x) + abs(step_y) < 1e-12:
                break
        else:
            return points, True
        points[n] = x, y
    return points, False


def sample_offsets(samples: int) -> Array:
    """Positions (samples, 2) of the samples in a pixel [px]: a rotated grid, one sample a row and column."""
    side = round(np.sqrt(samples))
    i, j = (index.ravel() for index in np.mgrid[:side, :side])
    u, v = (i + (j + 0.5) / side) / side - 0.5, (j + (side - i - 0.5) / side) / side - 0.5
    return np.stack([u, v], axis=1).astype(np.float64)


def sample_times(samples: int) -> Array:
    """Time of each of ``sample_offsets`` (samples,) as a share of the exposure, in (-1/2, 1/2)."""
    return (np.array(_TIME_ORDER[samples]) + 0.5) / samples - 0.5


def build_cameras(rig: config.Rig) -> tuple[Camera, Camera]:
    """Left and right camera of the rig."""
    offset = np.array(rig.principal_offset_px)
    dist = np.array(rig.distortion)
    right_dist = dist if rig.distortion_right is None else np.array(rig.distortion_right)
    p_right = np.array([rig.baseline_m, 0.0, 0.0]) + np.array(rig.right_offset_mm) * 1e-3
    X_right = make_pose(exp_so3(np.deg2rad(rig.right_rotation_deg)), p_right)
    left_size = rig.width_px, rig.height_px
    right_size = rig.right_size_px or left_size
    right_focal_px = rig.focal_px if rig.right_focal_px is None else rig.right_focal_px
    bent = rig.lens == "equidistant"

    def K(focal_px: float, size_px: tuple[int, int], offset_px: Array) -> Array:
        u, v = (np.array(size_px) - 1) / 2 + offset_px
        return np.array([[focal_px, 0.0, u], [0.0, focal_px, v], [0.0, 0.0, 1.0]])

    return (
        Camera(K(rig.focal_px, left_size, offset), dist, np.eye(4), *left_size, bent),
        Camera(K(right_focal_px, right_size, -offset), right_dist, X_right, *right_size, bent),
    )


def mount_pose(rig: config.Rig) -> Array:
    """X_BC (4, 4) of the left camera in the inspector's body."""
    return make_pose(exp_so3(np.deg2rad(rig.mount_rotation_deg)), rig.mount_position_m)


Image = NDArray[np.uint8] | NDArray[np.uint16]


def expose(
    level: Array, sensor: config.Sensor, rng: np.random.Generator, points: Array | None = None
) -> Image:
    """Levels (H, W), 1 for a white surface that faces the Sun -> image (H, W), 16-bit for more than 8 bits.

    ``points`` (H, W) is light that includes the lens blur already: stars.
    """
    light = through_lens(level, sensor, points)
    # The limit of the mean lies far above any full well.
    electrons = np.minimum(light * sensor.white_dn * sensor.electrons_per_dn, 1e12)
    full_well = sensor.full_well_dn * sensor.electrons_per_dn
    counts, lit = np.zeros(electrons.shape), electrons > 0
    counts[lit] = rng.poisson(electrons[lit])
    charge = spill(counts, full_well, sensor.bloom)
    return digitise(charge / sensor.electrons_per_dn, sensor, rng)


def through_lens(level: Array, sensor: config.Sensor, points: Array | None = None) -> Array:
    """Light (H, W) on the sensor, from levels (H, W) before the lens and from points blurred already."""
    light = _blurred(level, sensor.blur_px) if sensor.blur_px > 0 else np.asarray(level)
    if points is not None:
        light = light + points
    if sensor.vignetting > 0:
        light = light * vignette(light.shape[0], light.shape[1], sensor.vignetting)
    if sensor.glare > 0:
        light = (1.0 - sensor.glare) * light + sensor.glare * _blurred(light, sensor.glare_px)
    return light


def vignette(height_px: int, width_px: int, corner_loss: float) -> Array:
    """Share of the light (H, W) that arrives: falls with the square of the distance from the centre."""
    v = np.linspace(-1.0, 1.0, height_px)[:, None] * (height_px - 1)
    u = np.linspace(-1.0, 1.0, width_px) * (width_px - 1)
    return np.asarray(1.0 - corner_loss * (u**2 + v**2) / (u[-1] ** 2 + v[-1, 0] ** 2))


def spill(charge: Array, full_well: float, share: float) -> Array:
    """Charge (H, W) in the wells, limited to ``full_well``; the excess blooms along its column.

    ``share`` of the excess leaves the pixel, half of it up and half down, and fills the next wells that are
    not full; the rest of the excess, and what leaves the ends of the column, is drained.
    """
    excess = np.maximum(charge - full_well, 0.0)
    kept = charge - excess
    columns = np.flatnonzero(excess.any(axis=0))
    if share == 0.0 or len(columns) == 0:
        return kept
    half, wells = 0.5 * share * excess[:, columns], kept[:, columns]
    rows = range(len(charge))
    for way in (rows, reversed(rows)):
        carried = np.zeros(len(columns))
        for row in way:
            taken = np.minimum(carried, full_well - wells[row])
            wells[row] += taken
            carried += half[row] - taken
    kept[:, columns] = wells
    return kept


def digitise(signal_dn: Array, sensor: config.Sensor, rng: np.random.Generator) -> Image:
    """Signal (H, W) [DN] -> codes of the sensor's bits, with read noise and black level."""
    read_dn = rng.standard_normal(signal_dn.shape, dtype=np.float32) * sensor.read_noise_dn
    highest = 2**sensor.bits - 1
    codes: Array = np.clip(
        np.rint((signal_dn + read_dn + sensor.black_level_dn) * (highest / 255.0)), 0, highest
    )
    return codes.astype(np.uint8) if sensor.bits == 8 else codes.astype(np.uint16)


def _blurred(light: Array, sigma_px: float) -> Array:
    """Convolution with the discrete Gaussian, whose variance is exactly sigma_px^2, also for a narrow blur.

    A sampled Gaussian of 0.4 px has the variance of 0.28 px. Lindeberg, "Scale-space for discrete signals",
    IEEE PAMI 12(3), 1990.
    """
    radius = int(np.ceil(4.0 * sigma_px + 1.0))
    kernel = ive(np.abs(np.arange(-radius, radius + 1)), sigma_px**2)
    kernel /= kernel.sum()
    return np.asarray(cv2.sepFilter2D(light, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REFLECT))
