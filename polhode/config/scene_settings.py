"""Description of a simulated scene: what ``polhode simulate`` renders. Every value carries its unit."""

import math
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import (
    AngularVelocity,
    Direction,
    Position,
    RotationVector,
    Section,
    Seed,
    Share,
    Velocity,
)

MAX_PIXELS = 64_000_000
"""Of an image, as it is read (polhode/files/images.py)."""
MAX_ROWS = 500_000
"""Of the truth: images and times after them."""
MAX_DURATION_S = 1e8
MAX_TURNS = 1e4
"""Revolutions of the target, crossings of a dead band."""
Density = Annotated[float, Field(ge=1e-6, le=1e6)]
_Moment = Annotated[float, Field(ge=-1e18, le=1e18)]
MomentRow = tuple[_Moment, _Moment, _Moment]
_Component = Annotated[float, Field(ge=-1e12, le=1e12)]
Wrench = tuple[_Component, _Component, _Component]
Pixels = Annotated[float, Field(ge=-1e5, le=1e5)]
Side = Annotated[int, Field(ge=16, le=8192)]
Coefficient = Annotated[float, Field(ge=-1e7, le=1e7)]


class TargetBody(Section):
    """The target's shape and surface, in the geometric frame G."""

    family: Literal["free_flyer", "bus", "upper_stage", "dish", "truss", "cubesat", "asteroid", "mesh"] = (
        "free_flyer"
    )
    """Shape: an 18-faced free flyer, a box bus with two panels, an upper stage with its nozzle, a dish
    antenna on a small bus, an open truss with equipment, a cubesat, a small rocky body, or a mesh file."""
    size_m: float = Field(0.22, ge=1e-3, le=1e4)
    """Width across flats (free_flyer), length without panels (bus, cubesat), length (upper_stage, truss),
    diameter of the dish (dish), or of the sphere of the same volume (asteroid) [m]; not for mesh."""
    seed: Seed | None = None
    """Seed of shape and surface; the config's own seed when absent."""
    texture_seed: Seed | None = None
    """Seed of what is drawn on the surface and of its materials' grain and relief; that of the shape when
    absent. Bodies that differ in it alone have one shape and several albedos."""
    path: str | None = None
    """Mesh file (OBJ, STL, PLY, GLB), for family mesh."""
    metres_per_unit: float | None = Field(None, ge=1e-9, le=1e9)
    """Length of one unit of the mesh file [m]; mandatory for family mesh, never guessed."""
    material: Literal["automatic", "paint", "solar_cell", "foil", "metal", "regolith"] = "automatic"
    """Surface: that of the family or of the mesh file, or one material for the whole body."""
    texture: Literal["drawn", "collage"] = "drawn"
    """Generator of the texture. Two that have nothing in common, so that training and testing can be
    separated: stickers, lettering and lattice noise; or overlapping shapes of all sizes and noise of random
    spots."""
    contrast: float = Field(1.0, ge=0, le=100)
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
    """Mass properties: set by hand, or by the density of the parts where absent."""

    com_m: Position | None = None
    """Centre of mass in G [m]; that of the parts' densities when absent."""
    inertia_kg_m2: tuple[MomentRow, MomentRow, MomentRow] | None = None
    """Inertia about the centre of mass, axes of G [kg m^2]; that of the parts' densities when absent."""
    density_kg_m3: Density = 1000.0
    """Density of parts that ``part_density_kg_m3`` does not name [kg/m^3]."""
    part_density_kg_m3: dict[str, Density] = Field(default_factory=dict)
    """Density by the part's name [kg/m^3]; an unknown name is refused with the list of parts."""
    mass_kg: float | None = Field(None, ge=1e-9, le=1e12)
    """Mass [kg]; scales the inertia of the densities, and turns known forces into accelerations. That of the
    densities when absent."""


class WrenchPulse(Section):
    """A constant force and torque on the target over an interval; those of overlapping intervals add up."""

    start_s: float = Field(0.0, ge=0, le=1e8)
    """Start, after the first frame [s]."""
    duration_s: float = Field(1.0, ge=1e-6, le=1e8)
    """Duration [s]."""
    force_N: Wrench = (0.0, 0.0, 0.0)
    """Force on the centre of mass, in N [N]."""
    torque_P: Wrench = (0.0, 0.0, 0.0)
    """Torque in the principal axes [N m]."""


