"""The missions of the laboratory: one seeded set that coverage, verdict and predictions are judged by.

Each body (a family and a seed) flies in several missions, under other lights, in front of other rigs, with
other motions. Every second body of a family is held back: no limit of a check is chosen by a look at its
missions (``Mission.is_held_back``). ``TUNED_DRAW`` is the draw that limits were chosen on; others are new.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.config.scene_settings import Scene

MISSIONS = 320
TUNED_DRAW = 1
FAMILIES: dict[str, tuple[float, float]] = {
    "free_flyer": (0.5, 0.62), "bus": (0.9, 0.36), "upper_stage": (0.55, 0.5), "dish": (0.55, 0.5),
    "truss": (0.55, 0.5), "cubesat": (0.6, 0.42), "asteroid": (0.65, 0.5),
}  # fmt: skip
"""By family: radius of the sphere that holds it over ``size_m``, and grey value of a white surface [1000 DN]
at which it is well exposed."""
BODIES_EACH = 8
"""Bodies of each family"""
Rng = np.random.Generator
Description = dict[str, Any]


@dataclass(frozen=True)
class Mission:
    """One sequence: what is simulated, and what a table groups it by."""

    number: int
    family: str
    motion: str
    light: str
    rig: str
    inspector: str
    is_held_back: bool
    """Whether its body is of the half that no choice may look at"""
    scene: Scene
    seed: int

    def beginning(self, frames: int) -> "Mission":
        """The same with fewer pairs."""
        return replace(self, scene=self.scene.model_copy(update={"frames": frames}))

    @property
    def kinds(self) -> dict[str, str]:
        """What it is of, by the name of the kind."""
        return {name: getattr(self, name) for name in ("family", "motion", "light", "rig", "inspector")}


def mission(number: int, draw: int = TUNED_DRAW) -> Mission:
    """The mission of a number from 0; other draws have other bodies, too."""
    families = tuple(FAMILIES)
    family = families[number % len(families)]
    body = (number // len(families)) % BODIES_EACH
    rng = np.random.default_rng([draw, number, 0x0E5])
    size_m = float(np.exp(rng.uniform(np.log(0.15), np.log(1.0))))
    radius_m = FAMILIES[family][0] * size_m
    chosen = {name: _choice(rng, table) for name, table in KINDS.items()}
    rig_of = RIGS[chosen["rig"]](rng)
    # the target's sphere fills this share of the image's height
    distance_m = radius_m * 2.0 * rig_of["focal_px"] / (rng.uniform(0.6, 0.9) * rig_of["height_px"])
    rig_of["baseline_m"] = float(distance_m * rng.uniform(0.08, 0.2))
    if rig_of.pop("toes_in", False):
        rig_of["right_rotation_deg"] = [0.2, -float(np.rad2deg(rig_of["baseline_m"] / distance_m)), -0.3]
    motion = MOTIONS[chosen["motion"]](rng)
    motion |= {
        "position_m": [rig_of["baseline_m"] / 2.0, 0.0, distance_m],
        "velocity_mm_s": (rng.uniform(-3.0, 3.0, 3) * size_m).tolist(),
        "attitude_deg": np.rad2deg(Rotation.random(random_state=rng).as_rotvec()).tolist(),
        "spin_axes": "principal",
        **_disturbances(rng, size_m),
    }
    light = LIGHTS[chosen["light"]](rng)
    white_dn = 1000.0 * FAMILIES[family][1] * rng.uniform(0.8, 1.2)
    description: Description = {
        "frames": int(rng.integers(20, 41)),
        "interval_s": float(rng.choice([0.25, 0.5, 0.5, 1.0])),
        "body": {
            "family": family, "size_m": size_m, "seed": int(7919 * draw + body),
            "texture": str(rng.choice(["drawn", "collage"])),
        },
        "motion": motion,
        "rig": rig_of,
        "inspector": INSPECTORS[chosen["inspector"]](rng, distance_m),
        "sensor": {"white_dn": white_dn, "exposure_ms": float(rng.choice([0.0, 1.0, 5.0]))},
        "render": {"samples": 4, "bounces": 0},
        **light,
    }  # fmt: skip
    if chosen["light"] == "lamp":
        description["light"]["lamp"] = 0.9 * distance_m**2
    scene = Scene.model_validate(description)
    return Mission(number, family, **chosen, is_held_back=bool(body % 2), scene=scene, seed=number)


def _choice(rng: Rng, table: Mapping[str, float]) -> str:
    """One of the kinds by their shares."""
    shares = np.array(list(table.values()))
    return str(rng.choice(list(table), p=shares / shares.sum()))


def _disturbances(rng: Rng, size_m: float) -> Description:
    """None in a third of the missions; else levels over three decades."""
    if rng.random() < 1.0 / 3.0:
        return {}
    accel, torque = 10.0 ** rng.uniform(-11.0, -8.0, 2)
    return {"accel_psd": float(accel * size_m**2 / 0.09), "torque_psd": float(torque)}


def _tumble(rng: Rng, rpm: tuple[float, float]) -> Description:
    """At any angle to the principal axes, but no spin about one of them."""
    direction = rng.uniform(0.25, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    return {"spin_rpm": (rng.uniform(*rpm) * direction / np.linalg.norm(direction)).tolist()}


def _about(rng: Rng, axis: int, cone_deg: float) -> Description:
    """Near the rotation about one principal axis."""
    direction = np.eye(3)[axis] + np.tan(np.deg2rad(cone_deg)) * rng.uniform(-1.0, 1.0, 3)
    return {"spin_rpm": (rng.uniform(1.5, 6.0) * direction / np.linalg.norm(direction)).tolist()}


MOTIONS: dict[str, Callable[[Rng], Description]] = {
    "tumble": lambda rng: _tumble(rng, (2.0, 7.0)),
    "slow": lambda rng: _tumble(rng, (0.2, 0.8)),
    "fast": lambda rng: _tumble(rng, (8.0, 14.0)),
    "flat": lambda rng: _about(rng, 0, 3.0),
    "roll": lambda rng: _about(rng, 2, 3.0),
    "flip": lambda rng: _about(rng, 1, 2.0),
}


def _sunlight(rng: Rng, phase_deg: tuple[float, float], **light: Any) -> Description:
    """The Sun so many degrees from the line of sight back to the camera, from any side."""
    phase, around = np.deg2rad(rng.uniform(*phase_deg)), rng.uniform(0.0, 2.0 * np.pi)
    sun = [np.sin(phase) * np.cos(around), np.sin(phase) * np.sin(around), -np.cos(phase)]
    return {"light": {"sun_direction_N": [float(value) for value in sun], **light}}


def _before_earth(rng: Rng) -> Description:
    toward = [*rng.uniform(-0.4, 0.4, 2).tolist(), 1.0]
    background = {"background": {"earth": True, "stars": True}}
    return _sunlight(rng, (30.0, 65.0), earth_direction_N=toward) | background


LIGHTS: dict[str, Callable[[Rng], Description]] = {
    "front": lambda rng: _sunlight(rng, (15.0, 45.0)),
    "oblique": lambda rng: _sunlight(rng, (45.0, 70.0)),
    "side": lambda rng: _sunlight(rng, (70.0, 95.0)),
    "lamp": lambda rng: {"light": {"sun": 0.0, "earth": 0.02}},
    "earth": _before_earth,
    "eclipse": lambda rng: _sunlight(
        rng, (20.0, 50.0), eclipse={"start_s": rng.uniform(4.0, 8.0), "duration_s": rng.uniform(2.0, 4.0)}
    ),
}


def _rig(rng: Rng, **others: Any) -> Description:
    """A parallel rig whose calibration is off by a draw from what it states, or exact."""
    width_px, height_px = ((288, 216), (320, 240), (400, 300))[int(rng.integers(3))]
    return {
        "width_px": width_px, "height_px": height_px, "focal_px": float(width_px * rng.uniform(0.7, 1.4)),
        "calibration_errors": float(rng.choice([0.0, 1.0, 1.0, 2.0])), **others,
    }  # fmt: skip


RIGS: dict[str, Callable[[Rng], Description]] = {
    "parallel": _rig,
    "distorted": lambda rng: _rig(
        rng, distortion=[-0.18, 0.05, 4e-4, -3e-4], right_rotation_deg=rng.uniform(-1.0, 1.0, 3).tolist()
    ),
    "toed-in": lambda rng: _rig(rng, toes_in=True, distortion=[-0.08, 0.02, 0.0, 0.0]),
    "unlike": lambda rng: _rig(rng, principal_offset_px=[9.0, -6.0], right_offset_mm=[0.0, 2.0, -3.0]),
}


def _at_rest(rng: Rng, distance_m: float) -> Description:
    del rng, distance_m
    return {}


def _circling(rng: Rng, distance_m: float) -> Description:
    return {
        "profile": "circle", "circle_period_s": float(rng.uniform(150.0, 400.0)),
        "sigma_p_m": 0.001 * distance_m, "sigma_theta_deg": 0.03,
    }  # fmt: skip


def _approaching(rng: Rng, distance_m: float) -> Description:
    return {
        "profile": "approach", "approach_mm_s": float(rng.uniform(3.0, 10.0) * distance_m),
        "approach_stop_m": 0.7 * distance_m, "deadband_mm": 4.0 * distance_m, "deadband_deg": 0.3,
        "sigma_p_m": 0.0005 * distance_m, "sigma_theta_deg": 0.02,
    }  # fmt: skip


INSPECTORS: dict[str, Callable[[Rng, float], Description]] = {
    "rest": _at_rest,
    "circle": _circling,
    "approach": _approaching,
}
KINDS: dict[str, dict[str, float]] = {
    "motion": {"tumble": 8, "slow": 3, "fast": 2, "flat": 3, "roll": 2, "flip": 2},
    "light": {"front": 8, "oblique": 5, "side": 2, "lamp": 2, "earth": 2, "eclipse": 1},
    "rig": {"parallel": 5, "distorted": 3, "toed-in": 2, "unlike": 2},
    "inspector": {"rest": 6, "circle": 2, "approach": 2},
}
"""Shares of the kinds"""
