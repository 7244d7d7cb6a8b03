"""Description of a simulated scene: what ``polhode simulate`` renders. Every value carries its unit."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import Section

Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Body(Section):
    """The target's shape and surface, in the geometric frame G."""

    family: Literal["free_flyer", "bus", "asteroid", "mesh"] = "free_flyer"
    """Shape: an 18-faced free flyer, a box bus with two panels, a small rocky body, or a mesh file."""
    size_m: Positive = 0.22
    """Width across flats (free_flyer), length of the bus without panels, or diameter of the sphere of
    the same volume (asteroid) [m]."""
    seed: int | None = None
    """Seed of shape and surface; the config's own seed when absent."""
    path: str | None = None
    """Mesh file (OBJ, STL, PLY, GLB), for family mesh."""
    metres_per_unit: Positive | None = None
    """Length of one unit of the mesh file [m]; mandatory for family mesh, never guessed."""
    contrast: NonNegative = 1.0
    """Factor on the texture's variation of reflectance; 0: no texture."""

    @model_validator(mode="after")
    def _mesh_needs_path_and_unit(self) -> Self:
        if self.family == "mesh" and self.path is None:
            raise ValueError("family mesh needs 'path', the mesh file")
        if self.family == "mesh" and self.metres_per_unit is None:
            raise ValueError("family mesh needs 'metres_per_unit': the scale is never guessed")
        if self.family != "mesh" and (self.path is not None or self.metres_per_unit is not None):
            raise ValueError("'path' and 'metres_per_unit' belong to family mesh only")
        return self


class Mass(Section):
    """Mass properties: set by hand, or of uniform density where absent."""

    com_m: Vector3 | None = None
    """Centre of mass in G [m]; that of uniform density when absent."""
    inertia_kg_m2: tuple[Vector3, Vector3, Vector3] | None = None
    """Inertia about the centre of mass, axes of G [kg m^2]; that of uniform density when absent."""
    density_kg_m3: Positive = 1000.0
    """Density of uniform bodies [kg/m^3]; only ratios of the inertia show in the motion."""


class Motion(Section):
    """The target's state at the first frame. Torque-free from there on."""

    position_m: Vector3 = (0.0, 0.0, 0.6)
    """Centre of mass in N [m]."""
    velocity_mm_s: Vector3 = (0.0, 0.0, 0.0)
    """Velocity of the centre of mass in N [mm/s]."""
    attitude_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector of R_NG [deg]."""
    spin_rpm: Vector3 = (0.0, 0.0, 0.0)
    """Angular velocity relative to N, in the axes named by ``spin_axes`` [RPM]."""
    spin_axes: Literal["geometric", "principal"] = "geometric"
    """Axes of ``spin_rpm``: those of G, or the principal axes (greatest moment first)."""


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


class Inspector(Section):
    """Motion of the camera: the pose of the left camera in N over time, written as X_NB to inspector0."""

    profile: Literal["rest", "drift", "circle"] = "rest"
    """At rest (then N is the left camera at the first frame), free drift, or a circle around a point."""
    position_m: Vector3 = (0.0, 0.0, 0.0)
    """Left camera in N at the first frame [m]; zero for rest."""
    attitude_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector R_NC of the left camera at the first frame [deg]; zero for rest."""
    velocity_mm_s: Vector3 = (0.0, 0.0, 0.0)
    """Drift: velocity of the left camera in N [mm/s]."""
    rate_deg_s: Vector3 = (0.0, 0.0, 0.0)
    """Drift: angular velocity of the left camera, in its own axes [deg/s]."""
    circle_period_s: Positive = 600.0
    """Circle: time of one revolution [s]."""
    circle_axis: Vector3 = (0.0, 1.0, 0.0)
    """Circle: axis in N through the target's first position; the camera keeps facing that point."""
    sigma_p_m: NonNegative = 0.0
    """Standard deviation of the noise on the reported position [m]."""
    sigma_theta_deg: NonNegative = 0.0
    """Standard deviation of the noise on the reported attitude [deg]."""

    @model_validator(mode="after")
    def _rest_defines_N(self) -> Self:
        if self.profile == "rest" and (any(self.position_m) or any(self.attitude_deg)):
            raise ValueError(
                "profile rest puts N at the left camera: leave position_m and attitude_deg at zero"
            )
        return self


class Light(Section):
    """What lights the target. Intensities are reflected levels of a white surface that faces the light."""

    sun_direction_N: Vector3 = (0.55, -0.5, -0.7)
    """From the target towards the Sun, in N; any length."""
    sun: NonNegative = 1.0
    """Sunlight; 1 brings a white surface to ``white_dn``."""
    earth_direction_N: Vector3 = (-0.3, 0.9, 0.2)
    """From the target towards the Earth, which fills the shadows."""
    earth: NonNegative = 0.15
    """Light of the Earth's disc relative to a white surface in sunlight."""
    lamp: NonNegative = 0.0
    """Inspector's lamp beside the left camera: its light at 1 m, relative to sunlight."""
    lamp_position_m: Vector3 = (0.045, -0.06, 0.0)
    """The lamp in the left camera's frame [m]."""


class Sensor(Section):
    """From radiance to 8-bit grey values."""

    white_dn: Positive = 450.0
    """Grey value of a white diffuse surface that faces the Sun; above 255 it saturates [DN]."""
    electrons_per_dn: Positive = 40.0
    """Conversion gain: sets the shot noise [electrons/DN]."""
    read_noise_dn: NonNegative = 0.8
    """Standard deviation of the read noise [DN]."""
    black_level_dn: float = 1.0
    """Grey value of no light; below zero the black sky clips to 0 and compresses [DN]."""
    blur_px: NonNegative = 0.4
    """Standard deviation of the lens blur [px]."""


class Render(Section):
    """Quality of the images."""

    samples: Literal[1, 4, 9, 16] = 4
    """Rays a pixel."""
    masks: bool = False
    """Write target masks to masks0 and masks1."""


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
