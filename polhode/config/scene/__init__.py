"""Description of a simulated scene: what ``polhode simulate`` renders. Every value carries its unit."""

from typing import Self

from pydantic import Field, model_validator

from polhode.config.scene.body import Body, Mass
from polhode.config.scene.camera import Product, Render, Rig, Sensor
from polhode.config.scene.light import Background, Eclipse, Light
from polhode.config.scene.motion import Inspector, Motion, Push, Waypoint
from polhode.config.section import NonNegative, Positive, Section

__all__ = [
    "Background",
    "Body",
    "Eclipse",
    "Inspector",
    "Light",
    "Mass",
    "Motion",
    "Product",
    "Push",
    "Render",
    "Rig",
    "Scene",
    "Sensor",
    "Waypoint",
]


class Scene(Section):
    """What ``polhode simulate`` renders."""

    frames: int = Field(115, ge=1)
    """Number of stereo pairs."""
    interval_s: Positive = 0.5
    """Time between pairs [s]."""
    truth_horizon_s: NonNegative = 60.0
    """How long the truth goes on after the last image [s]."""
    start_ns: int = Field(1_600_000_000_000_000_000, ge=0)
    """Timestamp of the first pair [ns]."""
    body: Body = Body()
    mass: Mass = Mass()
    motion: Motion = Motion()
    rig: Rig = Rig()
    inspector: Inspector = Inspector()
    light: Light = Light()
    background: Background = Background()
    sensor: Sensor = Sensor()
    render: Render = Render()

    @model_validator(mode="after")
    def _directions_have_length(self) -> Self:
        for name, vector in [
            ("light.sun_direction_N", self.light.sun_direction_N),
            ("light.earth_direction_N", self.light.earth_direction_N),
            ("inspector.circle_axis", self.inspector.circle_axis),
        ]:
            if not any(vector):
                raise ValueError(f"{name} is zero: give a direction")
        return self

    @model_validator(mode="after")
    def _dropped_frames_exist(self) -> Self:
        for frame in self.sensor.dropped_frames:
            if not 0 <= frame < self.frames:
                raise ValueError(
                    f"sensor.dropped_frames: there is no frame {frame}, only 0 to {self.frames - 1}"
                )
        return self
