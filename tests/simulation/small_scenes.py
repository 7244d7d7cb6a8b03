"""A free flyer in small images, without the light from part to part, which takes a second to prepare."""

from collections.abc import Mapping
from pathlib import Path

from polhode.config.scene_settings import Scene

RIG = {"width_px": 80, "height_px": 60, "focal_px": 60.0}
TOED_IN = {
    "distortion": [-0.2, 0.05, 1e-3, -5e-4],
    "right_rotation_deg": [0.5, -6.0, 0.8],
    "right_offset_mm": [0.0, 1.5, -2.0],
}
"""Distorted cameras that are not parallel."""


def small_scene(**changes: object) -> Scene:
    """The scene, with sections replaced; a new ``light`` or ``render`` keeps what makes it cheap."""
    values: dict[str, object] = {
        "frames": 3,
        "truth_horizon_s": 1.0,
        "rig": RIG,
        "motion": {"position_m": [0.04, 0.0, 0.6], "spin_rpm": [1.0, 9.0, 0.0]},
        "light": {"earth": 0.0},
        "render": {"bounces": 0},
    }
    for name, change in changes.items():
        cheap = values.get(name) if name in ("light", "render") else None
        values[name] = (
            {**cheap, **change} if isinstance(cheap, dict) and isinstance(change, Mapping) else change
        )
    return Scene.model_validate(values)


def files(folder: Path) -> dict[str, bytes]:
    """Content of all files below a folder, by name."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
