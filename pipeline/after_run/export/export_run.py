"""A run in the format of another program: what it has is exported, what it lacks is left out with a warning.

Each writer below takes the run as far as it got, returns the files' contents, and names what it left out.
"""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from polhode.atomic import write_bytes
from polhode.errors import InputError
from polhode.pipeline.after_run.export.job import ExportJob, Files, last_state, read_run
from polhode.pipeline.after_run.export.options import (
    MESHES,
    METRES,
    MOTIONS,
    ROBOTS,
    ExportOptions,
    check,
    creation_date,
)
from polhode.pipeline.after_run.export.placement import placement
from polhode.planning.exports import ccsds, glb, mesh_files, robot_xml
from polhode.planning.exports.convex_pieces import WITHIN, decompose
from polhode.planning.exports.json_document import (
    Document,
    MassPropertiesOut,
    frame_out,
    inertial_out,
    shape_out,
    states_out,
    text_of,
)
from polhode.planning.exports.records import ExportShape, shape_of_landmarks, shape_of_surface

LIGHT_LEVEL = 2
"""Of the surface that robot formats show, where the run's mesh has so many levels."""
SURFACE_FILE = "surface.obj"
FAR_SHARE = 1e-3
"""Share of the pieces' area that protrudes too far, above which there is a warning."""

_log = logging.getLogger(__name__)


def robot_files(job: ExportJob) -> Files:
    """The XML, and in a folder beside it the surface and the convex pieces. Raises InputError."""
    options, shape = job.options, job.shape(LIGHT_LEVEL)
    inertial = job.inertial()
    state = last_state(job.source, job.at) if job.source.has_motion else None
    if shape is None and inertial is None:
        raise InputError(
            f"{job.source.folder}: this run has neither mesh nor mass properties; nothing to export"
            f"{job.source.words}"
        )
    if state is None:
        job.leave_out("the state is left out: this run has no motion; the body rests at the origin")
    folder = options.output.with_name(f"{options.output.stem}_meshes")
    files: Files = {}
    words = [*job.comments, *(inertial.words if inertial is not None else ())]
    visual, collision = None, []
    if shape is None:
        job.leave_out("surface and collision geometry are left out: this run has no mesh")
    else:
        visual = SURFACE_FILE
        files[folder / visual] = mesh_files.obj(shape, job.comments, 1.0)
        full = job.source.surface
        assert full is not None
        try:
            # of the full mesh, whatever level is shown: a lighter one may lie inside it
            cut = decompose(shape_of_surface(full, job.at), options.pieces)
        except ValueError as error:
            job.leave_out(f"collision geometry is left out: {error}")
        else:
            words.append(f"{cut.words}; {cut.reach_words}")
            _log.info("%s", words[-1])
            if cut.far_share > FAR_SHARE:
                job.leave_out(
                    f"{cut.far_share:.1%} of the collision geometry protrudes from the surface by more than "
                    f"{WITHIN:.0%} of its diameter: more --pieces protrude less"
                )
            for number, piece in enumerate(cut.pieces):
                collision.append(f"collision_{number:03d}.obj")
                files[folder / collision[-1]] = mesh_files.plain_obj(
                    np.asarray(piece.vertices),
                    np.asarray(piece.faces, dtype=np.int64),
                    [f"convex piece, frame {job.at.name}, metres"],
                )
    words += [robot_xml.state_words(state)] if state is not None else []
    # Assumptions are shown on the terminal, too.
    for sentence in inertial.words if inertial is not None else ():
        job.leave_out(sentence)
    robot = robot_xml.Robot(
        name=options.object_name,
        folder=folder.name,
        visual=visual,
        collision=tuple(collision),
        inertial=inertial,
        state=state,
        comments=tuple(words),
    )
    write: dict[str, Callable[[robot_xml.Robot], str]] = {
        "urdf": robot_xml.urdf,
        "mjcf": robot_xml.mjcf,
        "sdf": robot_xml.sdf,
    }
    files[options.output] = write[options.to](robot).encode()
    return files


