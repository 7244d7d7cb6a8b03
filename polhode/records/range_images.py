"""Range images of a sequence, beside one camera instead of a second one (docs/dataset.md).

``range0/`` has a data.csv and 16-bit images, pixel for pixel those of the camera; 0 is no measurement.
``range0/sensor.yaml`` states the metres per unit and the noise. The rest of the program measures disparities:
a range is the disparity to a virtual right camera, whose distance is chosen so that the noise of ranges
becomes that of disparities, for which all its thresholds are made.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polhode.files.tables import numbers_at, read_mapping
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

RANGE_FOLDER = "range0"
ALONG = ("axis", "ray")
MIN_SCALE_M, MAX_SCALE_M = 1e-7, 10.0
MIN_SIGMA_M, MAX_SIGMA_M = 1e-7, 1e3
MAX_GROWTH_PER_M = 1e3
VIRTUAL_SIGMA_PX = 0.25
"""Sigma of the virtual disparity of a pixel at the median range: between that of dense stereo matching and
what is a jump of disparity [px]."""
MIN_BASELINE_M, MAX_BASELINE_M = 1e-3, 1e3


@dataclass(frozen=True)
class RangeModel:
    """What the values of range images mean, and how noisy they are."""

    scale_m: float
    """Metres per unit"""
    sigma_m: float
    """Standard deviation of a pixel, at no distance [m]"""
    growth_per_m: float = 0.0
    """Part of it that grows with the square of the range [1/m]: that of triangulating sensors"""
    along_ray: bool = False
    """Whether the values are lengths of viewing rays (a LIDAR), not depths along the optical axis"""

    def metres(self, raw: NDArray[Any]) -> Array:
        """Values as stored -> ranges [m]; NaN where nothing was measured."""
        return np.where(raw > 0, raw * self.scale_m, np.nan)

    def sigma_at(self, range_m: Array) -> Array:
        """Standard deviation of ranges [m]; the growing part is independent of the constant one."""
        return np.hypot(self.sigma_m, self.growth_per_m * np.square(range_m))

    def virtual_baseline_m(self, focal_px: float, range_m: float) -> float:
        """Distance of the virtual right camera for a usual range [m] and focal length [px].

        disparity = f b / z, so that sigma_d = f b sigma_z / z^2.
        """
        baseline_m = VIRTUAL_SIGMA_PX * range_m**2 / (focal_px * float(self.sigma_at(np.array(range_m))))
        return float(np.clip(baseline_m, MIN_BASELINE_M, MAX_BASELINE_M))


def read_range_model(folder: Path) -> RangeModel:
    """The ``sensor.yaml`` of ``range0``. Raises InputError: a key is missing or cannot be true."""
    path = folder / "sensor.yaml"
    sensor = read_mapping(path, "range images need their scale_m and sigma_m (see docs/dataset.md)")
    if "scale_m" not in sensor:
        raise InputError(
            f"{path} lacks the key 'scale_m': give the metres per unit of the images, 0.001 for millimetres"
        )
    along = sensor.get("along", ALONG[0])
    if along not in ALONG:
        raise InputError(
            f"{path} key 'along': expected axis (depths along the optical axis) or ray (lengths of viewing "
            "rays)"
        )
    growth = 0.0
    if "sigma_growth_per_m" in sensor:
        growth = _number(path, sensor, "sigma_growth_per_m", 0.0, MAX_GROWTH_PER_M)
    return RangeModel(
        _number(path, sensor, "scale_m", MIN_SCALE_M, MAX_SCALE_M),
        _number(path, sensor, "sigma_m", MIN_SIGMA_M, MAX_SIGMA_M),
        growth,
        along == "ray",
    )


def _number(path: Path, sensor: dict[str, Any], key: str, least: float, most: float) -> float:
    value = float(numbers_at(path, {key: [sensor[key]]} if key in sensor else sensor, key, (1,))[0])
    if not least <= value <= most:
        raise InputError(f"{path} key '{key}': {value:g}, expected {least:g} to {most:g}")
    return value


def why_no_ranges(raw: NDArray[Any]) -> str:
    """What speaks against an image (H, W) being one of ranges; empty: nothing does."""
    if raw.dtype != np.uint16:
        return "8 bits or colours, where 16-bit grey is needed; save ranges with their full depth"
    return ""
