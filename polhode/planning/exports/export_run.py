"""A run in the format of another program: what it has is exported, what it lacks is left out with a warning.

Each function below takes the run as far as it got, returns the files' contents, and names what it left out.
The formats themselves are written by the other modules of ``polhode/planning/exports``.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.obj import export_obj

from polhode.planning.exports import ccsds, glb, mesh_files, robot_xml
from polhode.planning.exports.convex_pieces import MAX_PROTRUSION_SHARE, decompose
from polhode.planning.exports.formats import MESHES, MOTIONS, ROBOTS
from polhode.planning.exports.job import ExportJob, Files, failure_of, open_job
from polhode.planning.exports.json_document import json_document
from polhode.planning.exports.options import METRES, ExportOptions, check, creation_date
from polhode.planning.exports.own_files import SURFACE_FILE, export_place, meshes_of, piece_file, write_export
from polhode.planning.exports.records import Inertial, shape_of_landmarks, shape_of_surface
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import missing_part
from polhode.runtime.progress import Progress, Silent

FAR_SHARE = 1e-3
"""Share of the pieces' area that protrudes too far, above which there is a warning."""
MAX_KEY_ROTATION_RAD = np.deg2rad(5.0)
"""Between two keys of an animation, which viewers interpolate linearly."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Export:
    """What was written."""

    files: list[Path]
    """The one that was named last"""
    inertial: Inertial | None
    """The mass properties in them; None: they have none"""


def export_run(run: Path, options: ExportOptions, progress: Progress | None = None) -> Export:
    """Write the files, the one that was named last.

    Raises InputError when there is nothing to export, or the place is taken; RunFailure when a file cannot be
    written.
    """
    check(options)
    with export_place(options) as place:
        job = open_job(run, replace(options, output=place), progress or Silent())
        if job.summary.status == "failed":
            reason = failure_of(job.summary)
            job.leave_out(f"this run failed ({reason}): what it had found by then is exported")
        files = _CONTENT[options.to](job)
        for reason in job.left_out:
            _log.warning("%s", reason)
        write_export(files, place)
        return Export(list(files), job.written)


def _mesh(job: ExportJob) -> Files:
    """The mesh, or else the landmarks. Raises InputError when there are neither."""
    options, shape, to = job.options, job.shape(), job.options.to
    if shape is None:
        if job.landmarks is None:
            raise job.nothing(f"this run has neither mesh nor landmarks; nothing for {to}")
        if to == "stl":
            raise InputError(
                f"{job.folder}: this run has no mesh, and STL has triangles only; "
                "ply, glb and obj have its landmarks"
            )
        job.leave_out(
            "the surface is left out, as this run has no mesh: the file holds the landmarks, as points"
        )
        shape = shape_of_landmarks(job.landmarks, job.at)
    unit, per_m = options.unit, 1.0 / METRES[options.unit]
    comments = [*job.comments, f"unit: {unit}"]
    if to == "ply":
        return {options.output: mesh_files.ply(shape, comments, per_m, unit)}
    if to == "obj":
        job.leave_out("OBJ cannot store standard deviations: ply, glb and json have them")
        return {options.output: mesh_files.obj(shape, comments, per_m)}
    if to == "stl":
        job.leave_out("STL cannot store colours and standard deviations: ply and glb have them")
        return {options.output: mesh_files.stl(shape, f"polhode export, frame {job.at.name}, {unit}", per_m)}
    extras: dict[str, Any] = {"comments": job.comments, "frame": job.at.name, "unit": unit}
    if unit == "mm":
        job.leave_out("glTF's unit is the metre by its standard: programs take these millimetres for metres")
    animation = _animation(job, extras) if options.animate else None
    return {options.output: glb.glb(shape, extras, per_m, unit, animation)}


def _animation(job: ExportJob, extras: dict[str, Any]) -> glb.Animation:
    """The predicted motion, described in the extras."""
    options, step = job.options, job.options.step_s
    if not job.no_motion:
        rate = float(np.linalg.norm(job.last_state().w_F))
        smooth = MAX_KEY_ROTATION_RAD / max(rate, 1e-6)
        # never coarser than the rotation allows, and no more keys than that takes
        step = min(smooth, options.horizon if step is None else step)
    motion = job.motion(step)
    extras["animation"] = {
        "words": "the node target moves in N: at time 0 it is at the last state of the run",
        "horizon_s": options.horizon,
    }
    if motion.has_covariance:
        sigma = np.sqrt(np.diagonal(motion.covariance_of_marks[-1]))
        extras["animation"] |= {
            "sigma_at_the_end_m": float(sigma[0:3].max()),
            "sigma_at_the_end_deg": float(np.rad2deg(sigma[6:9].max())),
        }
    return glb.Animation(motion.time_s, job.poses(motion))


def _robot(job: ExportJob) -> Files:
    """The XML, and in a folder beside it the surface and the convex pieces. Raises InputError."""
    # the surface is shown at the second level of detail, where the run's mesh has so many
    options, shape, inertial = job.options, job.shape(coarsest=2), job.inertial()
    if shape is None and inertial is None:
        raise job.nothing("this run has neither mesh nor mass properties; nothing to export")
    state = None if job.no_motion else job.last_state()
    if state is None:
        job.leave_out("the state is left out: this run has no motion; the body rests at the origin")
    folder, files, pieces = meshes_of(options.output), Files(), list[str]()
    notes = inertial.notes if inertial is not None else ()
    comments = [*job.comments, *notes]
    if shape is None or job.surface is None:
        job.leave_out("surface and collision geometry are left out: this run has no mesh")
    else:
        files[folder / SURFACE_FILE] = mesh_files.obj(shape, job.comments, 1.0)
        try:
            # of the full mesh, whatever level is shown: a lighter one may lie inside it
            cut = decompose(shape_of_surface(job.surface, job.at), options.pieces)
        except ValueError as error:
            job.leave_out(f"collision geometry is left out: {error}")
        else:
            without = missing_part("vhacdx")
            if options.pieces > 1 and without:
                job.leave_out(f"{without}: the collision geometry is the convex hull")
            comments.append(f"{cut.description}; {cut.describe_protrusion()}")
            _log.info("%s", comments[-1])
            if cut.far_share > FAR_SHARE:
                more = "" if without else ": more --pieces protrude less"
                job.leave_out(
                    f"{cut.far_share:.1%} of the collision geometry protrudes from the surface by more than "
                    f"{MAX_PROTRUSION_SHARE:.0%} of its diameter{more}"
                )
            header = f"convex piece, frame {job.at.name}, metres"
            for number, piece in enumerate(cut.pieces):
                pieces.append(piece_file(number))
                content = export_obj(
                    piece, include_normals=False, include_color=False, header=header, digits=12
                )
                files[folder / pieces[-1]] = content.encode("ascii")
    comments += [robot_xml.describe_state(state)] if state is not None else []
    # assumptions are shown on the terminal, too; what the user gave is not
    for note in notes:
        if inertial is not None and note not in inertial.restated:
            job.leave_out(note)
    visual = () if shape is None else (SURFACE_FILE,)
    robot = robot_xml.Robot(
        options.object_name, folder.name, visual, tuple(pieces), inertial, state, tuple(comments)
    )
    files[options.output] = robot_xml.WRITERS[options.to](robot).encode()
    return files


def _motion(job: ExportJob) -> Files:
    options = job.options
    if options.poses == "estimated":
        table = read_trajectory(job.folder)
        origin = "poses of the frame in N [m], estimated at the frames of the run"
        note = "standard deviations of the estimate: trajectory.csv and covariance.npz of the run"
        text = ccsds.tum(table.timestamps_ns, job.poses(table), [*job.comments, origin, note])
        return {options.output: text.encode("ascii", "replace")}
    motion = job.motion(options.step_s)
    if motion.undetermined:
        job.leave_out(
            f"the run does not determine {', '.join(motion.undetermined)}: estimated axes and centre of mass "
            "are taken as marks on the body"
        )
    X_NF = job.poses(motion)
    uncertainty = "the run has no covariances: the uncertainty is unknown"
    if motion.has_covariance:
        sigma = np.sqrt(np.diagonal(motion.covariance_of_marks, axis1=1, axis2=2))
        uncertainty = (
            f"standard deviation of the body's attitude, worst axis: {np.rad2deg(sigma[0, 6:9].max()):.3g} "
            f"deg at the start, {np.rad2deg(sigma[-1, 6:9].max()):.3g} deg at the end; the JSON export has "
            "all covariances"
        )
    if options.to == "tum":
        origin = "poses of the frame in N [m], predicted from the last state of the run on"
        text = ccsds.tum(motion.timestamps_ns, X_NF, [*job.comments, origin, uncertainty])
        return {options.output: text.encode("ascii", "replace")}
    job.check_epoch(int(motion.timestamps_ns[0]))
    header = ccsds.MessageHeader(
        options.object_name,
        options.object_id,
        options.epoch_utc,
        creation_date(),
        comments=(
            job.comments[0],
            "predicted motion of a free rigid body, from the last state of the run on",
            f"timestamps of the run are nanoseconds since {options.epoch_utc.astype('datetime64[s]')} UTC, "
            "leap seconds not counted",
        ),
    )
    if options.to == "oem":
        text = ccsds.oem(motion, header)
    else:
        w_F = motion.w_P @ (job.at.R_FG @ np.array(job.summary.R_GP)).T
        comments, body_frame = [*job.comments[1:], uncertainty], f"TARGET_{job.at.name.upper()}"
        text = ccsds.aem(motion.timestamps_ns, X_NF[:, :3, :3], w_F, header, body_frame, comments)
    return {options.output: text.encode("ascii", "replace")}


_CONTENT: dict[str, Callable[[ExportJob], Files]] = {
    **dict.fromkeys(MESHES, _mesh),
    **dict.fromkeys(ROBOTS, _robot),
    **dict.fromkeys(MOTIONS, _motion),
    "json": lambda job: {job.options.output: json_document(job).encode()},
}
