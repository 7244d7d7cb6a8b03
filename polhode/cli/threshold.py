"""``polhode threshold``: the rate that separates a tumbling target from a spinning one."""

from typing import Annotated

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positive
from polhode.runtime.errors import InputError


class ThresholdCommand(Command):
    """The rate up to which a target counts as tumbling, above which as spinning (thesis eq. 1.12).

    Prints three rates: up to which the thrusters can keep the inspector's station beside a point of the
    target, up to which its fuel lasts, and the smaller of the two (g0 = 9.81 m/s^2).
    """

    radius_m: Annotated[float, Named("M"), Positive]
    """Distance of the inspector from the spin axis [m]."""
    mass_kg: Annotated[float, Named("KG"), Positive]
    """Mass of the inspector with its fuel [kg]."""
    force_n: Annotated[float, Named("N"), Positive]
    """Maximum force of its thrusters [N]."""
    isp_s: Annotated[float, Named("S"), Positive]
    """Specific impulse [s]."""
    duration_s: Annotated[float, Named("S"), Positive]
    """Duration of station keeping [s]."""
    fuel_fraction: Annotated[float, Named("SHARE"), Field(ge=1e-12, lt=1)]
    """Share of its mass that may be used as fuel, above 0 and below 1."""

    def execute(self) -> Answer:
        """Print the three rates."""
        from polhode.planning.approach.tumbling_threshold import RPM, StationKeeping, threshold

        given = StationKeeping(
            self.radius_m, self.mass_kg, self.force_n, self.isp_s, self.duration_s, self.fuel_fraction
        )
        try:
            rates = threshold(given)
        except ValueError as error:
            raise InputError(f"these values are inconsistent ({error}): check their units") from None
        lines, figures = [], {}
        for name, key, rate in (
            ("omega_Thresh F  (thrust)", "by_thrust_rad_s", rates.by_force),
            ("omega_Thresh Mf (fuel)", "by_fuel_rad_s", rates.by_fuel),
            ("omega_Thresh    (both)", "both_rad_s", rates.overall),
        ):
            # fixed decimals as long as they show significant digits
            digits = ("10.6f", "10.4f") if 0.001 <= rate < 1e5 else ("10.4g", "10.4g")
            lines.append(f"{name:24s} {rate:{digits[0]}} rad/s {rate / RPM:{digits[1]}} RPM")
            figures[key] = rate
        return Answer("\n".join(lines), figures=figures)
