"""``polhode plan``: keep-out volume, surface speeds, corridor of a docking point and approach from a run."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.geometry.lie import Array
from polhode.mapping.mesh_files import read_ply
from polhode.mapping.visibility import Caster
from polhode.planning.approach.corridor import (
    POSES,
    ApproachPath,
    Corridor,
    along_corridor,
    corridor,
    towards_centre,
)
from polhode.planning.approach.surface_speed import SurfaceSpeed, surface_speed
from polhode.planning.keep_out.queries import KeepOut
from polhode.planning.keep_out.volumes import (
    LEAST_MEMBERS,
    KeepOutOptions,
    keep_out_of_all,
    member_times,
)
from polhode.planning.predict import final_estimates, require_horizon, undetermined_names
from polhode.planning.prediction import BodyMotion, FinalEstimate, nominal_motion
from polhode.records.mesh_metrics import distance_to_surface, encloses
from polhode.records.surface import SurfaceModel
from polhode.run_directory.archives import read_measurements, read_occupancy
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_in_words import describe_intervals
from polhode.run_directory.summary_schema import Intervals, Summary
from polhode.runtime.errors import InputError
from polhode.runtime.progress import NOTE, Progress

MOST_CONFIDENT = 0.9999
FIRST_S, MEMBER_S = 3.0, 8e-6
"""Cost of a volume on one core, and what each motion adds at each instant [s]"""
COVERED = {
    "possible": "Keep-out applies to the measured surface with all that it encloses, to what the outlines of "
    "several frames show beside it, and to what no frame excludes.",
    "outlines": "Keep-out applies to the measured surface with all that it encloses, and to what the "
    "outlines of several frames show beside it (open boundaries span {share} of the surface).",
    "surface": "Keep-out applies to the measured surface and what it encloses (open boundaries span {share} "
    "of its area).",
    "hull": "Keep-out applies to the convex hull of what was measured (open boundaries span {share} of the "
    "surface), so concavities are filled.",
}
"""By what the body covers"""
DOUBTFUL_DOCK_DISTANCE, MAX_DOCK_DISTANCE = 0.05, 5.0
"""Shares of the body's size: a docking point farther from the surface gives a warning, or is refused."""
OPEN_ROTATION = (
    "the rotation is ambiguous, so that nobody knows where the docking point will be: take images at shorter "
    "or unequal intervals, or state the fastest possible rotation (backend.max_rpm)"
)


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Docking:
    """A docking point in G, as the user gives it."""

    point_G: Array
    axis_G: Array
    stand_off_m: float
    isp_s: float

    def corridor(self, motion: BodyMotion) -> Corridor:
        """At the instants of a motion."""
        return corridor(motion, self.point_G, self.axis_G, self.stand_off_m)


@dataclass(frozen=True)
class Plan:
    """The results, and what was left out and why."""

    horizon_s: float
    confidence: float
    keep_out: KeepOut | None
    speed: SurfaceSpeed | None
    surface: SurfaceModel | None
    corridor: Corridor | None
    approach: ApproachPath | None
    docking: Docking | None
    left_out: dict[str, str]
    notes: tuple[str, ...]
    intervals: Intervals | None = None
    """Of what the run does not determine"""
    instants_s: tuple[float, ...] = ()
    """Times whose volumes are written"""


def final_estimate(run: Path) -> tuple[FinalEstimate, Summary]:
    """The end of a run. Raises InputError when it has no estimate."""
    return final_estimates(run)[0], read_summary(run)


def surface_of(run: Path) -> SurfaceModel:
    """The mesh of a run. Raises InputError when there is none."""
    path = run / "mesh.ply"
    if not path.is_file():
        raise InputError(f"{path} is missing: this run has no mesh; run it again with depth")
    surface = read_ply(path)
    if len(surface.mesh.faces) == 0:
        raise InputError(f"{path} has no faces: this run has no mesh; see its warnings")
    return surface


