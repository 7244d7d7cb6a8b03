"""Random scenes for the rules of thumb: bodies, distances, rigs, spins and Suns as missions have them.

They are drawn in quantities without a unit of length, because a scene that is twice as large, seen from twice
as far, has the same images. A number always gives the same scene, however many are drawn.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

SEED = 27
FAMILIES: dict[str, float] = {"free_flyer": 1.7, "cubesat": 1.7, "bus": 2.6, "asteroid": 1.7}
"""Bodies, and the side of the images over the size of the body in them, so that panels are inside. Bodies of
revolution are not among them: their inertia is no rule of thumb (docs/trust.md)."""
RANGES: dict[str, tuple[float, float]] = {
    "size_m": (0.2, 5.0),
    "size_px": (50.0, 400.0),
    "range_over_size": (2.5, 8.0),
    "baseline_over_range": (0.02, 0.2),
    "rpm": (0.5, 20.0),
    "turn_deg": (2.0, 20.0),
    "pairs": (10.0, 24.0),
    "sun_angle_deg": (10.0, 100.0),
}
"""Of the draws: the logarithm is uniform, but for the angle between the Sun and the camera, seen from the
target, which is uniform itself. ``turn_deg``: rotation from pair to pair"""
UNIFORM = frozenset({"sun_angle_deg"})


@dataclass(frozen=True)
class RandomScene:
    """What was drawn, and what a mission designer would call it."""

    number: int
    family: str
    size_m: float
    range_m: float
    focal_px: float
    baseline_m: float
    rpm: float
    interval_s: float
    pairs: int
    sun_angle_deg: float

    @property
    def name(self) -> str:
        """In the table of the study."""
        return f"scene{self.number:03d}"


def random_scenes(count: int) -> list[RandomScene]:
    """The first ``count`` scenes of Sobol's sequence."""
    draws = qmc.Sobol(len(RANGES), rng=np.random.default_rng(SEED)).random_base2((count - 1).bit_length())
    return [_scene(number, row) for number, row in enumerate(draws[:count])]


def _scene(number: int, shares: np.ndarray) -> RandomScene:
    drawn = {
        name: low + (high - low) * share if name in UNIFORM else low * (high / low) ** share
        for (name, (low, high)), share in zip(RANGES.items(), shares, strict=True)
    }
    size, distance = drawn["size_m"], drawn["size_m"] * drawn["range_over_size"]
    return RandomScene(
        number,
        str(_generator(number).choice(list(FAMILIES))),
        _rounded(size),
        _rounded(distance),
        _rounded(drawn["size_px"] * distance / size),
        _rounded(drawn["baseline_over_range"] * distance),
        _rounded(drawn["rpm"]),
        _rounded(drawn["turn_deg"] / (6.0 * drawn["rpm"])),
        round(drawn["pairs"]),
        _rounded(drawn["sun_angle_deg"]),
    )


def _generator(*numbers: int) -> np.random.Generator:
    return np.random.default_rng([SEED, *numbers])


def _rounded(value: float) -> float:
    """Four digits, so that a study can be read."""
    return float(f"{value:.4g}")


def settings_of(scene: RandomScene) -> dict[str, Any]:
    """The scene as a configuration has it; what is not in its record is drawn by its number."""
    rng = _generator(scene.number, 1)
    axis = rng.normal(size=3)
    spin = scene.rpm * axis / np.linalg.norm(axis)
    angle, turned = np.deg2rad(scene.sun_angle_deg), rng.uniform(0.0, 2.0 * np.pi)
    sun = [np.sin(angle) * np.cos(turned), np.sin(angle) * np.sin(turned), -np.cos(angle)]
    aside = 0.05 * scene.size_m * rng.uniform(-1.0, 1.0, 2)
    # so slow that the body stays in the image
    drift = 50.0 * scene.size_m / (scene.pairs * scene.interval_s) * rng.uniform(-1.0, 1.0, 3)
    side = round(FAMILIES[scene.family] * scene.focal_px * scene.size_m / scene.range_m)
    return {
        "seed": scene.number,
        "scene": {
            "frames": scene.pairs,
            "interval_s": scene.interval_s,
            "truth_horizon_s": 0.0,
            "body": {"family": scene.family, "size_m": scene.size_m},
            "motion": {
                "position_m": _all_rounded([0.5 * scene.baseline_m + aside[0], aside[1], scene.range_m]),
                "velocity_mm_s": _all_rounded(drift),
                "attitude_deg": _all_rounded(rng.uniform(-90.0, 90.0, 3)),
                "spin_rpm": _all_rounded(spin),
                "spin_axes": "principal",
            },
            "rig": {
                "width_px": side,
                "height_px": side,
                "focal_px": scene.focal_px,
                "baseline_m": scene.baseline_m,
            },
            "light": {"sun_direction_N": _all_rounded(sun)},
        },
    }


def _all_rounded(values: Any) -> list[float]:
    return [_rounded(each) for each in values]
