"""The subcommands of ``polhode`` for planners: threshold and plan. Heavy imports wait for the call."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg

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
        from polhode.planning.approach.threshold import RPM, StationKeeping, threshold

        for name in ("radius_m", "mass_kg", "force_n", "isp_s", "duration_s", "fuel_fraction"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number above 0")
        if self.fuel_fraction >= 1.0:
            raise InputError(f"--fuel-fraction {self.fuel_fraction:g}: give a share of the mass, below 1")
        given = StationKeeping(
            self.radius_m, self.mass_kg, self.force_n, self.isp_s, self.duration_s, self.fuel_fraction
        )
        try:
            found = threshold(given)
        except ValueError as error:
            raise InputError(f"these values make no sense together ({error}): check their units") from None
        for name, rate in (
            ("omega_Thresh F  (thrust)", found.by_force),
            ("omega_Thresh Mf (fuel)", found.by_fuel),
            ("omega_Thresh    (both)", found.overall),
        ):
            # fixed digits down to where they would end in nothing but noughts
            digits = ("10.6f", "10.4f") if 0.001 <= rate < 1e5 else ("10.4g", "10.4g")
            print(f"{name:24s} {rate:{digits[0]}} rad/s {rate / RPM:{digits[1]}} RPM")
        return 0


@dataclass(frozen=True)
class PlanAhead:
    """What planners take from a run: keep-out volumes, speeds of the surface, corridor of a docking point.

    Writes keepout.ply and .glb (N), surface_speed.ply (G), corridor.csv (N), planning.json into a folder.
    """

    run: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a finished run."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder of the results; files of the same names are replaced."""
    horizon: Annotated[float, arg(metavar="S")] = 60.0
    """How far to look ahead of the last stereo pair [s]."""
    confidence: Annotated[float, arg(metavar="SHARE")] = 0.99
    """Probability with which the whole surface stays inside the volume at all instants, 0.5 to 0.999."""
    cover: Literal["auto", "surface", "hull"] = "auto"
    """What is kept out of: the measured surface and what it encloses, or its convex hull; auto: the hull
    where open rims span more than 1 % of the area."""
    members: Annotated[int, arg(metavar="N")] = 800
    """Motions drawn from the covariance."""
    dock_point: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """Docking point in G [m]."""
    dock_axis: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """Its axis in G, outwards, of any length."""
    stand_off: Annotated[float, arg(metavar="M")] = 0.5
    """Distance of the inspector from the docking point along the axis [m]."""
    half_angle_deg: Annotated[float, arg(metavar="DEG")] = 10.0
    """Half angle of the corridor's cone [deg]."""
    isp_s: Annotated[float, arg(metavar="S")] = 230.0
    """Specific impulse, for the fuel that station keeping takes [s]."""
    debug: _Debug = False
    """Show the traceback of an error."""

    def execute(self) -> int:
        """Plan, write, print."""
        import numpy as np

        from polhode.pipeline.products.plan import Docking, plan_run
        from polhode.pipeline.products.plan_files import format_plan, write_plan
        from polhode.planning.keep_out.keepout import Wanted

        if self.output.exists() and not self.output.is_dir():
            raise InputError(f"{self.output} is a file: -o names a folder")
        if (self.dock_point is None) != (self.dock_axis is None):
            raise InputError("--dock-point and --dock-axis belong together: give both")
        docking = None
        if self.dock_point is not None and self.dock_axis is not None:
            point, axis = np.array(self.dock_point), np.array(self.dock_axis)
            if not (np.isfinite(point).all() and np.isfinite(axis).all() and np.linalg.norm(axis) > 0.0):
                raise InputError("--dock-axis: give a direction of finite numbers, not zero")
            for name in ("stand_off", "half_angle_deg", "isp_s"):
                if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                    raise InputError(f"--{name.replace('_', '-')}: give a number above 0")
            docking = Docking(point, axis, self.stand_off, self.half_angle_deg, self.isp_s)
        wanted = Wanted(self.horizon, self.confidence, members=self.members, cover=self.cover)
        plan = plan_run(self.run, wanted, docking)
        names = write_plan(plan, self.output)
        print(format_plan(plan))
        print(f"{', '.join(names)}: {self.output}")
        return 0
