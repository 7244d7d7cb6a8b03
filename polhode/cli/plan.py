"""``polhode plan``: keep-out volume, surface speeds and docking corridor of a run."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.errors import InputError

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
"""[m]"""


class PlanCommand(Command):
    """What planners need from a run: keep-out volume, speeds of the surface, corridor, path of an approach.

    Writes keepout.ply, .glb and .npz (N), surface_speed.ply (G), corridor.csv (N), planning.json, and
    plan.txt (N): the camera's path from its last pose to the docking point, or else towards the target, for
    polhode observability RUN --trajectory DIR/plan.txt --frame inertial.
    """

    run: Annotated[Path, Positional("RUN")]
    """Folder of a finished run."""
    output: Annotated[Path, Named("DIR", "-o")]
    """Folder of the results: a new or empty one, or that of an earlier call, whose files are replaced."""
    horizon_s: Annotated[float, Named("S", "--horizon")] = 60.0
    """Time to predict beyond the last stereo pair [s]."""
    confidence: Annotated[float, Named("SHARE")] = 0.99
    """Probability that the whole body stays inside the volume at all instants, 0.5 to 0.9999."""
    cover: Literal["auto", "possible", "outlines", "surface", "hull"] = "auto"
    """The body that is kept out of. surface: what was measured and what it encloses; outlines: also what the
    outlines of several frames show; possible: also what no frame excludes; hull: the convex hull of what
    outlines show. auto: possible, or, in a run of an earlier version, surface where the mesh is closed and
    hull where it is open."""
    members: Annotated[int | None, Named("N"), Field(ge=60, le=100_000)] = None
    """Motions drawn from the covariance; by default 600 up to 99 %, more beyond."""
    instants: Annotated[int, Named("N"), Field(ge=0, le=1000)] = 0
    """Number of instants, spread over the horizon, whose volumes are written as keepout_000.ply and so on."""
    dock_point: Annotated[tuple[Coordinate, Coordinate, Coordinate] | None, Named("X Y Z")] = None
    """Docking point in G [m]."""
    dock_axis: Annotated[tuple[float, float, float] | None, Named("X Y Z")] = None
    """Docking axis in G, pointing outwards, of any length."""
    stand_off_m: Annotated[float, Named("M", "--stand-off"), Field(ge=1e-12, le=1e6)] = 0.5
    """Distance of the inspector from the docking point along the axis [m]."""
    isp_s: Annotated[float, Named("S"), Field(ge=1e-12, le=1e6)] = 230.0
    """Specific impulse, for the fuel that station keeping uses [s]."""

    def execute(self) -> Answer:
        """Plan, write and print."""
        import numpy as np

        from polhode.planning.keep_out.volumes import KeepOutOptions
        from polhode.planning.plan import Docking, plan_run
        from polhode.planning.plan_files import format_plan, plan_folder, summary_of, write_plan
        from polhode.runtime.console import choose_progress

        with plan_folder(self.output) as place:
            if (self.dock_point is None) != (self.dock_axis is None):
                raise InputError("--dock-point and --dock-axis belong together: give both")
            if self.dock_axis is not None and not (
                1e-100 < max(map(abs, self.dock_axis)) < 1e100 and all(map(math.isfinite, self.dock_axis))
            ):
                raise InputError("--dock-axis: give a direction whose length is neither 0 nor above 1e100")
            docking = None
            if self.dock_point is not None and self.dock_axis is not None:
                point, axis = np.array(self.dock_point), np.array(self.dock_axis)
                docking = Docking(point, axis, self.stand_off_m, self.isp_s)
            wanted = KeepOutOptions(self.horizon_s, self.confidence, members=self.members, cover=self.cover)
            plan = plan_run(self.run, wanted, docking, choose_progress(), self.instants)
            names = write_plan(plan, place)
        return Answer(
            f"{', '.join(names)}: {self.output}",
            format_plan(plan),
            paths=(self.output, *(self.output / name for name in names)),
            figures=summary_of(plan),
        )
