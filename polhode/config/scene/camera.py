"""The cameras, the sensor, and how well the images are made."""

from typing import Literal

from pydantic import Field

from polhode.config.section import NonNegative, Positive, Section, Share, Vector3


class Rig(Section):
    """The stereo camera. Camera frames: x right, y down, z forward."""

    width_px: int = Field(640, ge=16, le=8192)
    """Image width [px]."""
    height_px: int = Field(480, ge=16, le=8192)
    """Image height [px]."""
    focal_px: Positive = 467.0
    """Focal length of both cameras [px]."""
    baseline_m: Positive = 0.09
    """Distance between the cameras, along x of the left one [m]."""
    principal_offset_px: tuple[float, float] = (0.0, 0.0)
    """Principal point minus image centre (u, v), left camera; the right one has the opposite sign [px]."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Radial-tangential distortion k1, k2, p1, p2 of the left camera."""
    distortion_right: tuple[float, float, float, float] | None = None
    """The same of the right camera; as the left one when absent."""
    right_offset_mm: Vector3 = (0.0, 0.0, 0.0)
    """Position of the right camera minus (baseline, 0, 0), in the left camera's axes [mm]."""
    right_rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector of the right camera in the left one [deg]; a negative y component toes it in."""
    mount_position_m: Vector3 = (0.0, 0.0, 0.0)
    """Position of the left camera in the inspector's body frame B [m]."""
    mount_rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector R_BC of the left camera in B [deg]."""


class Sensor(Section):
    """From radiance to grey values. DN: 1/255 of full scale, whatever the number of bits."""

    white_dn: Positive = 450.0
    """Grey value of a white diffuse surface that faces the Sun; above 255 it saturates [DN]."""
    exposure_ms: NonNegative = 1.0
    """Time that the global shutter is open, centred on the timestamp: blurs what moves [ms]."""
    electrons_per_dn: Positive = 40.0
    """Conversion gain: sets the shot noise [electrons/DN]."""
    read_noise_dn: NonNegative = 0.8
    """Standard deviation of the read noise [DN]."""
    black_level_dn: float = 1.0
    """Grey value of no light; below zero the black sky clips to 0 and compresses [DN]."""
    bits: Literal[8, 10, 12] = 8
    """Depth of the images; above 8 they are written as 16-bit files."""
    blur_px: NonNegative = 0.4
    """Standard deviation of the lens blur [px]."""
    glare: Share = 0.0
    """Share of the light that the lens scatters into a wide halo."""
    glare_px: Positive = 12.0
    """Standard deviation of that halo [px]."""
    vignetting: Share = 0.1
    """Loss of light in the corner of the image; grows with the square of the distance from the centre."""
    full_well_dn: Positive = 1500.0
    """Charge that a pixel holds [DN]; what is beyond it blooms or is lost."""
    bloom: Share = 0.0
    """Share of the charge beyond the full well that spills along the column to the neighbours."""
    dropped_frames: tuple[int, ...] = ()
    """Frames, counted from 0, that never reach the disk."""
    drop_probability: Share = 0.0
    """Probability that any other frame is lost."""


Product = Literal["depth", "normals", "mask", "shadow", "albedo"]


class Render(Section):
    """Quality of the images, and what is written beside them."""

    samples: Literal[1, 4, 9, 16] = 4
    """Rays a pixel."""
    bounces: Literal[0, 1] = 1
    """Reflections of light from one part of the body onto another; 0: direct light only."""
    masks: bool = False
    """Write target masks to masks0 and masks1."""
    products: tuple[Product, ...] = ()
    """Truth of every pixel, written to truth0 and truth1: depth along the optical axis [m], normals in the
    camera's axes, target mask, shadow mask, albedo."""
