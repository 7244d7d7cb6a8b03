"""From light levels to 8-bit grey values: lens blur, shot noise, read noise, quantisation."""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.config import scene as config
from polhode.lie import Array


def expose(level: Array, sensor: config.Sensor, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Levels (H, W), 1 for a white surface that faces the Sun -> image (H, W)."""
    if sensor.blur_px > 0:
        level = np.asarray(cv2.GaussianBlur(level, (0, 0), sensor.blur_px), dtype=np.float64)
    signal_dn = np.zeros_like(level)
    bright = level > 0
    # Full wells end far above 255 DN; the limit keeps the Poisson draw in range.
    electrons = np.minimum(level[bright] * sensor.white_dn, 4096.0) * sensor.electrons_per_dn
    signal_dn[bright] = rng.poisson(electrons) / sensor.electrons_per_dn
    read = rng.standard_normal(level.shape, dtype=np.float32) * sensor.read_noise_dn
    return np.clip(np.rint(signal_dn + read + sensor.black_level_dn), 0, 255).astype(np.uint8)