def plan_run(
    run: Path,
    options: KeepOutOptions,
    docking: Docking | None,
    progress: Progress | None = None,
    instants: int = 0,
) -> Plan:
    """All parts that the run allows; the others are named with the reason.

    instants: number of times, spread over the horizon, whose volumes are to be written.

    A rotation that the images leave open has several hypotheses: the volume and the largest speeds are those
    of all of them, and what belongs to a place on the target is left out.
    """
    estimates, summary = final_estimates(run), read_summary(run)
    estimate = estimates[0]
    require_options(options, estimate)
    left_out: dict[str, str] = {}
    notes = [*summary.warnings[:1]] if summary.status == "failed" else []
    if hidden := undetermined_names(summary):
        names = ", ".join(hidden)
        notes.append(f"The run does not determine {names}: the sampled motions agree with the observed one.")
    if len(summary.hypotheses) > 1:
        turns = "; ".join(f"{each.reason} (odds {each.odds:.2f})" for each in summary.hypotheses)
        notes.append(
            f"The rotation is ambiguous ({turns}): the keep-out volume and the largest speeds of the surface "
            "hold for all of them, its other speeds for the first."
        )
    if ranges := describe_intervals(summary):
        notes.append(f"By the hull of the body: {'; '.join(ranges)}.")
    found, speed, surface, path, approach = None, None, None, None, None
    times = np.concatenate([[0.0], member_times(estimates, options.horizon_s)])
    motion, *other_motions = (nominal_motion(each, times) for each in estimates)
    try:
        surface = surface_of(run)
    except InputError as error:
        left_out["keepout"] = left_out["surface_speed"] = str(error)
    doubts = [] if docking is None else _check_docking(docking, surface, run)
    if surface is not None:
        found, mesh = _keep_out(run, surface, estimates, options, progress), surface.mesh
        notes.append(COVERED[found.body.covers].format(share=f"{found.body.open_share:.1%}"))
        if found.body.covers not in ("possible", "outlines") and options.cover == "auto":
            notes.append(
                "This run has no occupancy.npz, so what outlines show and the mesh lacks is missing in the "
                "volume: run it again from its images."
            )
        seen = (
            summary.coverage.words if summary.coverage is not None else "the run does not say what was seen"
        )
        notes.append(f"Parts that no image shows and that protrude are not covered: {seen}.")
        vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
        speed = surface_speed(motion, vertices, normals, estimate.last.covariance, other_motions)
    if docking is None:
        left_out["corridor"] = "no --dock-point and --dock-axis"
    elif other_motions:
        left_out["corridor"] = OPEN_ROTATION
    else:
        notes += doubts
        path = docking.corridor(motion)
    try:
        # the camera's path from its last pose to the docking point, or towards the centre of mass
        X_NR = read_measurements(run / "measurements.npz").X_NR[-1]
        ahead = nominal_motion(estimate, np.linspace(0.0, options.horizon_s, POSES))
        if docking is not None and other_motions:
            left_out["approach"] = OPEN_ROTATION
        elif docking is not None:
            approach = along_corridor(ahead, docking.corridor(ahead), X_NR, docking.stand_off_m)
        elif found is not None:
            farthest_m = np.linalg.norm(found.body.points_G - estimate.com_G, axis=1).max()
            # over the distance of the farthest part of the body with its margin
            margin_m = max(each.margin_m().max() for each in found.instant.hypotheses)
            end_m = 1.5 * float(farthest_m + margin_m)
            approach = towards_centre(ahead, X_NR, end_m)
        else:
            why = "no surface, whose size decides how near the camera may come, and no --dock-point"
            left_out["approach"] = why
    except InputError as error:
        left_out["approach"] = str(error)
    return Plan(
        *(options.horizon_s, options.confidence, found, speed, surface, path, approach, docking),
        left_out=left_out,
        notes=tuple(notes),
        intervals=summary.intervals,
        instants_s=tuple(np.linspace(0.0, options.horizon_s, instants).tolist()),
    )


def keep_out_of_run(run: Path, options: KeepOutOptions, progress: Progress | None = None) -> KeepOut:
    """The keep-out volume alone. Raises InputError: no estimate, no mesh, or options that do not fit."""
    estimates = final_estimates(run)
    require_options(options, estimates[0])
    return _keep_out(run, surface_of(run), estimates, options, progress)


def require_options(options: KeepOutOptions, estimate: FinalEstimate) -> None:
    """Raise InputError for options of a keep-out volume that do not fit."""
    if not 0.5 <= options.confidence <= MOST_CONFIDENT:
        raise InputError(f"--confidence {options.confidence:g}: give a share from 0.5 to {MOST_CONFIDENT:g}")
    if options.drawn < LEAST_MEMBERS:
        raise InputError(f"--members {options.members}: give {LEAST_MEMBERS} or more")
    require_horizon(options.horizon_s, float(np.linalg.norm(estimate.last.w_G)))


def _keep_out(
    run: Path,
    surface: SurfaceModel,
    estimates: tuple[FinalEstimate, ...],
    options: KeepOutOptions,
    progress: Progress | None,
) -> KeepOut:
    instants = len(member_times(estimates, options.horizon_s))
    seconds = len(estimates) * (FIRST_S + MEMBER_S * options.drawn * instants)
    _log.log(
        NOTE, "keep-out volume: %d motions at %d instants, about %.0f s", options.drawn, instants, seconds
    )
    return keep_out_of_all(surface, estimates, options, read_occupancy(run), progress)


def _check_docking(docking: Docking, surface: SurfaceModel | None, run: Path) -> list[str]:
    """Doubts about the docking point and axis. Raises InputError for a point far from the target."""
    if surface is not None:
        points, what = np.asarray(surface.mesh.vertices), "surface"
        away = float(distance_to_surface(surface.mesh, docking.point_G[None])[0])
    else:
        file = run / "landmarks.ply"
        points, what = read_landmarks(file).p_G if file.is_file() else np.zeros((0, 3)), "nearest landmark"
        away = float(np.linalg.norm(points - docking.point_G, axis=1).min(initial=np.inf))
    if len(points) == 0:
        return ["Whether the docking point lies on the target is unknown: the run has no surface."]
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    point = " ".join(f"{x:g}" for x in docking.point_G)
    distance = f"--dock-point {point} is {away:.3g} m from the {what}, and the target is {size:.2g} m across"
    if away > MAX_DOCK_DISTANCE * size:
        raise InputError(f"{distance}: give metres in G, the frame of mesh.ply")
    found = []
    if away > DOUBTFUL_DOCK_DISTANCE * size:
        found.append(
            f"--dock-point {point} is inside the body, {away:.3g} m below its surface: give a point on "
            "the surface; is it in G, in metres?"
            if surface is not None and encloses(surface.mesh, docking.point_G)
            else f"{distance}: the corridor belongs to a point off the target; is it in G, in metres?"
        )
    if surface is not None:
        axis = docking.axis_G / np.linalg.norm(docking.axis_G)
        start = docking.point_G + (away + DOUBTFUL_DOCK_DISTANCE * size) * axis
        if np.isfinite(Caster(surface.mesh).first(start, axis[None])[0]).all():
            found.append("The docking axis runs into the target: it should point outwards.")
    return found
