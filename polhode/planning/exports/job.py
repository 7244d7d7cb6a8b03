"""What an export is made from: the run as far as it got, in the frame F of the file, and what it lacks."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.config.loader import load_stored_config
from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, make_pose, transform_points
from polhode.mapping.finishing.detail_levels import levels_of
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.uniform_solid import Solid, solid_of
from polhode.planning.exports.formats import MOTIONS
from polhode.planning.exports.mass_properties import Inertial, contradictions, inertial_of
from polhode.planning.exports.options import ExportOptions
from polhode.planning.predict import predict_run
from polhode.planning.prediction import PredictedMotion
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.run_folder import require_run_folder
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory, target_poses
from polhode.runtime.errors import InputError, printable
from polhode.runtime.progress import Progress

Files = dict[Path, bytes]
"""Contents by path; the file that the user named is the last."""


@dataclass(frozen=True)
class ExportShape:
    """A surface in F [m]; without faces a point cloud."""

    vertices: Array
    """(V, 3)"""
    faces: Ints
    """(T, 3)"""
    normals: Array
    """(V, 3) unit, or zero where there is none"""
    rgba: NDArray[np.uint8]
    """(V, 4)"""
    sigma_m: Array
    """(V,) inf where nothing was measured"""
    views: Ints
    """(V,) frames that saw the vertex"""
    coverage: NDArray[np.uint8]
    """(V,) 0 never seen, 1 seen but never lit, 2 seen in light"""
    invented: Bools
    """(T,) faces that close a small hole"""

    def mesh(self) -> trimesh.Trimesh:
        """The geometry alone."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)


def shape_of_surface(surface: SurfaceModel, X_FG: Array) -> ExportShape:
    """The dense model in F."""
    mesh = surface.mesh
    colours = getattr(mesh.visual, "vertex_colors", np.full((1, 4), 128))
    return ExportShape(
        transform_points(X_FG, np.asarray(mesh.vertices)),
        np.asarray(mesh.faces, dtype=np.int64),
        np.asarray(mesh.vertex_normals) @ X_FG[:3, :3].T,
        np.broadcast_to(np.asarray(colours, dtype=np.uint8), (len(mesh.vertices), 4)),
        surface.sigma_m,
        surface.views,
        surface.coverage_classes,
        surface.is_invented,
    )


@dataclass(frozen=True)
class LastState:
    """The last state of a run."""

    timestamp_ns: int
    X_NF: Array
    """(4, 4)"""
    v_N: Array
    """(3,) velocity of the origin of F [m/s]"""
    w_F: Array
    """(3,) angular velocity, in F [rad/s]"""


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
    X_FG: Array
    """(4, 4) the frame F in the body, G or P"""
    frame: str
    """Description of F for the files' comments"""
    progress: Progress
    """Of a long prediction"""
    left_out: list[str] = field(default_factory=list)
    """What the file lacks, and why; also what was assumed"""
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
        found = self.summary.hypotheses
        which = (
            [f"hypothesis 1 of {len(found)} (odds {found[0].odds:.2f}): {found[0].reason}"] if found else []
        )
        return [
            f"polhode export of the run {printable(self.folder.resolve().name)}{note}",
            f"frame: {self.frame}",
            *which,
        ]

    def motion(self, step_s: float | None) -> PredictedMotion:
        """The last state and those after it. Raises InputError when the run has no motion."""
        if self.no_motion:
            raise InputError(f"{self.folder}: {self.no_motion}")
        return predict_run(self.folder, self.options.horizon, step_s, True, self.progress)

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
        return np.asarray(X_NG @ np.linalg.inv(self.X_FG))

    def last_state(self) -> LastState:
        """The last state of the run, which must have a motion."""
        table = read_trajectory(self.folder)
        X_NF = self.poses(table)[-1]
        w_N = table.R_NP[-1] @ table.w_P[-1]
        v_N = table.v_N[-1] + np.cross(w_N, X_NF[:3, 3] - table.r_N[-1])
        return LastState(int(table.timestamps_ns[-1]), X_NF, v_N, X_NF[:3, :3].T @ w_N)

    def shape(self, coarsest: int = 0) -> ExportShape | None:
        """The mesh, or the last of its first ``coarsest`` lighter levels; None: there is none."""
        if self.surface is None:
            return None
        try:
            shares = load_stored_config(self.folder / "config.yaml").mapping.levels
        except InputError:
            # a run that failed early, or of another version
            shares = Mapping().levels
        levels = levels_of(self.surface, shares[:coarsest])
        return shape_of_surface(levels[-1].surface if levels else self.surface, self.X_FG)

    def points(self) -> ExportShape | None:
        """The landmarks, without faces; None: the run has none."""
        if self.landmarks is None:
            return None
        count = len(self.landmarks.p_G)
        return ExportShape(
            transform_points(self.X_FG, self.landmarks.p_G),
            np.zeros((0, 3), dtype=np.int64),
            np.zeros((count, 3)),
            np.tile(np.array([160, 160, 160, 255], dtype=np.uint8), (count, 1)),
            self.landmarks.sigma_m,
            self.landmarks.observations,
            np.full(count, 2, dtype=np.uint8),
            np.zeros(0, dtype=bool),
        )

    def inertial(self) -> Inertial | None:
        """Mass and inertia; None, with a warning, if neither run nor mesh determines them.

        Raises InputError for a mass or a moment that is far from fitting the mesh.
        """
        solid: Solid | None = None
        no_solid = "this run has no mesh"
        if self.surface is not None:
            solid, no_solid = solid_of(self.surface.mesh)
        found = inertial_of(self.summary, solid, no_solid, self.X_FG, self.options)
        if found is None:
            self.leave_out(f"mass properties are left out: this run has no estimate of them, and {no_solid}")
        elif self.surface is not None:
            vertices_F = transform_points(self.X_FG, self.surface.mesh.vertices)
            for warning in contradictions(found, solid, vertices_F):
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
    X_FG, frame, warnings = np.eye(4), "G, the geometric frame of the run, fixed to the target", list[str]()
    if options.frame_name == "P":
        if summary.R_GP is None or summary.com_G is None:
            raise InputError(
                "--frame P: this run has no estimate, so no principal axes; --frame G has no need of it"
            )
        known = summary.identifiable
        if known is not None and not (known.axes and known.com):
            warnings.append(
                "the run does not determine every principal axis or every component of the centre of mass: "
                "frame P is the best finite one"
            )
        X_FG = inverse_pose(make_pose(np.array(summary.R_GP), np.array(summary.com_G)))
        frame = "P, the principal axes of the target (Jxx >= Jyy >= Jzz), origin at its centre of mass"
    return ExportJob(options, folder, summary, surface, landmarks, no_motion, X_FG, frame, progress, warnings)


def failure_of(summary: Summary) -> str:
    """Why a run failed."""
    return summary.warnings[0] if summary.warnings else "no reason is known"
