"""A run in the format of another program: what it has is exported, what it lacks is left out with a warning.

Each function below takes the run as far as it got, returns the files' contents, and names what it left out.
The formats themselves are written by the other modules of ``polhode/planning/exports``.
"""

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.exchange.obj import export_obj

from polhode.files.atomic import write_all
from polhode.files.output.marked_folder import claim, forget_others, marked_folder
from polhode.files.output.place import beginning_of
from polhode.files.output.single_file import make_parent, output_file
from polhode.planning.exports import ccsds, mesh_files, robot_xml
from polhode.planning.exports.collision_body import collision_body
from polhode.planning.exports.convex_pieces import MAX_PROTRUSION_SHARE, decompose
from polhode.planning.exports.formats import MESHES, MOTIONS, ROBOTS
from polhode.planning.exports.job import ExportJob, Files, failure_of, open_job
from polhode.planning.exports.json_document import json_document
from polhode.planning.exports.mass_properties import Inertial
from polhode.planning.exports.options import METRES, ExportOptions, check, creation_date
from polhode.run_directory.archives import read_occupancy
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import missing_part
from polhode.runtime.progress import Progress, Silent

COMMAND = "export"
SURFACE_FILE = "surface.obj"
SIGNS = (
    rb'glTF\x02\0\0\0.{8}JSON\{"asset":\{"version":"2\.0","generator":"polhode","extras":'
    rb'\{"comments":\["polhode export of the run ',
    rb"ply\nformat binary_little_endian 1\.0\ncomment polhode export of the run [^\n]*\ncomment frame: ",
    rb"(?=.{80})binary STL; (polhode export, )?frame (G|P|cad), m?m +(?<=\A.{80})",
    rb"# polhode export of the run [^\n]*\n# frame: [^\n]*\n# unit: m?m\n",
    rb'<\?xml version="1\.0" encoding="utf-8"\?>\n<(robot name|mujoco model|sdf version)="[^"<>]*">\n'
    rb"  <!-- polhode export of the run ",
    rb"CCSDS_[AO]EM_VERS = [12]\.0\nCOMMENT polhode export of the run\s",
    rb"# polhode export of the run [^\n]*\n# frame: [^\n]*\n"
    rb"# poses of the frame in N \[m\], (predicted from |estimated at the frames of the run\n)",
    rb'\{\n "schema": "polhode-export/1",\n "run_status": "',
)
"""How a file of one of our formats begins, in this and in earlier versions: what else only mentions us."""

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
        if count := len(job.summary.hypotheses):
            job.leave_out(
                f"the rotation is ambiguous: the file holds the most probable of {count} hypotheses; "
                "polhode predict writes each"
            )
        files = _CONTENT[options.to](job)
        for reason in job.left_out:
            _log.warning("%s", reason)
        write_export(files, place)
        return Export(list(files), job.written)


