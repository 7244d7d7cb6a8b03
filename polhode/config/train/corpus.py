"""The rendered scenes that networks learn from."""

from typing import Literal, Self

from pydantic import Field, model_validator

from polhode.config.scene.values import NonNegative, Positive, Share
from polhode.config.section import Section

Family = Literal["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat", "asteroid"]
Range = tuple[Positive, Positive]
RangeFromZero = tuple[NonNegative, NonNegative]


class Corpus(Section):
    """Random scenes. Ranges are (least, most); each scene draws its own values by the seed."""

    folder: str = "runs/corpus"
    """Folder of the sequences; what is missing there is rendered."""
    seed: int = Field(0, ge=0)
    """Seed of the scenes: the same seed and ranges give the same bytes."""
    scenes: int = Field(100, ge=2)
    """Number of scenes. Scene i does not depend on how many there are."""
    frames: int = Field(10, ge=3)
    """Stereo pairs a scene."""
    validation_every: int = Field(8, ge=2)
    """One scene in so many is held out for validation: bodies that training never sees."""
    families: tuple[Family, ...] = Field(
        ("free_flyer", "bus", "upper_stage", "cubesat", "asteroid"), min_length=1
    )
    """Shapes, taken in turn."""
    first_body_seed: int = Field(1000, ge=0)
    """Scene i shows the body of this seed plus i; smaller seeds are left to the tests."""
    texture: Literal["drawn", "collage"] = "drawn"
    """Generator of the textures; the other one is left to the tests."""
    other_material: Share = 0.35
    """Share of the scenes whose body is covered by one material, drawn at random."""
    contrast: Range = (0.5, 1.3)
    """Factor on the texture's variation of reflectance."""
    size_m: Range = (0.2, 0.6)
    """Size of the body, as ``scene.body.size_m`` [m]."""
    span_px: Range = (170.0, 430.0)
    """Diameter in the image of the sphere around the bulk of the body, without antennas [px]."""
    disparity_px: Range = (25.0, 110.0)
    """Disparity of the body's middle, which sets the baseline [px]."""
    turn_deg: Range = (15.0, 50.0)
    """Turn between frames, about a random axis [deg]."""
    sun_phase_deg: RangeFromZero = (10.0, 105.0)
    """Angle at the target between the Sun and the camera [deg]."""
    hard_light: Share = 0.5
    """Share of the scenes with next to no light from the Earth: black shadows."""
    earth: RangeFromZero = (0.02, 0.25)
    """Radiance of the Earth in the other scenes, as ``scene.light.earth``."""
    lamp: Share = 0.12
    """Share of the scenes with a lamp beside the camera."""
    white_dn: Range = (320.0, 900.0)
    """Exposure, as ``scene.sensor.white_dn`` [DN]."""
    exposure_ms: RangeFromZero = (0.0, 4.0)
    """Time that the shutter is open [ms]; frames are one second apart."""
    electrons_per_dn: Range = (8.0, 60.0)
    """Conversion gain, which sets the shot noise [electrons/DN]."""
    read_noise_dn: RangeFromZero = (0.5, 2.5)
    """Standard deviation of the read noise [DN]."""
    blur_px: RangeFromZero = (0.3, 0.8)
    """Standard deviation of the lens blur [px]."""
    stars: Share = 0.4
    """Share of the scenes with stars."""
    earth_behind: Share = 0.1
    """Share of the scenes with the Earth's disc in the background."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, tuple) and isinstance(value[0], float) and value[0] > value[1]:
                raise ValueError(f"{name} is (least, most), got {value[0]:g}, {value[1]:g}")
        return self

    def is_validation(self, scene: int) -> bool:
        """Whether scene ``scene``, counted from 0, is held out."""
        return scene % self.validation_every == self.validation_every - 1
