"""What an export is made from: the run as far as it got, in the frame of the file; what it lacks, and why.

A motion without known torques determines the inertia only up to scale, and a mass alone does not set that
scale: it takes a length as well. In order of preference the scale comes from the middle moment as given; from
known torques; from uniform density in the volume of the mesh, at the mass as given or estimated; otherwise
the numbers are relative, and the files say so.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from polhode.config.loader import load_config
from polhode.config.mapping import Mapping
from polhode.errors import InputError
from polhode.lie import Array, transform_points
from polhode.mapping.finishing.detail_levels import levels_of
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.uniform_solid import Solid, principal_axes, solid_of
from polhode.pipeline.after_run.export.options import ExportOptions
from polhode.pipeline.after_run.predict import (
    NoCovariance,
    predict_run,
    prediction_times,
    step_or_own,
    undetermined_names,
)
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks
from polhode.pipeline.run_directory.summary import read_summary
from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.pipeline.run_directory.trajectory_file import read_trajectory
from polhode.planning.exports.records import (
    ExportShape,
    Inertial,
    LastState,
    Placement,
    PredictedMotion,
    poses_of,
    shape_of_surface,
)
from polhode.records import Landmarks, SurfaceModel
from polhode.rigid_body import propagate

UNIT_MASS_KG = 1.0


def inertial_of(
    summary: Summary,
    solid: Solid | None,
    why_no_solid: str,
    at: Placement,
    mass_kg: float | None,
    middle_kg_m2: float | None,
) -> Inertial | None:
    """In F; None when there is neither an estimate nor a volume. ``solid``: the mesh at density 1."""
    mass, mass_is, words = _mass(summary, mass_kg)
    if summary.inertia is None or summary.R_GP is None or summary.com_G is None:
        return None if solid is None else _uniform(solid, at, mass, mass_is, words)
    # the scale of the moments as stored: the middle one is 1
    moments = np.array(summary.inertia.moments)
    known = summary.inertia
    if middle_kg_m2 is not None:
        scale, scale_is = middle_kg_m2, "given"
        words.append(f"inertia: scaled to the middle moment as given, {scale:g} kg m^2")
    elif known.scale_kg_m2 is not None and known.sigma_scale_kg_m2 is not None:
        scale, scale_is = known.scale_kg_m2, "determined"
        words.append(
            f"inertia: scale determined by the known torques, middle moment {scale:.6g} kg m^2 "
            f"(standard deviation {known.sigma_scale_kg_m2:.2g})"
        )
    elif solid is not None:
        # the same trace: the sum of the mean square distances does not depend on the axes
        scale = mass / solid.volume_m3 * float(np.trace(solid.inertia)) / float(moments.sum())
        scale_is = "relative" if mass_is == "relative" else "assumed"
        words.append(
            "inertia: ratios and axes by the motion; their scale is assumed, that of uniform density at this "
            f"mass in the {solid.words}"
        )
    else:
        scale, scale_is = 1.0, "relative"
        words.append(
            "inertia: relative, the middle moment is 1: the run does not determine its scale, a mass alone "
            f"does not set it, and no volume does ({why_no_solid}); give it by --middle-moment-kg-m2"
        )
    if mass_is == "relative" and scale_is == "relative":
        words.append("free motion is right at any scale; reactions to forces, torques and contacts are not")
    words += _undetermined(summary)
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(at.X_FG, np.array([summary.com_G]))[0],
        R_FP=at.R_FG @ np.array(summary.R_GP),
        moments_kg_m2=scale * moments,
        mass_is=mass_is,
        scale_is=scale_is,
        words=tuple(words),
    )


def _mass(summary: Summary, given: float | None) -> tuple[float, str, list[str]]:
    if given is not None:
        return given, "given", [f"mass: {given:g} kg as given"]
    found = summary.inertia
    if found is not None and found.mass_kg is not None and found.sigma_mass_kg is not None:
        words = f"mass: {found.mass_kg:.6g} kg from the known forces"
        return found.mass_kg, "determined", [f"{words} (standard deviation {found.sigma_mass_kg:.2g})"]
    if summary.assumed is not None:
        mass = summary.assumed.mass_kg
        return mass, "assumed", [f"mass: {mass:.6g} kg, from the mass or density that the run was given"]
    words = "mass: relative, set to 1: the run does not determine it; give it by --mass-kg"
    return UNIT_MASS_KG, "relative", [words]


def _undetermined(summary: Summary) -> list[str]:
    """What the motion leaves open: the numbers are the best finite ones, which repeat the motion seen."""
    known = summary.identifiable
    if known is None:
        return []
    names = {
        "k1": known.k1,
        "k2": known.k2,
        "the principal axes": known.axes,
        "the centre of mass": known.com,
    }
    lost = [name for name, determined in names.items() if not determined]
    if not lost:
        return []
    return [
        f"not determined by the motion: {', '.join(lost)}; the numbers here are the best finite ones, which "
        "repeat the motion that was seen"
    ]


def _uniform(solid: Solid, at: Placement, mass: float, mass_is: str, words: list[str]) -> Inertial:
    moments, R_GP = principal_axes(mass / solid.volume_m3 * solid.inertia)
    return Inertial(
        mass_kg=mass,
        com_F=transform_points(at.X_FG, solid.com_G[None])[0],
        R_FP=at.R_FG @ R_GP,
        moments_kg_m2=moments,
        mass_is=mass_is,
        scale_is="relative" if mass_is == "relative" else "assumed",
        words=(
            *words,
            f"inertia and centre of mass: assumed, uniform density in the {solid.words}, as the run has no "
            "estimate of them",
        ),
    )


@dataclass(frozen=True)
class ExportSource:
    """A run as far as it got."""

    folder: Path
    summary: Summary
    surface: SurfaceModel | None
    """None: there is none"""
    landmarks: Landmarks | None
    """None: there are none"""
    no_motion: str
    """Why there is no last state; empty: there is one"""

    @property
    def has_motion(self) -> bool:
        """Whether there is a last state."""
        return not self.no_motion

    @property
    def words(self) -> str:
        """Why there is no motion, to end an error's line with; empty: there is one."""
        return f" ({self.no_motion})" if self.no_motion else ""


