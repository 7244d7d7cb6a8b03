"""What an export is made from: the run as far as it got, in the frame of the file; what it lacks, and why.

A motion without known torques determines the inertia only up to scale, and a mass alone does not set that
scale: it takes a length as well. In order of preference the scale comes from the middle moment as given; from
known torques; from uniform density in the volume of the mesh, at the mass as given or estimated; otherwise
the numbers are relative, and the files say so.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polhode.config.loader import load_config
from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array, transform_points
from polhode.mapping.finishing.detail_levels import levels_of
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.uniform_solid import Solid, principal_axes, solid_of
from polhode.planning.exports.formats import MOTIONS
from polhode.planning.exports.options import ExportOptions
from polhode.planning.exports.placement import placement
from polhode.planning.exports.records import ExportShape, Inertial, LastState, Placement, shape_of_surface
from polhode.planning.predict import NoCovariance, predict_run, predict_without_covariance
from polhode.planning.prediction import PredictedMotion
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.run_folder import require_run_folder
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_in_words import describe_intervals, possible_com
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory, target_poses
from polhode.runtime.errors import InputError, printable
from polhode.runtime.progress import Progress, Silent

USUAL_RADII = (0.05, 1.0)
"""Radius of gyration over the distance of the farthest vertex; a uniform ball has 0.63."""
USUAL_DENSITIES_KG_M3 = (1.0, 20_000.0)
"""Lighter than air, and denser than gold: no body is either."""
FAR_OUTSIDE = 10.0
"""Beyond the usual by this factor no hidden part of the body explains it: the units are wrong."""
Files = dict[Path, bytes]
"""Contents by path; the file that the user named is the last."""


@dataclass
class ExportJob:
    """One export: the run as far as it got, the frame of the file, and what is left out."""

    options: ExportOptions
    folder: Path
    summary: Summary
    surface: SurfaceModel | None
    """None: the run has none"""
    landmarks: Landmarks | None
    """None: the run has none"""
    no_motion: str
    """Why there is no last state; empty: there is one"""
    at: Placement
    left_out: list[str] = field(default_factory=list)
    """What the file lacks, and why; also what was assumed"""
    progress: Progress = field(default_factory=Silent)
    """Of a long prediction"""
    written: Inertial | None = None
    """The mass properties that the files have; None: they have none"""

    def leave_out(self, reason: str) -> None:
        """Note what is left out; once."""
        if reason not in self.left_out:
            self.left_out.append(reason)

    def nothing(self, reason: str) -> InputError:
        """The error of an export without content; names why there is no motion either."""
        return InputError(f"{self.folder}: {reason}{f' ({self.no_motion})' if self.no_motion else ''}")

    @property
    def comments(self) -> list[str]:
        """Of every file: its origin and its frame."""
        status = self.summary.status
        note = "" if status == "ok" else f" (status {status}: see summary.json)"
        return [
            f"polhode export of the run {printable(self.folder.resolve().name)}{note}",
            f"frame: {self.at.description}",
        ]

    def motion(self, step_s: float | None) -> PredictedMotion:
        """The last state and those after it, without covariances where the run has none.

        Raises InputError when the run has no motion.
        """
        if self.no_motion:
            raise InputError(f"{self.folder}: {self.no_motion}")
        try:
            return predict_run(self.folder, self.options.horizon, step_s, True, self.progress)
        except NoCovariance as error:
            self.leave_out(f"covariances of the motion are left out: {error}")
            return predict_without_covariance(self.folder, self.options.horizon, step_s)

    def check_epoch(self, first_ns: int) -> None:
        """Note when the first time in the file is far from --epoch: the timestamps count from elsewhere."""
        years = first_ns * 1e-9 / (365.25 * 86400.0)
        if self.options.epoch_utc != np.datetime64(0, "ns") and abs(years) > 1.0:
            self.leave_out(
                f"the file begins {abs(years):.1f} years {'after' if years > 0 else 'before'} --epoch "
                f"{self.options.epoch}, which is the UTC of timestamp 0: leave it out if the run's "
                "timestamps are nanoseconds since 1970"
            )

    def poses(self, states: Trajectory | PredictedMotion) -> Array:
        """X_NF (T, 4, 4)."""
        X_NG = target_poses(states, np.array(self.summary.R_GP), np.array(self.summary.com_G))
        return np.asarray(X_NG @ np.linalg.inv(self.at.X_FG))

    def last_state(self) -> LastState:
        """The last state of the run, which must have a motion."""
        table = read_trajectory(self.folder)
        X_NF = self.poses(table)[-1]
        w_N = table.R_NP[-1] @ table.w_P[-1]
        return LastState(
            timestamp_ns=int(table.timestamps_ns[-1]),
            X_NF=X_NF,
            v_N=table.v_N[-1] + np.cross(w_N, X_NF[:3, 3] - table.r_N[-1]),
            w_F=X_NF[:3, :3].T @ w_N,
        )

    def shape(self, coarsest: int = 0) -> ExportShape | None:
        """The mesh at the requested level of detail: 0 the full one, 1, 2, ... lighter.

        If none is requested, the lightest one up to ``coarsest``. Raises InputError for an unknown level.
        """
        level = self.options.level
        if self.surface is None:
            return None
        if level == 0 or (level is None and coarsest == 0):
            return shape_of_surface(self.surface, self.at)
        try:
            shares = load_config(self.folder / "config.yaml").mapping.levels
        except InputError:
            # a run that failed early, or of another version
            shares = Mapping().levels
        levels = levels_of(self.surface, shares if level is not None else shares[:coarsest])
        if level is not None and level > len(levels):
            raise InputError(
                f"--level {level}: this run's mesh has levels 0 to {len(levels)}; 0 is the full one"
            )
        surfaces = [self.surface, *(each.surface for each in levels)]
        return shape_of_surface(surfaces[-1 if level is None else level], self.at)

    def inertial(self) -> Inertial | None:
        """Mass and inertia; None, with a warning, if neither run nor mesh determines them.

        Raises InputError for a mass or a moment that is far from fitting the mesh.
        """
        solid: Solid | None = None
        no_solid = "this run has no mesh"
        if self.surface is not None:
            solid, no_solid = solid_of(self.surface.mesh)
        found = inertial_of(self.summary, solid, no_solid, self.at, self.options)
        if found is None:
            self.leave_out(f"mass properties are left out: this run has no estimate of them, and {no_solid}")
        elif self.surface is not None:
            vertices_F = transform_points(self.at.X_FG, self.surface.mesh.vertices)
            for warning in _contradictions(found, solid, vertices_F):
                self.leave_out(warning)
        self.written = found
        return found


def open_job(folder: Path, options: ExportOptions, progress: Progress) -> ExportJob:
    """Read the run and choose the frame. Raises InputError, one line."""
    require_run_folder(folder)
    summary = read_summary(folder)
    mesh, points = folder / "mesh.ply", folder / "landmarks.ply"
    surface = read_ply(mesh) if mesh.is_file() else None
    if surface is not None and len(surface.mesh.faces) == 0:
        surface = None
    landmarks = read_landmarks(points) if points.is_file() else None
    if landmarks is not None and len(landmarks.p_G) == 0:
        landmarks = None
    no_motion = ""
    if summary.R_GP is None or summary.com_G is None or summary.inertia is None:
        no_motion = f"this run failed before it had a motion ({failure_of(summary)})"
    else:
        try:
            read_trajectory(folder)
        except InputError as error:
            no_motion = f"this run's motion cannot be read ({error})"
    if no_motion and options.to in MOTIONS:
        raise InputError(f"{folder}: {no_motion}; nothing for {options.to}, json has what there is")
    at, warnings = placement(options, summary, surface)
    return ExportJob(options, folder, summary, surface, landmarks, no_motion, at, warnings, progress)


def failure_of(summary: Summary) -> str:
    """Why a run failed."""
    return summary.warnings[0] if summary.warnings else "no reason is known"


def inertial_of(
    summary: Summary, solid: Solid | None, no_solid: str, at: Placement, options: ExportOptions
) -> Inertial | None:
    """In F; None when there is neither an estimate nor a volume.

    ``solid``: the mesh at density 1; ``no_solid``: why there is none.
    """
    found, moment = summary.inertia, options.middle_moment_kg_m2
    mass, mass_is = 1.0, "relative"
    note = "mass: relative, set to 1: the run does not determine it; give it by --mass-kg"
    if options.mass_kg is not None:
        mass, mass_is, note = options.mass_kg, "given", f"mass: {options.mass_kg:g} kg as given"
    elif found is not None and found.mass_kg is not None and found.sigma_mass_kg is not None:
        mass, mass_is = found.mass_kg, "determined"
        note = f"mass: {mass:.6g} kg from the known forces (standard deviation {found.sigma_mass_kg:.2g})"
    elif summary.assumed is not None:
        mass, mass_is = summary.assumed.mass_kg, "assumed"
        note = f"mass: {mass:.6g} kg, from the mass or density that the run was given"
    notes, restated = [note], [note] if mass_is == "given" else []
    uniform_is = "relative" if mass_is == "relative" else "assumed"

    if found is None or summary.R_GP is None or summary.com_G is None:
        if solid is None:
            return None
        moments, R_GP = principal_axes(mass / solid.volume_m3 * solid.inertia)
        com_G, scale_is = solid.com_G, uniform_is
        notes.append(
            f"inertia and centre of mass: assumed, uniform density in the {solid.words}, as the run has no "
            "estimate of them"
        )
    else:
        if moment is not None:
            scale, scale_is = moment, "given"
            note = f"inertia: scaled to the middle moment as given, {moment:g} kg m^2"
            restated.append(note)
        elif found.scale_kg_m2 is not None and found.sigma_scale_kg_m2 is not None:
            scale, scale_is = found.scale_kg_m2, "determined"
            note = (
                f"inertia: scale determined by the known torques, middle moment {scale:.6g} kg m^2 "
                f"(standard deviation {found.sigma_scale_kg_m2:.2g})"
            )
        elif solid is not None:
            # the same trace: the sum of the mean square distances does not depend on the axes
            trace = mass / solid.volume_m3 * float(np.trace(solid.inertia))
            scale, scale_is = trace / float(np.sum(found.moments)), uniform_is
            note = (
                "inertia: ratios and axes by the motion; their scale is assumed, that of uniform density at "
                f"this mass in the {solid.words}"
            )
        else:
            scale, scale_is = 1.0, "relative"
            note = (
                "inertia: relative, the middle moment is 1: the run does not determine its scale, a mass "
                f"alone does not set it, and no volume does ({no_solid}); give it by --middle-moment-kg-m2"
            )
        # the scale of the moments as stored: the middle one is 1
        moments = scale * np.array(found.moments)
        R_GP, (com_G, moved_m) = np.array(summary.R_GP), possible_com(summary)
        notes.append(note)
        if moved_m > 0.0:
            notes.append(
                f"centre of mass: moved by {1e3 * moved_m:.3g} mm into the body, as nothing determines it"
            )
        if mass_is == "relative" and scale_is == "relative":
            notes.append(
                "free motion is right at any scale; reactions to forces, torques and contacts are not"
            )
        names = {"k1": "k1", "k2": "k2", "axes": "the principal axes", "com": "the centre of mass"}
        known = summary.identifiable
        if (
            lost := []
            if known is None
            else [words for name, words in names.items() if not getattr(known, name)]
        ):
            notes.append(
                f"not determined by the motion: {', '.join(lost)}; the numbers here are the best finite "
                "ones, which repeat the motion that was seen"
            )
            if ranges := describe_intervals(summary):
                notes.append(f"possible by the hull of the body: {'; '.join(ranges)}")
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(at.X_FG, com_G[None])[0],
        R_FP=at.R_FG @ R_GP,
        moments_kg_m2=moments,
        mass_is=mass_is,
        scale_is=scale_is,
        notes=tuple(notes),
        restated=tuple(restated),
    )


def _contradictions(inertial: Inertial, solid: Solid | None, vertices_F: Array) -> list[str]:
    """A warning for what was given and does not fit the mesh (V, 3).

    Mass within the surface has a radius of gyration, the root of moment over mass, between 0 and the distance
    from the centre of mass to the farthest vertex; and a density. Raises InputError when the radius is far
    outside.
    """
    found, mass = [], inertial.mass_kg
    origins = (inertial.mass_is, inertial.scale_is)
    if "given" in origins and set(origins) <= {"given", "determined"}:
        moment = float(inertial.moments_kg_m2.max())
        radius = float(np.sqrt(moment / mass))
        farthest = float(np.linalg.norm(vertices_F - inertial.com_F, axis=1).max())
        least, most = (share * farthest for share in USUAL_RADII)
        reason = (
            f"a mass of {mass:g} kg with a largest moment of {moment:.3g} kg m^2 has a radius of gyration of "
            f"{radius:.3g} m, and the mesh reaches {farthest:.3g} m from the centre of mass: check --mass-kg "
            "[kg] and --middle-moment-kg-m2 [kg m^2]"
        )
        if not least / FAR_OUTSIDE <= radius <= FAR_OUTSIDE * most:
            raise InputError(reason)
        if not least <= radius <= most:
            found.append(reason)
    if inertial.mass_is == "given" and solid is not None:
        density, (least, most) = mass / solid.volume_m3, USUAL_DENSITIES_KG_M3
        if not least <= density <= most:
            bound = "less than that of air" if density < least else "more than that of gold"
            found.append(
                f"a density of {density:.3g} kg/m^3, {bound}: {mass:g} kg in {solid.volume_m3:.3g} m^3, the "
                f"{solid.words}; check --mass-kg [kg] and the units of the calibration"
            )
    return found