class Motion(Section):
    """The target's state at the first frame, and the disturbances: none by default."""

    position_m: Position = (0.0, 0.0, 0.6)
    """Centre of mass in N [m]."""
    velocity_mm_s: Velocity = (0.0, 0.0, 0.0)
    """Velocity of the centre of mass in N [mm/s]."""
    attitude_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector of R_NG [deg]."""
    spin_rpm: AngularVelocity = (0.0, 0.0, 0.0)
    """Angular velocity relative to N, in the axes named by ``spin_axes`` [RPM]."""
    spin_axes: Literal["geometric", "principal"] = "geometric"
    """Axes of ``spin_rpm``: those of G, or the principal axes (greatest moment first)."""
    accel_psd: float = Field(0.0, ge=0, le=1e6)
    """Disturbing force: power spectral density of the white acceleration, each axis [(m/s^2)^2/Hz]."""
    torque_psd: float = Field(0.0, ge=0, le=1e6)
    """Disturbing torque over the middle moment: power spectral density, each axis [(rad/s^2)^2/Hz]."""
    pushes: tuple[WrenchPulse, ...] = Field((), max_length=1000)
    """Known forces and torques, each with start_s, duration_s, force_N (in N), torque_P."""
    pushes_known: bool = True
    """Write them to wrench0/ for the estimator; false: they are unknown to it."""
    energy_loss: Share = 0.0
    """Share of the rotational energy lost in ``energy_loss_s``; the thesis's target lost 0.078 in 80 s."""
    energy_loss_by: Literal["drag", "friction"] = "drag"
    """Drag opposes the angular momentum, as air does. Friction inside the body conserves the momentum and
    turns the spin towards the axis of the greatest moment; ``energy_loss`` is then the share of the energy
    above that of a spin about this axis."""
    energy_loss_s: float = Field(80.0, ge=1e-3, le=1e9)
    """Time in which ``energy_loss`` is lost [s]."""


class Waypoint(Section):
    """Pose of the left camera at one time."""

    t_s: float = Field(0.0, ge=0, le=1e8)
    """Time after the first frame [s]."""
    position_m: Position = (0.0, 0.0, 0.0)
    """Left camera in N [m]."""
    attitude_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector R_NC of the left camera [deg]."""


class Inspector(Section):
    """Motion of the camera: the pose of the left camera in N over time, written as X_NB to inspector0."""

    profile: Literal["rest", "drift", "circle", "approach", "waypoints"] = "rest"
    """At rest (then N is the left camera at the first frame), free drift, a circle around a point, a straight
    approach, or through given poses. ``deadband_...`` adds jitter to each of them."""
    position_m: Position = (0.0, 0.0, 0.0)
    """Left camera in N at the first frame [m]; zero for rest."""
    attitude_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector R_NC of the left camera at the first frame [deg]; zero for rest."""
    velocity_mm_s: Velocity = (0.0, 0.0, 0.0)
    """Drift: velocity of the left camera in N [mm/s]."""
    rate_deg_s: AngularVelocity = (0.0, 0.0, 0.0)
    """Drift: angular velocity of the left camera, in its own axes [deg/s]."""
    circle_period_s: float = Field(600.0, ge=0.1, le=1e9)
    """Circle: time of one revolution [s]."""
    circle_axis: Direction = (0.0, 1.0, 0.0)
    """Circle: axis in N through the target's first position; the camera keeps facing that point."""
    approach_mm_s: float = Field(5.0, ge=1e-6, le=1e7)
    """Approach: closing speed along the line to the target's first position [mm/s]; the attitude stays."""
    approach_stop_m: float = Field(0.5, ge=1e-3, le=1e6)
    """Approach: distance from that point at which the camera stops [m]."""
    waypoints: tuple[Waypoint, ...] = Field((), max_length=100_000)
    """Waypoints: poses in order of time, joined by smooth curves; constant before the first and after the
    last."""
    deadband_mm: float = Field(0.0, ge=0, le=1e6)
    """Limit cycle of the position control: half width of the band, each axis [mm]."""
    deadband_mm_s: float = Field(1.0, ge=0, le=1e6)
    """Drift rate inside the band [mm/s], a little different after each thruster pulse."""
    deadband_deg: float = Field(0.0, ge=0, le=180)
    """Limit cycle of the attitude control: half width of the band, each axis [deg]."""
    deadband_deg_s: float = Field(0.3, ge=0, le=1e4)
    """Drift rate inside the band [deg/s]."""
    sigma_p_m: float = Field(0.0, ge=0, le=1e4)
    """Standard deviation of the noise on the reported position [m]."""
    sigma_theta_deg: float = Field(0.0, ge=0, le=180)
    """Standard deviation of the noise on the reported attitude [deg]."""
    reported: bool = True
    """Write the poses to inspector0/; false: the estimator assumes a camera at rest. Only for profile
    rest."""

    @model_validator(mode="after")
    def _rest_defines_N(self) -> Self:
        if self.profile == "rest" and (any(self.position_m) or any(self.attitude_deg)):
            raise ValueError(
                "profile rest puts N at the left camera: leave position_m and attitude_deg at zero"
            )
        if self.profile != "rest" and not self.reported:
            raise ValueError("only profile rest may leave its poses unreported: set 'reported' to true")
        return self

    @model_validator(mode="after")
    def _waypoints_are_in_order(self) -> Self:
        times = [point.t_s for point in self.waypoints]
        if self.profile == "waypoints" and len(times) < 2:
            raise ValueError("profile waypoints needs at least two 'waypoints'")
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("'waypoints' must be in order of time, each later than the one before")
        return self

    @property
    def moves(self) -> bool:
        """Whether the camera leaves its first pose."""
        return self.profile != "rest" or self.deadband_mm > 0 or self.deadband_deg > 0


