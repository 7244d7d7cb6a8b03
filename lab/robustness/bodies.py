"""Twelve targets of the campaign of faults: seven families, two generators of textures, motions and lights.

The images are small, so that a run takes a fraction of a minute. Forces and torques that nobody knows disturb
each target a little (``PSD``).
"""

from typing import Any

from polhode.config.scene_settings import Scene

FRAMES, INTERVAL_S = 40, 0.5
PSD = 1e-8
"""Disturbances: of the acceleration [(m/s^2)^2/Hz], and of the torque over the middle moment."""
RIG = {"width_px": 288, "height_px": 216, "focal_px": 280.0, "baseline_m": 0.09}
FREE_FLYER = {
    "com_m": [3.88e-3, -1.49e-3, 1.92e-3],
    "inertia_kg_m2": [
        [2.41e-2, -1.3e-4, -1.42e-4],
        [-1.3e-4, 2.11e-2, 5.74e-5],
        [-1.42e-4, 5.74e-5, 1.61e-2],
    ],
}
"""Distinct moments"""


def _body(
    seed: int,
    body: dict[str, Any],
    distance_m: float,
    attitude_deg: tuple[float, ...],
    spin_rpm: tuple[float, ...],
    sun_N: tuple[float, ...],
    white_dn: float,
    mass: dict[str, Any] | None = None,
) -> tuple[int, dict[str, Any]]:
    """Seed and description of a scene; the target is in front of the middle of the rig."""
    return seed, {
        "interval_s": INTERVAL_S,
        "truth_horizon_s": 5.0,
        "body": body,
        "mass": mass or {},
        "motion": {
            "position_m": [0.045, 0.0, distance_m],
            "velocity_mm_s": [-0.8, 0.5, 0.6],
            "attitude_deg": attitude_deg,
            "spin_rpm": spin_rpm,
            "spin_axes": "principal",
            "accel_psd": PSD,
            "torque_psd": PSD,
        },
        "rig": RIG,
        "light": {"sun_direction_N": sun_N},
        "sensor": {"white_dn": white_dn, "exposure_ms": 0.0},
        "render": {"bounces": 0},
    }


_COLLAGE = {"texture": "collage"}
BODIES: dict[str, tuple[int, dict[str, Any]]] = {
    "flyer": _body(101, {"family": "free_flyer", "size_m": 0.22}, 0.46, (10, 25, 40), (1.5, 5.0, 2.0),
                   (0.6, -0.4, -0.7), 450.0, FREE_FLYER),
    "flyer_fast": _body(102, {"family": "free_flyer", "size_m": 0.22, **_COLLAGE}, 0.46, (60, -15, 20),
                        (2.5, -7.0, 3.0), (-0.4, -0.5, -0.75), 450.0, FREE_FLYER),
    "bus": _body(103, {"family": "bus", "size_m": 0.16}, 0.75, (-35, 30, 20), (3.0, 2.5, 1.2),
                 (-0.4, -0.6, -0.7), 350.0),
    "cubesat": _body(105, {"family": "cubesat", "size_m": 0.24}, 0.5, (40, 10, 25), (1.2, 4.2, 2.0),
                     (0.55, -0.5, -0.7), 600.0),
    "cubesat_side": _body(106, {"family": "cubesat", "size_m": 0.24, **_COLLAGE}, 0.5, (-70, 30, 5),
                          (2.0, 3.1, 2.6), (0.9, -0.2, -0.5), 600.0),
    "asteroid": _body(107, {"family": "asteroid", "size_m": 0.25}, 0.55, (10, 40, 0), (1.6, 4.2, 2.2),
                      (0.5, -0.4, -0.75), 520.0),
    "asteroid_hard": _body(108, {"family": "asteroid", "size_m": 0.25, **_COLLAGE}, 0.55, (80, 10, -30),
                           (2.6, 2.2, 3.0), (0.75, -0.35, -0.6), 520.0),
    "truss": _body(109, {"family": "truss", "size_m": 0.36}, 0.6, (25, 35, -15), (0.8, 4.5, 1.5),
                   (0.3, -0.5, -0.8), 500.0),
    "truss_side": _body(110, {"family": "truss", "size_m": 0.36, **_COLLAGE}, 0.6, (-25, 60, 40),
                        (2.4, 2.8, 1.8), (-0.6, -0.4, -0.7), 500.0),
    "stage": _body(111, {"family": "upper_stage", "size_m": 0.36}, 0.62, (30, 65, 10), (1.0, 3.5, 2.4),
                   (0.4, -0.5, -0.75), 500.0),
    "dish": _body(113, {"family": "dish", "size_m": 0.28}, 0.62, (30, 30, 0), (1.2, 4.0, 1.8),
                  (0.4, -0.5, -0.75), 400.0),
    "dish_side": _body(114, {"family": "dish", "size_m": 0.28, **_COLLAGE}, 0.62, (-60, 20, 30),
                       (2.6, 2.6, 2.0), (-0.3, -0.6, -0.75), 400.0),
}  # fmt: skip
"""By name: seed, and the scene as a configuration has it"""


def scene_of(name: str, frames: int = FRAMES, **changes: dict[str, Any]) -> tuple[Scene, int]:
    """The scene of a body and its seed; ``changes`` are entries of its sections."""
    seed, description = BODIES[name]
    sections = {key: {**description.get(key, {}), **values} for key, values in changes.items()}
    return Scene.model_validate({**description, **sections, "frames": frames}), seed
