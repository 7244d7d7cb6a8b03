"""How target and inspector move."""

from itertools import pairwise
from typing import Literal, Self

from pydantic import model_validator

from polhode.config.section import NonNegative, Positive, Section, Share, Vector3


class Push(Section):
    """A force and a torque on the target over a span of time; spans that overlap add up."""

    start_s: NonNegative = 0.0
    """Start after the first frame [s]."""
    duration_s: Positive = 1.0
    """How long it lasts [s]."""
    force_N: Vector3 = (0.0, 0.0, 0.0)
    """Force on the centre of mass, in N [N]."""
    torque_P: Vector3 = (0.0, 0.0, 0.0)
    """Torque in the principal axes [N m]."""
    period_s: Positive | None = None
    """Period of a sine that starts at zero [s]; constant when absent."""


class Motion(Section):
    """The target's state at the first frame, and what acts on it: nothing, unless asked for."""

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
    accel_psd: NonNegative = 0.0
    """Disturbing force: power spectral density of the white acceleration, each axis [(m/s^2)^2/Hz]."""
    torque_psd: NonNegative = 0.0
    """Disturbing torque over the middle moment: power spectral density, each axis [(rad/s^2)^2/Hz]."""
    pushes: tuple[Push, ...] = ()
    """Known forces and torques, each with start_s, duration_s, force_N (in N), torque_P, period_s."""
    pushes_known: bool = True
    """Write the pushes to wrench0/ for the estimator; false: it is not told."""
    energy_loss: Share = 0.0
    """Share of the rotational energy lost in ``energy_loss_s``; the thesis's target lost 0.078 in 80 s."""
    energy_loss_by: Literal["drag", "friction"] = "drag"
    """Drag opposes the angular momentum, as air does. Friction inside the body keeps the momentum and turns
    the spin towards the greatest axis; ``energy_loss`` is then the share of the energy above that of a spin
    about it."""
    energy_loss_s: Positive = 80.0
    """Time over which ``energy_loss`` is counted [s]."""


class Waypoint(Section):
    """Where the left camera is at one time."""

    t_s: NonNegative = 0.0
    """Time after the first frame [s]."""
    position_m: Vector3 = (0.0, 0.0, 0.0)
    """Left camera in N [m]."""
    attitude_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector R_NC of the left camera [deg]."""


class Inspector(Section):
    """Motion of the camera: the pose of the left camera in N over time, written as X_NB to inspector0."""

    profile: Literal["rest", "drift", "circle", "approach", "waypoints"] = "rest"
    """At rest (then N is the left camera at the first frame), free drift, a circle around a point, a straight
    approach, or through given poses. ``deadband_...`` adds jitter to each of them."""
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
    approach_mm_s: Positive = 5.0
    """Approach: closing speed along the line to the target's first position [mm/s]; the attitude stays."""
    approach_stop_m: Positive = 0.5
    """Approach: distance from that point at which the camera stops [m]."""
    waypoints: tuple[Waypoint, ...] = ()
    """Waypoints: poses in order of time, joined by smooth curves; the first and last pose hold outside."""
    deadband_mm: NonNegative = 0.0
    """Limit cycle of the position control: half width of the band, each axis [mm]."""
    deadband_mm_s: NonNegative = 1.0
    """Drift rate inside the band [mm/s], a little different after each thruster pulse."""
    deadband_deg: NonNegative = 0.0
    """Limit cycle of the attitude control: half width of the band, each axis [deg]."""
    deadband_deg_s: NonNegative = 0.3
    """Drift rate inside the band [deg/s]."""
    sigma_p_m: NonNegative = 0.0
    """Standard deviation of the noise on the reported position [m]."""
    sigma_theta_deg: NonNegative = 0.0
    """Standard deviation of the noise on the reported attitude [deg]."""
    reported: bool = True
    """Write the poses to inspector0/; false: the estimator takes a camera at rest. Only for profile rest."""

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