class Rig(Section):
    """The stereo camera. Camera frames: x right, y down, z forward."""

    width_px: int = Field(640, ge=16, le=8192)
    """Image width [px]."""
    height_px: int = Field(480, ge=16, le=8192)
    """Image height [px]."""
    focal_px: float = Field(467.0, ge=1, le=1e8)
    """Focal length of both cameras, unless ``right_focal_px`` is given [px]."""
    baseline_m: float = Field(0.09, ge=1e-4, le=1e4)
    """Distance between the cameras, along x of the left one [m]."""
    principal_offset_px: tuple[Pixels, Pixels] = (0.0, 0.0)
    """Principal point minus image centre (u, v), left camera; the right one has the opposite sign [px]."""
    distortion: tuple[Coefficient, Coefficient, Coefficient, Coefficient] = (0.0, 0.0, 0.0, 0.0)
    """Distortion of the left camera: k1, k2, p1, p2 of the lens ``radial-tangential``, k1, k2, k3, k4 of
    ``equidistant``."""
    distortion_right: tuple[Coefficient, Coefficient, Coefficient, Coefficient] | None = None
    """The same of the right camera; by default that of the left one."""
    lens: Literal["radial-tangential", "equidistant"] = "radial-tangential"
    """A pinhole with radial-tangential distortion, or a fisheye, of both cameras."""
    right_size_px: tuple[Side, Side] | None = None
    """Width and height of the right image [px]; by default those of the left one."""
    right_focal_px: float | None = Field(None, ge=1, le=1e8)
    """Focal length of the right camera [px]; by default that of the left one."""
    right_offset_mm: Position = (0.0, 0.0, 0.0)
    """Position of the right camera minus (baseline, 0, 0), in the left camera's axes [mm]."""
    right_rotation_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector of the right camera in the left one [deg]; a negative y component toes it in."""
    mount_position_m: Position = (0.0, 0.0, 0.0)
    """Position of the left camera in the inspector's body frame B [m]."""
    mount_rotation_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector R_BC of the left camera in B [deg]."""
    calibration_errors: float = Field(0.0, ge=0, le=100)
    """Errors of the written calibration: a draw from the default sigmas of a good laboratory calibration,
    times this factor, which sensor.yaml then states; 0: it is exact, and says so."""

    @model_validator(mode="after")
    def _images_can_be_read(self) -> Self:
        for width, height in ((self.width_px, self.height_px), self.right_size_px or (1, 1)):
            if width * height > MAX_PIXELS:
                raise ValueError(
                    f"{width}x{height} px are more than {MAX_PIXELS // 10**6} million; give fewer"
                )
        return self


class RangeSensor(Section):
    """Range images beside the left camera's images, in the place of the right camera (flash LIDAR, RGB-D)."""

    enabled: bool = False
    """Make range images."""
    sigma_m: float = Field(0.003, ge=1e-6, le=1e3)
    """Standard deviation of the depth of a pixel, at no distance [m]."""
    growth_per_m: float = Field(0.0, ge=0, le=1e3)
    """Part of it that grows with the square of the depth, as of sensors that triangulate [1/m]."""
    scale_m: float = Field(1e-4, ge=1e-7, le=10)
    """Unit of the 16-bit images [m]; 65535 of them are the largest depth."""
    edge_dropouts: Share = 0.5
    """Probability that a pixel at an edge has no measurement."""
    mixed_pixels: Share = 0.3
    """Probability that a pixel between two surfaces has a depth between theirs."""
    max_incidence_deg: float = Field(80.0, ge=1, le=90)
    """Angle between viewing ray and normal beyond which a surface returns nothing [deg]."""


