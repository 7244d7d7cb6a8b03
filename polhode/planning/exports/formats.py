"""The formats of ``polhode export``: names by kind.

A new format is listed here and in the help of ``polhode/cli/export``, its writer is a module beside this
one, and ``_CONTENT`` in ``polhode/planning/exports/export_run`` collects what the writer needs from the run.
"""

from typing import Literal, get_args

Format = Literal["glb", "ply", "stl", "obj", "urdf", "mjcf", "sdf", "aem", "oem", "tum", "json"]
FORMATS: tuple[str, ...] = get_args(Format)
MESHES = ("glb", "ply", "stl", "obj")
ROBOTS = ("urdf", "mjcf", "sdf")
MOTIONS = ("aem", "oem", "tum")
