"""The subcommands of ``polhode`` for planners: threshold. Heavy imports wait for the call."""

import math
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, arg

from polhode.errors import InputError

_Debug = FlagCreatePairsOff[bool]


@dataclass(frozen=True)
class Threshold:
    """Up to which rate a target counts as tumbling, not spinning (thesis eq. 1.12, g0 = 9.81 m/s^2).

    Prints three rates: up to which the thrusters can hold the place beside it, up to which the fuel lasts,
    and the smaller of the two.
    """

    radius_m: Annotated[float, arg(metavar="M")]
    """Distance of the inspector from the spin axis [m]."""
    mass_kg: Annotated[float, arg(metavar="KG")]
    """Mass of the inspector with its fuel [kg]."""
    force_n: Annotated[float, arg(metavar="N")]
    """Most force of its thrusters [N]."""
    isp_s: Annotated[float, arg(metavar="S")]
    """Specific impulse [s]."""
    duration_s: Annotated[float, arg(metavar="S")]
    """How long it stays [s]."""
    fuel_fraction: Annotated[float, arg(metavar="SHARE")]
    """Share of its mass that may be used as fuel, above 0 and below 1."""
    debug: _Debug = False
    """Show the traceback of an error."""

    def execute(self) -> int:
        """Print the three rates."""
        from planning.threshold import RPM, StationKeeping, threshold

        for name in ("radius_m", "mass_kg", "force_n", "isp_s", "duration_s", "fuel_fraction"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number above 0")
        if self.fuel_fraction >= 1.0:
            raise InputError(f"--fuel-fraction {self.fuel_fraction:g}: give a share of the mass, below 1")
        found = threshold(
            StationKeeping(
                self.radius_m, self.mass_kg, self.force_n, self.isp_s, self.duration_s, self.fuel_fraction
            )
        )
        for name, rate in (
            ("omega_Thresh F  (thrust)", found.by_force),
            ("omega_Thresh Mf (fuel)", found.by_fuel),
            ("omega_Thresh    (both)", found.overall),
        ):
            print(f"{name:24s} {rate:10.6f} rad/s {rate / RPM:10.4f} RPM")
        return 0
