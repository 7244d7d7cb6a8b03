"""URDF, MJCF and SDF of a run, with their mesh files."""

import logging
from collections.abc import Callable

import numpy as np

from polhode.errors import InputError
from polhode.pipeline.after_run.export.job import ExportJob, Files, last_state
from polhode.planning.exports import mesh_files, robot_xml
from polhode.planning.exports.convex_pieces import WITHIN, decompose
from polhode.planning.exports.records import shape_of_surface

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
