"""Meshes on disk: PLY with what each vertex and face knows, GLB for viewers. Same mesh, same bytes."""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from polhode.errors import InputError
from polhode.records import SurfaceModel

_VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("nx", "<f4"),
        ("ny", "<f4"),
        ("nz", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("alpha", "u1"),
        ("sigma_m", "<f4"),
        ("views", "<i4"),
        ("coverage", "u1"),
    ]
)
_FACE = np.dtype([("count", "u1"), ("index", "<i4", (3,)), ("invented", "u1")])
_PLY_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def write_ply(surface: SurfaceModel, path: Path) -> None:
    """Binary PLY: x y z [m in G], normal, colour, sigma_m [m], views, coverage; triangles, ``invented``."""
    mesh = surface.mesh
    vertices = np.zeros(len(mesh.vertices), dtype=_VERTEX)
    if len(vertices):
        for axis, name in enumerate("xyz"):
            vertices[name] = mesh.vertices[:, axis]
            vertices[f"n{name}"] = mesh.vertex_normals[:, axis]
        for channel, name in enumerate(("red", "green", "blue", "alpha")):
            vertices[name] = _colours(mesh)[:, channel]
        vertices["sigma_m"], vertices["views"] = surface.sigma_m, surface.views
        vertices["coverage"] = surface.coverage_classes
    faces = np.zeros(len(mesh.faces), dtype=_FACE)
    faces["count"], faces["index"], faces["invented"] = 3, mesh.faces, surface.is_invented
    path.write_bytes(_header(len(vertices), len(faces)) + vertices.tobytes() + faces.tobytes())


def _colours(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    """(V, 4)"""
    colours = mesh.visual.vertex_colors if isinstance(mesh.visual, ColorVisuals) else np.full((1, 4), 128)
    return np.broadcast_to(np.asarray(colours, dtype=np.uint8), (len(mesh.vertices), 4))


def _header(n_vertices: int, n_faces: int) -> bytes:
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment frame G, metres",
        "comment sigma_m inf, views 0: not measured; coverage 0 unseen, 1 seen but never lit, 2 seen lit",
        "comment invented 1: the face closes a small hole",
        f"element vertex {n_vertices}",
    ]
    lines += [f"property {_PLY_TYPES[_VERTEX[name].str]} {name}" for name in _VERTEX.names or ()]
    lines += [f"element face {n_faces}", "property list uchar int vertex_indices", "property uchar invented"]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def read_ply(path: Path) -> SurfaceModel:
    """The surface that ``write_ply`` wrote (float32 precision), of this or an earlier version.

    Raises InputError for anything else.
    """
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except (ValueError, IndexError, KeyError) as error:
        raise InputError(f"{path}: cannot be read ({error}); run it again") from error
    if not isinstance(mesh, trimesh.Trimesh):
        raise InputError(f"{path}: not a triangle mesh; give the mesh.ply of a run")
    raw = mesh.metadata.get("_ply_raw", {})
    vertex, face = (raw.get(element, {}).get("data") for element in ("vertex", "face"))
    if vertex is None or not {"sigma_m", "views"} <= set(vertex.dtype.names or ()):
        raise InputError(f"{path}: vertices without sigma_m and views: not a mesh of a run")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: a vertex holds NaN or infinity; run 'polhode run' again")
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
    path.write_bytes(content)


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
