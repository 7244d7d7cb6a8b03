"""Meshes on disk: PLY with properties of vertices and faces, GLB for viewers; deterministic."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from polhode.files.atomic import write_bytes
from polhode.files.foreign_meshes import OF_A_RUN, open_mesh
from polhode.files.ply import VertexColumns, surface_ply
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError

MIN_SIZE_M, MAX_SIZE_M = 1e-4, 1e4
"""Of a mesh that a user gives, corner to corner."""


def write_ply(surface: SurfaceModel, path: Path) -> None:
    """Binary PLY: x y z [m in G], normal, colour, sigma_m [m], views, coverage; triangles, ``invented``."""
    mesh = surface.mesh
    content = surface_ply(
        VertexColumns(
            np.asarray(mesh.vertices),
            np.asarray(mesh.vertex_normals) if len(mesh.vertices) else np.zeros((0, 3)),
            _colours(mesh) if len(mesh.vertices) else np.zeros((0, 4), np.uint8),
            surface.sigma_m,
            surface.views,
            surface.coverage_classes,
        ),
        faces=mesh.faces,
        invented=surface.is_invented,
        comments=["frame G, metres"],
        more_comments=["invented 1: the face closes a small hole"],
    )
    write_bytes(path, content)


def _colours(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    """(V, 4)"""
    colours = mesh.visual.vertex_colors if isinstance(mesh.visual, ColorVisuals) else np.full((1, 4), 128)
    return np.broadcast_to(np.asarray(colours, dtype=np.uint8), (len(mesh.vertices), 4))


def read_ply(path: Path) -> SurfaceModel:
    """The surface that ``write_ply`` wrote (float32 precision), of this or an earlier version.

    Raises InputError for anything else.
    """
    mesh = open_mesh(path, OF_A_RUN).mesh(process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        raise InputError(f"{path}: not a triangle mesh; give the mesh.ply of a run")
    raw = mesh.metadata.get("_ply_raw", {})
    vertex, face = (raw.get(element, {}).get("data") for element in ("vertex", "face"))
    if vertex is None or not {"sigma_m", "views"} <= set(vertex.dtype.names or ()):
        raise InputError(f"{path}: vertices without sigma_m and views: not a mesh of a run")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: a vertex is NaN or infinite; run 'polhode run' again")
    flags = face["invented"] if face is not None and "invented" in (face.dtype.names or ()) else None
    classes = vertex["coverage"] if "coverage" in (vertex.dtype.names or ()) else None
    return SurfaceModel(
        mesh=mesh,
        sigma_m=np.asarray(vertex["sigma_m"], dtype=np.float64).reshape(-1),
        views=np.asarray(vertex["views"], dtype=np.int64).reshape(-1),
        invented=None if flags is None else np.asarray(flags).reshape(-1) > 0,
        coverage=None if classes is None else np.asarray(classes, dtype=np.uint8).reshape(-1),
    )


def write_glb(surface: SurfaceModel, path: Path) -> None:
    """Binary glTF 2.0 with vertex colours and normals, in G [m].

    Faces that were invented are a mesh of their own, ``invented``, beside ``surface``: a viewer hides it.
    """
    invented = surface.is_invented
    scene = trimesh.Scene()
    for name, chosen in (("surface", ~invented), ("invented", invented)):
        if chosen.any() or (name == "surface" and not invented.any()):
            scene.add_geometry(_part(surface.mesh, chosen), node_name=name, geom_name=name)
    content = scene.export(file_type="glb", include_normals=True)
    assert isinstance(content, bytes)
    write_bytes(path, content)


def _part(mesh: trimesh.Trimesh, chosen: NDArray[np.bool_]) -> trimesh.Trimesh:
    """The chosen faces with their vertices and the whole mesh's normals, so that no seam shows."""
    faces = np.asarray(mesh.faces)[chosen]
    used = np.unique(faces)
    if len(used) == len(mesh.vertices):
        used, renumbered = np.arange(len(used)), faces
    else:
        renumbered = np.searchsorted(used, faces)
    return trimesh.Trimesh(
        np.asarray(mesh.vertices)[used],
        renumbered,
        vertex_normals=np.asarray(mesh.vertex_normals)[used] if len(used) else None,
        vertex_colors=_colours(mesh)[used] if len(used) else None,
        process=False,
    )


def read_mesh(file: Path, unit_m: float) -> trimesh.Trimesh:
    """The mesh in metres; ``unit_m``: metres of a unit of the file. Raises InputError, one line."""
    if not file.exists():
        raise InputError(f"{file}: no such file; give a mesh")
    mesh = open_mesh(file).merged()
    if len(mesh.faces) == 0:
        raise InputError(f"{file}: holds no triangles; give PLY, STL, OBJ or GLB")
    size_m = unit_m * float(np.linalg.norm(mesh.extents))
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        raise InputError(f"{file}: the mesh is {size_m:.3g} m large; check the unit")
    mesh.apply_scale(unit_m)
    if not mesh.area > 0.0:
        raise InputError(f"{file}: the mesh has no area; repair it")
    return mesh
