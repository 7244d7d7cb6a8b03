"""Where an export goes, and which files there are of an earlier export: only those are replaced."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polhode.files.atomic import write_all
from polhode.files.output.marked_folder import claim, forget_others, marked_folder
from polhode.files.output.place import beginning_of
from polhode.files.output.single_file import make_parent, output_file
from polhode.planning.exports.formats import ROBOTS
from polhode.planning.exports.job import Files
from polhode.planning.exports.options import ExportOptions

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


@contextmanager
def export_place(options: ExportOptions) -> Iterator[Path]:
    """The file that will be written, links followed; checked before the work. Raises InputError.

    Robots have a folder of meshes beside it, which must be new, empty or of an earlier export; no other
    process of ours writes into it while the block runs.
    """
    inputs = [path for path in (options.cad, options.cad_points) if path is not None]
    place = output_file(options.output, COMMAND, "target.glb", _is_export, inputs)
    if options.to not in ROBOTS:
        yield place
        return
    with marked_folder(meshes_of(place), COMMAND, is_mesh, meshes_of(options.output)):
        yield place


def meshes_of(output: Path) -> Path:
    """The folder of a robot's meshes, for this file alone: target.xml and target.urdf may differ in frame."""
    return output.with_name(f"{output.name}_meshes")


def piece_file(number: int) -> str:
    """Name of a convex piece."""
    return f"collision_{number:03d}.obj"


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