class Sensor(Section):
    """From radiance to grey values. DN: 1/255 of full scale, whatever the number of bits."""

    white_dn: float = Field(450.0, ge=1e-3, le=1e9)
    """Grey value of a white diffuse surface that faces the Sun; above 255 it saturates [DN]."""
    exposure_ms: float = Field(1.0, ge=0, le=1e4)
    """Exposure time of the global shutter, centred on the timestamp: motion blur [ms]."""
    electrons_per_dn: float = Field(40.0, ge=1e-3, le=1e6)
    """Conversion gain: sets the shot noise [electrons/DN]."""
    read_noise_dn: float = Field(0.8, ge=0, le=1e4)
    """Standard deviation of the read noise [DN]."""
    black_level_dn: float = Field(1.0, ge=-1e4, le=1e4)
    """Grey value of no light; below zero the black sky clips to 0 and compresses [DN]."""
    bits: Literal[8, 10, 12] = 8
    """Depth of the images; above 8 they are written as 16-bit files."""
    blur_px: float = Field(0.4, ge=0, le=50)
    """Standard deviation of the lens blur [px]."""
    glare: Share = 0.0
    """Share of the light that the lens scatters into a wide halo."""
    glare_px: float = Field(12.0, ge=0.01, le=500)
    """Standard deviation of that halo [px]."""
    vignetting: Share = 0.1
    """Loss of light in the corner of the image; grows with the square of the distance from the centre."""
    full_well_dn: float = Field(1500.0, ge=1, le=1e9)
    """Full-well capacity of a pixel [DN]; charge beyond it blooms or is lost."""
    bloom: Share = 0.0
    """Share of the charge beyond the full well that spills to the neighbours in the column."""
    dropped_frames: tuple[Annotated[int, Field(ge=0, le=MAX_ROWS)], ...] = ()
    """Frames, counted from 0, that are lost and not written."""
    drop_probability: Share = 0.0
    """Probability that any other frame is lost."""


Product = Literal["depth", "normals", "mask", "shadow", "albedo"]


class Render(Section):
    """Quality of the images, and additional files."""

    samples: Literal[1, 4, 9, 16] = 4
    """Rays in a pixel."""
    scattered: bool = True
    """Shift the rays of each pixel at random. One pattern for all pixels displaces edges of some slopes by up
    to an eighth of a pixel."""
    bounces: Literal[0, 1] = 1
    """Reflections of light from one part of the body onto another; 0: direct light only."""
    masks: bool = False
    """Write target masks to masks0 and masks1."""
    products: tuple[Product, ...] = ()
    """Truth of every pixel, written to truth0 and truth1: depth along the optical axis [m], normals in the
    camera's axes, target mask, shadow mask, albedo."""


class Eclipse(Section):
    """The Earth's shadow: no Sun, and a dark Earth."""

    start_s: float = Field(10.0, ge=0, le=1e8)
    """First moment without direct sunlight, after the first frame [s]."""
    duration_s: float = Field(0.0, ge=0, le=1e8)
    """Duration of the darkness [s]; 0: no eclipse."""
    ramp_s: float = Field(1.0, ge=0, le=1e8)
    """Duration of the penumbra before and after it [s]."""


class Light(Section):
    """Light on the target. Intensities are reflected levels of a white surface that faces the light."""

    sun_direction_N: Direction = (0.55, -0.5, -0.7)
    """From the target towards the Sun, in N; any length."""
    sun: float = Field(1.0, ge=0, le=1e6)
    """Sunlight; 1 brings a white surface to ``white_dn``."""
    sun_diameter_deg: float = Field(0.533, ge=0, le=90)
    """Angular diameter: softens the shadows' edges; 0: a point [deg]."""
    earth_direction_N: Direction = (-0.3, 0.9, 0.2)
    """From the target towards the middle of the Earth, which fills the shadows."""
    earth: float = Field(0.15, ge=0, le=1e6)
    """Radiance of the Earth's disc relative to a white surface in sunlight."""
    earth_radius_deg: float = Field(66.0, ge=0.01, le=90)
    """Angular radius of the Earth's disc: 66 degrees at 600 km [deg]."""
    earth_rate_deg_s: AngularVelocity = (0.0, 0.0, 0.0)
    """Angular velocity of the direction to the Earth, in N, by the orbit: 0.062 deg/s at 600 km, where the
    ground then passes below at up to 0.7 deg/s [deg/s]."""
    lamp: float = Field(0.0, ge=0, le=1e9)
    """Inspector's lamp beside the left camera: its light at 1 m, relative to sunlight."""
    lamp_position_m: Position = (0.045, -0.06, 0.0)
    """The lamp in the left camera's frame [m]."""
    eclipse: Eclipse = Eclipse()


