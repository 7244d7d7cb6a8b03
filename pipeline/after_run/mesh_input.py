"""A mesh that the user names: PLY, STL, OBJ, GLB."""

from pathlib import Path

import numpy as np
import trimesh

from polhode.errors import InputError


def read_mesh(file: Path, unit_m: float) -> trimesh.Trimesh:
    """The mesh in metres; ``unit_m``: metres of a unit of the file. Raises InputError, one line."""
    if not file.is_file():
        raise InputError(f"{file}: no such file; give a mesh")
    try:
        mesh = trimesh.load(file, force="mesh")
    except Exception as error:  # readers of many formats raise many things
        raise InputError(f"{file}: cannot be read as a mesh ({error}); give PLY, STL, OBJ or GLB") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"{file}: holds no triangles; give PLY, STL, OBJ or GLB")
    if not np.isfinite(mesh.vertices).all() or mesh.area == 0.0:
        raise InputError(f"{file}: a vertex is not finite, or the mesh has no area")
    mesh.apply_scale(unit_m)
    return mesh
