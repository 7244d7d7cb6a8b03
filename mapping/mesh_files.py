"""Meshes on disk: PLY with sigma_m and views per vertex, GLB with vertex colours. Same mesh, same bytes."""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals

from polhode.errors import InputError
from polhode.records import SurfaceModel

_VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("alpha", "u1"),
        ("sigma_m", "<f4"),
        ("views", "<i4"),
    ]
)
_FACE = np.dtype([("count", "u1"), ("index", "<i4", (3,))])
_PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def write_ply(surface: SurfaceModel, path: Path) -> None:
    """Binary PLY: x y z [m in G], red green blue alpha, sigma_m [m], views; triangles."""
    mesh = surface.mesh
    vertices = np.zeros(len(mesh.vertices), dtype=_VERTEX)
    if len(vertices):
        for axis, name in enumerate("xyz"):
            vertices[name] = mesh.vertices[:, axis]
        colours = mesh.visual.vertex_colors if isinstance(mesh.visual, ColorVisuals) else np.full((1, 4), 128)
        for channel, name in enumerate(("red", "green", "blue", "alpha")):
            vertices[name] = np.asarray(colours)[:, channel]
        vertices["sigma_m"], vertices["views"] = surface.sigma_m, surface.views
    faces = np.zeros(len(mesh.faces), dtype=_FACE)
    faces["count"], faces["index"] = 3, mesh.faces
    path.write_bytes(_header(len(vertices), len(faces)) + vertices.tobytes() + faces.tobytes())


def _header(n_vertices: int, n_faces: int) -> bytes:
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment frame G, metres",
        f"element vertex {n_vertices}",
    ]
    lines += [f"property {_PLY_TYPES[_VERTEX[name].str]} {name}" for name in _VERTEX.names or ()]
    lines += [f"element face {n_faces}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode("ascii")


def read_ply(path: Path) -> SurfaceModel:
    """The surface that ``write_ply`` wrote (float32 precision). Raises InputError for anything else."""
    mesh = trimesh.load_mesh(path, process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        raise InputError(f"{path}: not a triangle mesh; give the mesh.ply of a run")
    raw = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if raw is None or not {"sigma_m", "views"} <= set(raw.dtype.names or ()):
        raise InputError(f"{path}: vertices without sigma_m and views: not a mesh of a run")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: a vertex holds NaN or infinity; run 'polhode run' again")
    return SurfaceModel(
        mesh=mesh,
        sigma_m=np.asarray(raw["sigma_m"], dtype=np.float64).reshape(-1),
        views=np.asarray(raw["views"], dtype=np.int64).reshape(-1),
    )


def write_glb(surface: SurfaceModel, path: Path) -> None:
    """Binary glTF 2.0 with vertex colours and normals, in G [m]."""
    content = surface.mesh.export(file_type="glb", include_normals=True)
    assert isinstance(content, bytes)
    path.write_bytes(content)
