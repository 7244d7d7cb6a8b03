"""Scenes that nothing was tuned on: bodies, textures, lights and motions that configs/scenes does not have.

Ten kinds, each drawn by a seeded generator: the draw's number changes body, texture, light and motion. They
are there to be judged by, once; a model that was changed after a look at one draw is judged by the next.
"""

from collections.abc import Callable
from typing import Any
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array

FRAMES, INTERVAL_S = 60, 0.5
Rng = np.random.Generator
Description = dict[str, Any]


def _toward_sun(rng: Rng, phase_deg: tuple[float, float]) -> list[float]:
    """Direction of the Sun so many degrees from the line of sight back to the camera, from any side."""
    phase = np.deg2rad(rng.uniform(*phase_deg))
    around = rng.uniform(0.0, 2.0 * np.pi)
    sun = [np.sin(phase) * np.cos(around), np.sin(phase) * np.sin(around), -np.cos(phase)]
    return [float(value) for value in sun]


def _spin(rng: Rng, rpm: tuple[float, float]) -> Array:
    """A tumble at any angle to the principal axes [RPM], but no spin about one of them."""
    direction = rng.uniform(0.25, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    return np.asarray(rng.uniform(*rpm) * direction / np.linalg.norm(direction))


def _scene(
    rng: Rng,
    body: Description,
    distance_m: float,
    rpm: tuple[float, float],
    phase_deg: tuple[float, float],
    white_dn: float,
    **sections: Description,
) -> Description:
    """A target in front of the middle of the rig; ``sections`` add to those of the description."""
    base: Description = {
        "frames": FRAMES,
        "interval_s": INTERVAL_S,
        "body": {"texture": str(rng.choice(["drawn", "collage"])), **body},
        "motion": {
            "position_m": [0.045, 0.0, distance_m],
            "velocity_mm_s": rng.uniform(-1.0, 1.0, 3).tolist(),
            "attitude_deg": np.rad2deg(Rotation.random(random_state=rng).as_rotvec()).tolist(),
            "spin_rpm": _spin(rng, rpm).tolist(),
            "spin_axes": "principal",
        },
        "light": {"sun_direction_N": _toward_sun(rng, phase_deg)},
        "sensor": {"white_dn": white_dn},
    }
    return {**base, **{key: {**base.get(key, {}), **values} for key, values in sections.items()}}


def _sun_from_side(rng: Rng) -> Description:
    """A bus, half of it dark."""
    return _scene(rng, {"family": "bus", "size_m": 0.2}, 0.8, (3.0, 5.0), (70.0, 95.0), 500.0)


def _glitter(rng: Rng) -> Description:
    """A cubesat in crumpled foil."""
    body = {"family": "cubesat", "size_m": 0.3, "material": "foil"}
    return _scene(rng, body, 0.65, (2.0, 4.0), (25.0, 60.0), 260.0)


def _slow_rock(rng: Rng) -> Description:
    """An asteroid that turns by 40 to 70 degrees in all."""
    body = {"family": "asteroid", "size_m": 0.3, "texture": "collage"}
    return _scene(rng, body, 0.75, (0.22, 0.39), (30.0, 60.0), 560.0)


def _fast_truss(rng: Rng) -> Description:
    """An open truss at 10 to 13 RPM: more than 30 degrees between pairs."""
    return _scene(rng, {"family": "truss", "size_m": 0.45}, 0.9, (10.0, 13.0), (20.0, 50.0), 450.0)


def _circling(rng: Rng) -> Description:
    """A dish; the inspector flies around it and reports noisy poses."""
    inspector = {
        "profile": "circle", "circle_period_s": float(rng.uniform(150.0, 300.0)),
        "sigma_p_m": 0.001, "sigma_theta_deg": 0.03,
    }  # fmt: skip
    body = {"family": "dish", "size_m": 0.3}
    return _scene(rng, body, 0.8, (2.0, 5.0), (25.0, 60.0), 380.0, inspector=inspector)


def _approaching(rng: Rng) -> Description:
    """An upper stage; the inspector closes in, and its control jitters."""
    inspector = {
        "profile": "approach", "approach_mm_s": 12.0, "approach_stop_m": 0.5, "deadband_mm": 4.0,
        "deadband_deg": 0.3, "sigma_p_m": 0.0005, "sigma_theta_deg": 0.02,
    }  # fmt: skip
    body = {"family": "upper_stage", "size_m": 0.36}
    return _scene(rng, body, 0.9, (2.0, 5.0), (30.0, 65.0), 480.0, inspector=inspector)


def _far_away(rng: Rng) -> Description:
    """A large bus at 6 m, seen by a rig of 0.4 m and a long lens."""
    rig = {"baseline_m": 0.4, "focal_px": 800.0}
    motion = {"position_m": [0.2, 0.0, 6.0]}
    body = {"family": "bus", "size_m": 0.9}
    return _scene(rng, body, 6.0, (2.0, 5.0), (25.0, 60.0), 400.0, rig=rig, motion=motion)


def _lamp_alone(rng: Rng) -> Description:
    """A free flyer in the dark, lit by the inspector's lamp: the light stays where the camera is."""
    light = {"sun": 0.0, "earth": 0.02, "lamp": 0.35}
    return _scene(
        rng, {"family": "free_flyer", "size_m": 0.25}, 0.6, (2.0, 6.0), (30.0, 50.0), 450.0, light=light
    )


def _earth_behind(rng: Rng) -> Description:
    """An asteroid before the Earth and stars, by a noisy camera."""
    light = {"earth_direction_N": [*rng.uniform(-0.4, 0.4, 2).tolist(), 1.0]}
    sensor = {"read_noise_dn": 2.5, "electrons_per_dn": 15.0}
    return _scene(
        rng, {"family": "asteroid", "size_m": 0.32}, 0.8, (3.0, 6.0), (35.0, 65.0), 520.0,
        light=light, sensor=sensor, background={"earth": True, "stars": True},
    )  # fmt: skip


def _disturbed(rng: Rng) -> Description:
    """A cubesat that unknown forces and torques disturb, through a distorting lens."""
    motion = {"accel_psd": 1e-8, "torque_psd": 1e-6}
    rig = {"distortion": [-0.18, 0.05, 4e-4, -3e-4], "right_rotation_deg": [0.4, -1.0, 0.6]}
    body = {"family": "cubesat", "size_m": 0.3}
    return _scene(rng, body, 0.7, (3.0, 7.0), (25.0, 60.0), 520.0, motion=motion, rig=rig)


KINDS: dict[str, Callable[[Rng], Description]] = {
    "sun_from_side": _sun_from_side,
    "glitter": _glitter,
    "slow_rock": _slow_rock,
    "fast_truss": _fast_truss,
    "circling": _circling,
    "approaching": _approaching,
    "far_away": _far_away,
    "lamp_alone": _lamp_alone,
    "earth_behind": _earth_behind,
    "disturbed": _disturbed,
}


def new_scene(kind: str, draw: int) -> tuple[Scene, int]:
    """The scene and its seed; other draws have another body, texture, light and motion."""
    seed = crc32(f"{kind} {draw}".encode())
    return Scene.model_validate(KINDS[kind](np.random.default_rng([seed, 0x0E5]))), seed