def _mesh(job: ExportJob) -> Files:
    """The mesh, or else the landmarks. Raises InputError when there are neither."""
    options, shape, to = job.options, job.shape(), job.options.to
    if shape is None:
        shape = job.points()
        if shape is None:
            raise job.nothing(f"this run has neither mesh nor landmarks; nothing for {to}")
        if to == "stl":
            raise InputError(
                f"{job.folder}: this run has no mesh, and STL has triangles only; "
                "ply, glb and obj have its landmarks"
            )
        job.leave_out(
            "the surface is left out, as this run has no mesh: the file holds the landmarks, as points"
        )
    unit, per_m = options.unit, 1.0 / METRES[options.unit]
    comments = [*job.comments, f"unit: {unit}"]
    if to == "ply":
        return {options.output: mesh_files.ply(shape, comments, per_m, unit)}
    if to == "obj":
        job.leave_out("OBJ cannot store standard deviations: ply, glb and json have them")
        return {options.output: mesh_files.obj(shape, comments, per_m)}
    if to == "stl":
        job.leave_out("STL cannot store colours and standard deviations: ply and glb have them")
        return {
            options.output: mesh_files.stl(
                shape, f"polhode export, frame {options.frame_name}, {unit}", per_m
            )
        }
    extras: dict[str, Any] = {"comments": job.comments, "frame": options.frame_name, "unit": unit}
    if unit == "mm":
        job.leave_out("glTF's unit is the metre by its standard: programs take these millimetres for metres")
    return {options.output: mesh_files.glb(shape, extras, per_m, unit)}


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
            solid = collision_body(job.surface, read_occupancy(job.folder), options.cover, job.X_FG)
            cut = decompose(solid.surface, options.pieces, solid.closed)
        except ValueError as error:
            job.leave_out(f"collision geometry is left out: {error}")
        else:
            without = missing_part("vhacdx")
            if options.pieces > 1 and without:
                job.leave_out(f"{without}: the collision geometry is the convex hull")
            comments.append(f"{cut.description}; {solid.words}")
            _log.info("%s", comments[-1])
            if cut.far_share > 1e-3:
                more = "" if without else ": more --pieces protrude less"
                job.leave_out(
                    f"{cut.far_share:.1%} of the collision geometry protrudes from the surface by more than "
                    f"{MAX_PROTRUSION_SHARE:.0%} of its diameter{more}"
                )
            header = f"convex piece, frame {options.frame_name}, metres"
            for number, piece in enumerate(cut.pieces):
                pieces.append(f"collision_{number:03d}.obj")
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
    sigma = np.sqrt(np.diagonal(motion.covariance_of_marks, axis1=1, axis2=2))
    uncertainty = (
        f"standard deviation of the body's attitude, worst axis: {np.rad2deg(sigma[0, 6:9].max()):.3g} deg "
        f"at the start, {np.rad2deg(sigma[-1, 6:9].max()):.3g} deg at the end; the JSON export has all "
        "covariances"
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
        w_F = motion.w_P @ (job.X_FG[:3, :3] @ np.array(job.summary.R_GP)).T
        frame = "the principal axes P" if options.frame_name == "P" else "the frame G of the run's mesh"
        comments = [f"{ccsds.BODY_FRAME} is the target's frame F: {frame}", *job.comments[1:], uncertainty]
        text = ccsds.aem(motion.timestamps_ns, X_NF[:, :3, :3], w_F, header, comments)
    return {options.output: text.encode("ascii", "replace")}


_CONTENT: dict[str, Callable[[ExportJob], Files]] = {
    **dict.fromkeys(MESHES, _mesh),
    **dict.fromkeys(ROBOTS, _robot),
    **dict.fromkeys(MOTIONS, _motion),
    "json": lambda job: {job.options.output: json_document(job).encode()},
}


@contextmanager
def export_place(options: ExportOptions) -> Iterator[Path]:
    """The file that will be written, links followed; checked before the work. Raises InputError.

    Robots have a folder of meshes beside it, which must be new, empty or of an earlier export; no other
    process of ours writes into it while the block runs.
    """
    place = output_file(options.output, COMMAND, "target.glb", _is_export)
    if options.to not in ROBOTS:
        yield place
        return
    with marked_folder(meshes_of(place), COMMAND, is_mesh, meshes_of(options.output)):
        yield place


def meshes_of(output: Path) -> Path:
    """The folder of a robot's meshes, for this file alone: target.xml and target.urdf may differ in frame."""
    return output.with_name(f"{output.name}_meshes")


def is_mesh(name: str) -> bool:
    """Whether an export writes a mesh of this name."""
    return name == SURFACE_FILE or re.fullmatch(r"collision_\d{3,4}\.obj", name) is not None


def write_export(files: Files, output: Path) -> None:
    """Write all files or none, and remove pieces of an earlier export that are not among them.

    Raises InputError and RunFailure: a file cannot be written.
    """
    folder = meshes_of(output)
    meshes = {path.name: content for path, content in files.items() if path.parent == folder}
    make_parent(output, output)
    if meshes:
        claim(folder, COMMAND, list(meshes))
    write_all(files)
    if meshes:
        forget_others(folder, COMMAND, meshes, is_mesh)


def _is_export(path: Path) -> bool:
    beginning = beginning_of(path)
    return any(re.match(sign, beginning, re.DOTALL) for sign in SIGNS)
