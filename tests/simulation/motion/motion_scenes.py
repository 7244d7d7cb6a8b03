"""Scenes and mass properties for tests of motion: nothing of them is rendered."""

from typing import Any

import numpy as np

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array
from polhode.simulation.motion.mass import MassDistribution

TRIAXIAL = np.array([0.0241, 0.0234, 0.0201])
"""Principal moments near the thesis's target [kg m^2]."""
MASS_KG = 4.0


def scene_of(frames: int = 1, interval_s: float = 0.5, horizon_s: float = 0.0, **motion: Any) -> Scene:
    """A scene whose target moves as described; attitude and spin are in the principal axes."""
    return Scene.model_validate(
        {
            "frames": frames,
            "interval_s": interval_s,
            "truth_horizon_s": horizon_s,
            "motion": {"spin_axes": "principal", **motion},
        }
    )


def mass_of(moments: Array = TRIAXIAL) -> MassDistribution:
    """Principal axes along those of G, centre of mass beside its origin."""
    return MassDistribution(np.array([0.01, -0.02, 0.03]), np.diag(moments), moments, np.eye(3), MASS_KG)


def rpm(w_rad_s: Array) -> list[float]:
    """Angular velocity as the scene wants it."""
    return [float(w) for w in np.asarray(w_rad_s) * 60.0 / (2.0 * np.pi)]