def remove_old_pieces(files: Files) -> None:
    """Pieces of an earlier export under the same name that this one does not replace."""
    for folder in {path.parent for path in files if path.name == SURFACE_FILE}:
        for path in folder.glob("collision_[0-9][0-9][0-9].obj"):
            if path not in files:
                path.unlink()


TURN_PER_KEY_RAD = np.deg2rad(5.0)
"""Between two keys of an animation: viewers go straight from one to the next."""
FRAME_N = (
    "N, inertial: the left camera at the first frame (x right, y down, z forward), or the frame of the "
    "inspector's poses where those were given"
)

_log = logging.getLogger(__name__)


def export_run(run: Path, options: ExportOptions) -> list[Path]:
    """Write the files, the one that was named last. Raises InputError when nothing can be written."""
    check(options)
    found = read_run(run)
    if options.to in MOTIONS and not found.has_motion:
        raise InputError(f"{run}: {found.no_motion}; nothing for {options.to}, json has what there is")
    at, warnings = placement(
        options.frame_name,
        found.summary,
        found.surface,
        options.cad,
        options.cad_points,
        METRES[options.cad_unit],
    )
    job = ExportJob(options, found, at, list(warnings))
    if found.summary.status == "failed":
        reason = found.summary.warnings[0] if found.summary.warnings else "no reason is known"
        job.leave_out(f"this run failed ({reason}): what it had found by then is exported")
    files = _WRITERS[options.to](job)
    for words in job.left_out:
        _log.warning("%s", words)
    remove_old_pieces(files)
    for path, content in files.items():
        try:
            path.parent.mkdir(exist_ok=True)
            write_bytes(path, content)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}); choose another -o") from error
    return list(files)


def _drawn(job: ExportJob) -> ExportShape:
    """The mesh, or else the landmarks. Raises InputError when there are neither."""
    shape, to = job.shape(), job.options.to
    if shape is not None:
        return shape
    if job.source.landmarks is None:
        raise InputError(
            f"{job.source.folder}: this run has neither mesh nor landmarks; nothing for {to}"
            f"{job.source.words}"
        )
    if to == "stl":
        raise InputError(
            f"{job.source.folder}: this run has no mesh, and STL has triangles only; "
            "ply, glb and obj have its landmarks"
        )
    job.leave_out("the surface is left out, as this run has no mesh: the file holds the landmarks, as points")
    return shape_of_landmarks(job.source.landmarks, job.at)


def _mesh(job: ExportJob) -> Files:
    options, shape = job.options, _drawn(job)
    unit, per_m = options.unit, 1.0 / METRES[options.unit]
    comments = [*job.comments, f"unit: {unit}"]
    if options.to == "ply":
        content = mesh_files.ply(shape, comments, per_m, unit)
    elif options.to == "obj":
        content = mesh_files.obj(shape, comments, per_m)
        job.leave_out("OBJ cannot store standard deviations: ply, glb and json have them")
    elif options.to == "stl":
        content = mesh_files.stl(shape, f"frame {job.at.name}, {unit}", per_m)
        job.leave_out("STL cannot store colours and standard deviations: ply and glb have them")
    else:
        content = _glb(job, shape, per_m)
    return {options.output: content}


def _glb(job: ExportJob, shape: ExportShape, per_m: float) -> bytes:
    options = job.options
    extras: dict[str, Any] = {"comments": job.comments, "frame": job.at.name, "unit": options.unit}
    if options.unit == "mm":
        job.leave_out("glTF's unit is the metre by its standard: programs take these millimetres for metres")
    animation = None
    if options.animate:
        step = options.step_s
        if job.source.has_motion:
            rate = float(np.linalg.norm(last_state(job.source, job.at).w_F))
            smooth = TURN_PER_KEY_RAD / max(rate, 1e-6)
            # never coarser than the turn allows, and no more keys than that takes
            step = min(smooth, options.horizon) if step is None else min(step, smooth)
        motion = job.motion(step)
        animation = glb.Animation(motion.time_s, job.poses(motion))
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
    return glb.glb(shape, extras, per_m, options.unit, animation)


