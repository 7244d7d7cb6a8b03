"""One export: what it is made from, and what is left out on the way."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array
from polhode.pipeline.assumed_density import Solid, solid_of
from polhode.pipeline.products.export.inertial import inertial_of
from polhode.pipeline.products.export.options import Options
from polhode.pipeline.products.export.run_contents import Found, at_level, motion_ahead
from polhode.planning.exports.records import Inertial, Motion, Placement, Shape, poses_of, shape_of_surface

Files = dict[Path, bytes]
"""Contents by path; the file that the user named stands last."""


@dataclass
class Job:
    """One export: what it is made from, and what is left out on the way."""

    options: Options
    found: Found
    at: Placement
    left_out: list[str] = field(default_factory=list)
    """What the file lacks, and why; also what was assumed on the way"""

    def leave_out(self, words: str) -> None:
        """Say it once."""
        if words not in self.left_out:
            self.left_out.append(words)

    @property
    def comments(self) -> list[str]:
        """Of every file: where it comes from, its frame."""
        status = self.found.summary.status
        note = "" if status == "ok" else f" (status {status}: see summary.json)"
        return [
            f"polhode export of the run {self.found.folder.resolve().name}{note}",
            f"frame: {self.at.words}",
        ]

    def motion(self, step_s: float | None) -> Motion:
        """See ``motion_ahead``. Raises InputError when the run has none."""
        if self.found.no_motion:
            raise InputError(f"{self.found.folder}: {self.found.no_motion}")
        motion, why_bare = motion_ahead(self.found.folder, self.options.horizon, step_s)
        if why_bare:
            self.leave_out(f"covariances of the motion are left out: {why_bare}")
        return motion

    def poses(self, motion: Motion) -> Array:
        """X_NF (T, 4, 4)."""
        summary = self.found.summary
        return poses_of(motion.r_N, motion.R_NP, np.array(summary.R_GP), np.array(summary.com_G), self.at)

    def shape(self, lightest: int = 0) -> Shape | None:
        """The mesh at the level that was asked for; else the lightest one up to ``lightest``."""
        found = at_level(self.found, self.options.level, lightest)
        return None if found.surface is None else shape_of_surface(found.surface, self.at)

    def inertial(self) -> Inertial | None:
        """Mass and inertia; None, and said, when nothing tells them."""
        solid: Solid | None = None
        why = "this run has no mesh"
        if self.found.surface is not None:
            solid, why = solid_of(self.found.surface.mesh)
        mass_kg, middle = self.options.mass_kg, self.options.middle_moment_kg_m2
        inertial = inertial_of(self.found.summary, solid, why, self.at, mass_kg, middle)
        if inertial is None:
            self.leave_out(f"mass properties are left out: this run has no estimate of them, and {why}")
        return inertial