def read_run(folder: Path) -> ExportSource:
    """Raises InputError, one line."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of a run")
    summary = read_summary(folder)
    mesh, points = folder / "mesh.ply", folder / "landmarks.ply"
    surface = read_ply(mesh) if mesh.is_file() else None
    if surface is not None and len(surface.mesh.faces) == 0:
        surface = None
    landmarks = read_landmarks(points) if points.is_file() else None
    if landmarks is not None and len(landmarks.p_G) == 0:
        landmarks = None
    return ExportSource(folder, summary, surface, landmarks, _why_no_motion(folder, summary))


def _why_no_motion(folder: Path, summary: Summary) -> str:
    if summary.R_GP is None or summary.com_G is None or summary.inertia is None:
        reason = summary.warnings[0] if summary.warnings else "no reason is known"
        return f"this run failed before it had a motion ({reason})"
    try:
        read_trajectory(folder)
    except InputError as error:
        return f"this run's motion cannot be read ({error})"
    return ""


def at_level(source: ExportSource, level: int | None, lightest: int) -> ExportSource:
    """With the mesh at a ``level`` of detail: 0 the full one, 1, 2, ... lighter; None: up to ``lightest``.

    Raises InputError when there is no such level.
    """
    if source.surface is None or level == 0 or (level is None and lightest == 0):
        return source
    shares = _shares(source.folder)
    levels = levels_of(source.surface, shares if level is not None else shares[:lightest])
    if level is None:
        level = len(levels)
    if level > len(levels):
        raise InputError(f"--level {level}: this run's mesh has levels 0 to {len(levels)}; 0 is the full one")
    return source if level == 0 else replace(source, surface=levels[level - 1].surface)


def _shares(folder: Path) -> tuple[float, ...]:
    try:
        return load_config(folder / "config.yaml").mapping.levels
    except InputError:
        # a run that failed early, or of another version
        return Mapping().levels


def last_state(source: ExportSource, at: Placement) -> LastState:
    """Of the run; needs ``source.has_motion``."""
    summary, table = source.summary, read_trajectory(source.folder)
    R_GP, com_G = np.array(summary.R_GP), np.array(summary.com_G)
    X_NF = poses_of(table.r_N[-1:], table.R_NP[-1:], R_GP, com_G, at)[0]
    w_N = table.R_NP[-1] @ table.w_P[-1]
    return LastState(
        timestamp_ns=int(table.timestamps_ns[-1]),
        X_NF=X_NF,
        v_N=table.v_N[-1] + np.cross(w_N, X_NF[:3, 3] - table.r_N[-1]),
        w_F=X_NF[:3, :3].T @ w_N,
    )


def motion_ahead(folder: Path, horizon_s: float, step_s: float | None) -> tuple[PredictedMotion, str]:
    """The last state and those after it, and why they have no covariances; empty: they have.

    Raises InputError when the run has no estimate.
    """
    try:
        prediction = predict_run(folder, horizon_s, step_s, from_last=True)
    except NoCovariance as error:
        return _bare_motion(folder, horizon_s, step_s), str(error)
    states = prediction.states
    motion = PredictedMotion(
        timestamps_ns=prediction.timestamps_ns,
        r_N=states.r_N,
        v_N=states.v_N,
        R_NP=states.R_NP,
        w_P=states.w_P,
        covariance=prediction.covariance,
        covariance_of_marks=states.covariance_of_marks,
        undetermined=prediction.undetermined,
    )
    return motion, ""


def _bare_motion(folder: Path, horizon_s: float, step_s: float | None) -> PredictedMotion:
    """The same motion from the summary and the last row of the trajectory."""
    summary, table = read_summary(folder), read_trajectory(folder)
    assert summary.inertia is not None
    time_s = np.concatenate([[0.0], prediction_times(horizon_s, step_or_own(table, step_s))])
    R_GP, J_G = np.array(summary.R_GP), np.array(summary.inertia.J_G)
    r_N, v_N, R_NG, w_G = propagate(
        time_s, table.r_N[-1], table.v_N[-1], table.R_NP[-1] @ R_GP.T, R_GP @ table.w_P[-1], J_G
    )
    nothing = np.full((len(time_s), 12, 12), np.inf)
    return PredictedMotion(
        timestamps_ns=table.timestamps_ns[-1] + np.round(time_s * 1e9).astype(np.int64),
        r_N=r_N,
        v_N=v_N,
        R_NP=R_NG @ R_GP,
        w_P=w_G @ R_GP,
        covariance=nothing,
        covariance_of_marks=nothing,
        undetermined=undetermined_names(summary),
    )


Files = dict[Path, bytes]
"""Contents by path; the file that the user named stands last."""


@dataclass
class ExportJob:
    """One export: its source, its frame, and what is left out."""

    options: ExportOptions
    source: ExportSource
    at: Placement
    left_out: list[str] = field(default_factory=list)
    """What the file lacks, and why; also what was assumed on the way"""

    def leave_out(self, words: str) -> None:
        """Note what is left out; once."""
        if words not in self.left_out:
            self.left_out.append(words)

    @property
    def comments(self) -> list[str]:
        """Of every file: where it comes from, its frame."""
        status = self.source.summary.status
        note = "" if status == "ok" else f" (status {status}: see summary.json)"
        return [
            f"polhode export of the run {self.source.folder.resolve().name}{note}",
            f"frame: {self.at.words}",
        ]

    def motion(self, step_s: float | None) -> PredictedMotion:
        """See ``motion_ahead``. Raises InputError when the run has none."""
        if self.source.no_motion:
            raise InputError(f"{self.source.folder}: {self.source.no_motion}")
        motion, why_bare = motion_ahead(self.source.folder, self.options.horizon, step_s)
        if why_bare:
            self.leave_out(f"covariances of the motion are left out: {why_bare}")
        return motion

    def poses(self, motion: PredictedMotion) -> Array:
        """X_NF (T, 4, 4)."""
        summary = self.source.summary
        return poses_of(motion.r_N, motion.R_NP, np.array(summary.R_GP), np.array(summary.com_G), self.at)

    def shape(self, lightest: int = 0) -> ExportShape | None:
        """The mesh at the level that was asked for; else the lightest one up to ``lightest``."""
        source = at_level(self.source, self.options.level, lightest)
        return None if source.surface is None else shape_of_surface(source.surface, self.at)

    def inertial(self) -> Inertial | None:
        """Mass and inertia; None, with a warning, if neither run nor mesh determines them."""
        solid: Solid | None = None
        why = "this run has no mesh"
        if self.source.surface is not None:
            solid, why = solid_of(self.source.surface.mesh)
        mass_kg, middle = self.options.mass_kg, self.options.middle_moment_kg_m2
        inertial = inertial_of(self.source.summary, solid, why, self.at, mass_kg, middle)
        if inertial is None:
            self.leave_out(f"mass properties are left out: this run has no estimate of them, and {why}")
        return inertial
