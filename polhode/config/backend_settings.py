"""Settings of the back end."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polhode.config.section import Position, Section

Pixels = Annotated[float, Field(ge=0, le=100)]
Seconds = Annotated[float, Field(ge=-1e9, le=1e9)]


class Window(Section):
    """The sliding window: the causal estimate of each frame, from the frames up to it."""

    enabled: bool = True
    """Write trajectory_online.csv."""
    solver: Literal["ipopt", "gauss_newton"] = "ipopt"
    """What gives the answer of each window: IPOPT, started where Gauss-Newton ends, or Gauss-Newton alone;
    both reach the same optimum."""
    frames: int = Field(12, ge=2, le=1000)
    """Number of latest frames whose full state is estimated."""
    key_frames: int = Field(36, ge=2, le=10_000)
    """Earlier frames whose pose and observations stay: they show sides of the target that will reappear."""
    history: int = Field(96, ge=4, le=10_000)
    """Number of frames that are solved as a batch before the first state is marginalized; if the inertia is
    not determined by then, more frames, thinned out to this number."""


class Bounds(Section):
    """What is known of the body besides its motion, for the intervals of what that does not determine."""

    intervals: bool = True
    """Report the interval that the body's hull leaves to centre of mass, k1 and k2 where the motion does not
    determine them."""
    max_density_ratio: float = Field(8.0, gt=1, le=1000)
    """No part of the convex hull is denser than the mean over the hull by more than this factor: for the
    intervals of k1 and k2. Over the 30 bodies of the scenes and of the campaign of faults, 1.0 to 4.5 explain
    the inertia."""
    com_box_G: tuple[Position, Position] | None = None
    """Least and largest coordinates of the centre of mass in G [m], if they are known."""
    equal_moments: Literal["none", "largest", "smallest"] = "none"
    """The two largest or the two smallest moments are equal: a body that is known to be symmetric about an
    axis."""

    @model_validator(mode="after")
    def _box_is_given(self) -> Self:
        if self.com_box_G is not None and not all(
            low < high for low, high in zip(*self.com_box_G, strict=True)
        ):
            raise ValueError("com_box_G: give the least coordinates first, then the largest [m]")
        return self


CorrelatedErrors = Literal["none", "neighbours", "drift", "slide"]


class Backend(Section):
    """Measurements to motion and mass properties."""

    inertia: Literal["second_moments", "ratios_axes"] = "second_moments"
    """Variables of the inertia: log-Cholesky second moments, or log-ratios and principal axes."""
    solver: Literal["ipopt", "gauss_newton"] = "ipopt"
    """What gives the answer of the whole problem: IPOPT, started where Gauss-Newton ends, or Gauss-Newton
    alone; both reach the same optimum. Where Gauss-Newton does not converge, IPOPT continues in any case."""
    process_noise: Literal["estimated", "given"] = "estimated"
    """Level of the disturbances: by a prior and the data, or exactly accel_psd and torque_psd."""
    level_decades: float = Field(2.0, ge=0.1, le=10)
    """Standard deviation of the prior on the logarithm of each level [decades]. accel_psd and torque_psd are
    one above its median: five of six targets are disturbed less than stated."""
    accel_psd: float = Field(1e-6, ge=1e-30, le=1e6)
    """Disturbance acceleration, power spectral density [(m/s^2)^2/Hz] (thesis eq. 6.14, squared)."""
    torque_psd: float = Field(1e-6, ge=1e-30, le=1e6)
    """Disturbance torque over the middle moment, power spectral density [(rad/s^2)^2/Hz] (thesis eq. 6.15,
    squared)."""
    systematic_px: tuple[Pixels, Pixels, Pixels] = (0.03, 0.03, 0.01)
    """Standard deviations of constant errors of u, v and disparity common to all frames [px], by matching
    (the calibration has its own sigmas). They do not appear in the residuals, and increase the sigma of
    position."""
    correlated_errors: CorrelatedErrors = "slide"
    """What the covariance knows of errors that depend on one another, each with those before it: nothing,
    those of neighbours in one image, a drift of each landmark, a slide of all of them (light_px)."""
    light_px: Pixels = 0.12
    """Standard deviation of a slide of all features along the surface, in a direction that is as fixed as the
    Sun's, seen from the median distance [px]; the slow drift that is measured of single features is added.
    Increases the sigma of all states and constants."""
    wrench_bias: float = Field(0.02, ge=1e-9, le=1e3)
    """Standard deviation of a constant bias of known forces and torques, relative to the largest of each."""
    max_rpm: float | None = Field(None, ge=1e-6, le=1e6)
    """Fastest rotation that the target may have [RPM]: all rotations between pairs up to it are compared, and
    none beyond it. Without it less than half a revolution between pairs is assumed, unless a longer rotation
    fits as well."""
    unknown_wrench: Literal["none", "found", "everywhere"] = "found"
    """Unknown disturbances: none; in the steps between frames that contradict free motion; in every step."""
    unknown_wrench_s: tuple[tuple[Seconds, Seconds], ...] = Field((), max_length=10_000)
    """Intervals with an unknown disturbance, start and end of each in seconds since the first frame."""
    unknown_acceleration: float = Field(0.1, ge=1e-12, le=1e6)
    """Standard deviation of the acceleration by an unknown disturbance [m/s^2]."""
    unknown_angular_acceleration: float = Field(1.0, ge=1e-12, le=1e6)
    """Standard deviation of its angular acceleration [rad/s^2]."""
    mass_kg: float | None = Field(None, ge=1e-9, le=1e12)
    """Mass of the target [kg], if known: with the mesh it sets the scale of the inertia, as an assumption."""
    density_kg_m3: float | None = Field(None, ge=1e-6, le=1e6)
    """Density of the target [kg/m^3], if known and the mass is not: with the mesh it determines mass and
    inertia."""
    robust_scale: float = Field(3.0, ge=0.01, le=1e6)
    """Scale of the Cauchy kernel [standard deviations]; for the last solve it is increased as far as the
    residuals allow."""
    max_iterations: int = Field(200, ge=1, le=1_000_000)
    """Largest number of iterations of a solver (half as many for Gauss-Newton before IPOPT continues); a run
    that needs more fails and keeps the best motion found."""
    max_seconds: float = Field(600.0, ge=1e-9, le=1e8)
    """Time limit of the solution [s]; likewise."""
    bounds: Bounds = Bounds()
    window: Window = Window()

    @property
    def max_rate_rad_s(self) -> float | None:
        """``max_rpm`` [rad/s]."""
        return None if self.max_rpm is None else self.max_rpm * math.pi / 30.0

    @property
    def for_motion(self) -> "Backend":
        """The settings that the estimate from all frames depends on; the others at their defaults."""
        return self.model_copy(update={"bounds": Bounds(), "window": Window()})

    @property
    def for_window(self) -> "Backend":
        """The settings that the causal estimate depends on; the others at their defaults."""
        return self.model_copy(update={"bounds": Bounds()})

    @model_validator(mode="after")
    def _times_in_order(self) -> Self:
        for start_s, end_s in self.unknown_wrench_s:
            if not start_s < end_s:
                raise ValueError(
                    f"unknown_wrench_s: {start_s:g} is not before {end_s:g}; give start and end [s]"
                )
        return self