def _motion(job: ExportJob) -> Files:
    options = job.options
    motion = job.motion(options.step_s)
    if motion.undetermined:
        job.leave_out(
            f"the run does not determine {', '.join(motion.undetermined)}: estimated axes and centre of mass "
            "are taken as marks on the body"
        )
    X_NF = job.poses(motion)
    marks = ["the run has no covariances: the uncertainty is unknown"]
    if motion.has_covariance:
        sigma = np.sqrt(np.diagonal(motion.covariance_of_marks, axis1=1, axis2=2))
        marks = [
            f"standard deviation of the body's attitude, worst axis: {np.rad2deg(sigma[0, 6:9].max()):.3g} "
            f"deg at the start, {np.rad2deg(sigma[-1, 6:9].max()):.3g} deg at the end; the JSON export has "
            "all covariances",
        ]
    header = ccsds.MessageHeader(
        object_name=options.object_name,
        object_id=options.object_id,
        center_name="INSPECTOR_START",
        frame_name="LOCAL_INERTIAL_N",
        epoch=options.epoch_utc,
        created=creation_date(),
        comments=(
            job.comments[0],
            "predicted motion of a free rigid body, from the last state of the run on",
            f"timestamps of the run are nanoseconds since {options.epoch_utc.astype('datetime64[s]')} UTC, "
            "leap seconds not counted",
        ),
    )
    if options.to == "oem":
        text = ccsds.oem(motion, header)
    elif options.to == "aem":
        R_FP = job.at.R_FG @ np.array(job.source.summary.R_GP)
        names = {"G": "TARGET_G", "P": "TARGET_P", "cad": "TARGET_CAD"}
        words = [*job.comments[1:], *marks]
        text = ccsds.aem(
            motion.timestamps_ns, X_NF[:, :3, :3], motion.w_P @ R_FP.T, header, names[job.at.name], words
        )
    else:
        text = ccsds.tum(
            motion.timestamps_ns,
            X_NF,
            [
                *job.comments,
                "poses of the frame in N [m], predicted from the last state of the run on",
                *marks,
            ],
        )
    return {options.output: text.encode("ascii", "replace")}


def _json(job: ExportJob) -> Files:
    options, summary = job.options, job.source.summary
    last, ahead, undetermined = None, [], []
    if job.source.has_motion:
        motion = job.motion(options.step_s)
        states = states_out(motion, job.poses(motion), ccsds.utc(motion.timestamps_ns, options.epoch_utc))
        last, ahead, undetermined = states[0], states[1:], list(motion.undetermined)
    else:
        job.leave_out(f"states and prediction are left out: {job.source.no_motion}")
    shape = job.shape()
    if shape is None:
        job.leave_out("the shape is left out: this run has no mesh")
    inertial = job.inertial()
    found = summary.inertia
    document = Document(
        run_status=summary.status,
        run_warnings=summary.warnings,
        left_out=job.left_out,
        epoch_utc=str(options.epoch_utc.astype("datetime64[s]")),
        frame_N=FRAME_N,
        frame=frame_out(job.at),
        last=last,
        prediction=ahead,
        undetermined=undetermined,
        mass_properties=MassPropertiesOut(
            moments=found.moments if found else None,
            sigma_moments=found.sigma_moments if found else None,
            k1=found.k1 if found else None,
            k2=found.k2 if found else None,
            cov_k=found.cov if found else None,
            com_G=summary.com_G,
            cov_com_G=summary.cov_com_G,
            R_GP=summary.R_GP,
            cov_R_GP=summary.cov_R_GP,
            identifiable=summary.identifiable.model_dump() if summary.identifiable else None,
            identifiable_detail=summary.identifiable_detail,
        ),
        inertial=inertial_out(inertial) if inertial is not None else None,
        shape=shape_out(shape) if shape is not None else None,
    )
    return {options.output: text_of(document).encode()}


_WRITERS: dict[str, Callable[[ExportJob], Files]] = {
    **dict.fromkeys(MESHES, _mesh),
    **dict.fromkeys(ROBOTS, robot_files),
    **dict.fromkeys(MOTIONS, _motion),
    "json": _json,
}
