"""From light to grey values: lens blur, glare, vignetting, photon noise, saturation, read noise,
quantization.

Grey values are in DN, 1/255 of full scale, whatever the number of bits.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from polhode.config import scene as config
from polhode.lie import Array

Image = NDArray[np.uint8] | NDArray[np.uint16]

MAX_MEAN_ELECTRONS = 1e12
"""Upper limit of the mean number of electrons [-] per pixel: far above any full well."""


def expose(
    level: Array, sensor: config.Sensor, rng: np.random.Generator, points: Array | None = None
) -> Image:
    """Levels (H, W), 1 for a white surface that faces the Sun -> image (H, W), 16-bit for more than 8 bits.

    ``points`` (H, W) is light that includes the lens blur already: stars.
    """
    light = through_lens(level, sensor, points)
    electrons = np.minimum(light * sensor.white_dn * sensor.electrons_per_dn, MAX_MEAN_ELECTRONS)
    full_well = sensor.full_well_dn * sensor.electrons_per_dn
    charge = spill(_count(electrons, rng), full_well, sensor.bloom)
    return digitise(charge / sensor.electrons_per_dn, sensor, rng)


def through_lens(level: Array, sensor: config.Sensor, points: Array | None = None) -> Array:
    """Light (H, W) on the sensor, from levels (H, W) before the lens and from points that are already
    blurred.
    """
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


def _count(mean: Array, rng: np.random.Generator) -> Array:
    """Electrons (H, W), Poisson distributed about their mean."""
    counts = np.zeros(mean.shape)
    lit = mean > 0
    counts[lit] = rng.poisson(mean[lit])
    return counts


def _blurred(light: Array, sigma_px: float) -> Array:
    """Convolution with the discrete Gaussian, whose variance is exactly sigma_px^2, also for a narrow blur.

    A sampled Gaussian of 0.4 px has the variance of 0.28 px. Lindeberg, "Scale-space for discrete signals",
    IEEE PAMI 12(3), 1990.
    """
    radius = int(np.ceil(4.0 * sigma_px + 1.0))
    kernel = ive(np.abs(np.arange(-radius, radius + 1)), sigma_px**2)
    kernel /= kernel.sum()
    return np.asarray(cv2.sepFilter2D(light, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REFLECT))