class Wall(Section):
    """A plane with a random pattern behind the target, evenly lit: a laboratory's wall. No shadow falls on
    it, and it sheds no light on the target."""

    distance_m: float = Field(0.0, ge=0, le=1e6)
    """Where it crosses the z axis of N; 0: there is no wall [m]."""
    turn_deg: RotationVector = (0.0, 0.0, 0.0)
    """Rotation vector of the wall from the position square to z of N [deg]."""
    brightness: float = Field(0.25, ge=0, le=1e6)
    """Radiance of a white part of it, relative to a white surface in sunlight."""
    contrast: float = Field(1.0, ge=0, le=100)
    """Factor on the pattern's variation of reflectance; 0: a plain wall."""
    pattern_m: float = Field(0.15, ge=1e-4, le=1e4)
    """Size of its patches [m]."""


class Background(Section):
    """The background of the images; a black sky by default."""

    stars: bool = False
    """Stars, fixed in N, random by the seed of the scene."""
    star_dn: float = Field(200.0, ge=1e-3, le=1e9)
    """Grey value, in its brightest pixel, of a star of magnitude 0 [DN]."""
    faintest_magnitude: float = Field(6.5, ge=-30, le=30)
    """Fainter stars are omitted; there are about 9000 in the sky up to magnitude 6.5."""
    earth: bool = False
    """The Earth's disc with clouds and a thin bright limb, in the direction ``light.earth_direction_N``."""
    wall: Wall = Wall()


class Scene(Section):
    """What ``polhode simulate`` renders."""

    frames: int = Field(115, ge=1, le=MAX_ROWS)
    """Number of stereo pairs."""
    interval_s: float = Field(0.5, ge=1e-6, le=1e6)
    """Time between pairs [s]."""
    truth_horizon_s: float = Field(60.0, ge=0, le=1e7)
    """Time that the truth covers after the last image [s]."""
    start_ns: int = Field(1_600_000_000_000_000_000, ge=0, le=4 * 10**18)
    """Timestamp of the first pair [ns]."""
    body: TargetBody = TargetBody()
    mass: Mass = Mass()
    motion: Motion = Motion()
    rig: Rig = Rig()
    range_sensor: RangeSensor = RangeSensor()
    """A range sensor in the place of the right camera, if enabled."""
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

    @property
    def ranges(self) -> RangeSensor | None:
        """The range sensor; None: a stereo pair."""
        return self.range_sensor if self.range_sensor.enabled else None

    @property
    def duration_s(self) -> float:
        """Of the images and of the truth after them [s]."""
        return self.frames * self.interval_s + self.truth_horizon_s

    @model_validator(mode="after")
    def _has_an_end(self) -> Self:
        """What multiplies to more than a machine can compute, though each setting is within its range."""
        rows = self.frames + self.truth_horizon_s / self.interval_s
        if rows > MAX_ROWS:
            raise ValueError(
                f"frames and truth_horizon_s over interval_s make {rows:.3g} rows, above {MAX_ROWS:g}"
            )
        if self.duration_s > MAX_DURATION_S:
            raise ValueError(f"frames times interval_s and truth_horizon_s exceed {MAX_DURATION_S:g} s")
        turns = math.hypot(*self.motion.spin_rpm) / 60.0 * self.duration_s
        if turns > MAX_TURNS:
            raise ValueError(f"motion.spin_rpm makes {turns:.3g} revolutions in all, above {MAX_TURNS:g}")
        steered = self.inspector
        for name, width, rate in (
            ("deadband_mm", steered.deadband_mm, steered.deadband_mm_s),
            ("deadband_deg", steered.deadband_deg, steered.deadband_deg_s),
        ):
            if width > 0.0 and rate * self.duration_s / width > MAX_TURNS:
                raise ValueError(
                    f"inspector.{name} is crossed more than {MAX_TURNS:g} times; give a wider band"
                )
        return self

    @model_validator(mode="after")
    def _dropped_frames_exist(self) -> Self:
        for frame in self.sensor.dropped_frames:
            if not 0 <= frame < self.frames:
                raise ValueError(
                    f"sensor.dropped_frames: there is no frame {frame}, only 0 to {self.frames - 1}"
                )
        return self
