"""Meshes on disk are read back by trimesh, with what each vertex knows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from polhode.files.foreign_meshes import open_mesh
from polhode.files.foreign_meshes.structure import MeshLimits
from polhode.mapping import mesh_files
from polhode.mapping.fusion.surface_extraction import empty_surface
from polhode.mapping.mesh_files import read_mesh, read_ply, write_glb, write_ply
from polhode.records.surface import SurfaceModel
from polhode.runtime.errors import InputError


@pytest.fixture
def surface() -> SurfaceModel:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    n = len(mesh.vertices)
    grey = (np.arange(n) % 256).astype(np.uint8)
    colours = np.column_stack([grey, grey, grey, np.full(n, 255, dtype=np.uint8)])
    coloured = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False)
    return SurfaceModel(coloured, sigma_m=np.linspace(1e-4, 2e-3, n), views=np.arange(n) + 1)


def partly_invented(surface: SurfaceModel) -> SurfaceModel:
    sigma_m, views, classes = surface.sigma_m.copy(), surface.views.copy(), surface.coverage_classes
    sigma_m[:5], views[:5], classes[:5] = np.inf, 0, [0, 1, 2, 0, 1]
    invented = np.asarray((np.asarray(surface.mesh.faces) < 5).any(axis=1))
    return replace(surface, sigma_m=sigma_m, views=views, invented=invented, coverage=classes)


def colours_of(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    assert isinstance(mesh.visual, ColorVisuals)
    return np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)


def test_ply_keeps_what_each_vertex_and_face_has(surface: SurfaceModel, tmp_path: Path) -> None:
    write_ply(surface, tmp_path / "mesh.ply")
    again = read_ply(tmp_path / "mesh.ply")
    np.testing.assert_allclose(again.mesh.vertices, surface.mesh.vertices, atol=1e-8)
    np.testing.assert_array_equal(again.mesh.faces, surface.mesh.faces)
    np.testing.assert_array_equal(colours_of(again.mesh), colours_of(surface.mesh))
    np.testing.assert_allclose(again.sigma_m, surface.sigma_m, rtol=1e-6)
    np.testing.assert_array_equal(again.views, surface.views)
    # ply keeps normals coverage and what was invented
    known = partly_invented(surface)
    write_ply(known, tmp_path / "mesh.ply")
    again = read_ply(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(again.is_invented, known.is_invented)
    np.testing.assert_array_equal(again.coverage_classes, known.coverage_classes)
    assert np.all(np.isinf(again.sigma_m[:5])) and np.all(again.views[:5] == 0)
    raw = again.mesh.metadata["_ply_raw"]["vertex"]["data"]
    normals = np.column_stack([raw["nx"], raw["ny"], raw["nz"]])
    np.testing.assert_allclose(normals, surface.mesh.vertices / 0.1, atol=0.02)


def test_glb_opens_with_colours_and_metres_and_what_was_invented_apart(
    surface: SurfaceModel, tmp_path: Path
) -> None:
    write_glb(surface, tmp_path / "mesh.glb")
    mesh = trimesh.load_mesh(tmp_path / "mesh.glb", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    np.testing.assert_allclose(mesh.extents, surface.mesh.extents, rtol=1e-5)
    np.testing.assert_array_equal(colours_of(mesh), colours_of(surface.mesh))
    # glb holds what was invented apart
    known = partly_invented(surface)
    write_glb(known, tmp_path / "mesh.glb")
    scene = trimesh.load_scene(tmp_path / "mesh.glb", process=False)
    assert {name: len(part.faces) for name, part in scene.geometry.items()} == {
        "surface": int(np.sum(~known.is_invented)),
        "invented": int(np.sum(known.is_invented)),
    }


def test_a_mesh_of_an_earlier_version_is_read_and_an_empty_one_written(
    surface: SurfaceModel, tmp_path: Path
) -> None:
    mesh = surface.mesh.copy()
    mesh.vertex_attributes["sigma_m"] = surface.sigma_m.astype(np.float32)
    mesh.vertex_attributes["views"] = surface.views.astype(np.int32)
    mesh.export(tmp_path / "mesh.ply")
    again = read_ply(tmp_path / "mesh.ply")
    assert again.invented is None and not again.is_invented.any()
    np.testing.assert_array_equal(again.views, surface.views)
    # an empty surface is written
    write_ply(empty_surface(), tmp_path / "mesh.ply")
    assert (tmp_path / "mesh.ply").read_bytes().startswith(b"ply\n")


def test_a_run_reads_its_own_mesh_where_one_of_others_would_be_too_large(
    surface: SurfaceModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = MeshLimits(2**26, 4000, 200)
    monkeypatch.setattr(mesh_files, "open_mesh", lambda path, limits=few: open_mesh(path, limits))
    write_ply(surface, tmp_path / "mesh.ply")
    with pytest.raises(InputError, match="320 triangles, where 200 are allowed"):
        read_mesh(tmp_path / "mesh.ply", 1.0)
    assert np.array_equal(read_ply(tmp_path / "mesh.ply").mesh.faces, surface.mesh.faces)


def test_files_that_are_no_mesh_of_a_run_are_refused_in_one_line(
    tmp_path: Path, surface: SurfaceModel
) -> None:
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "mesh.ply")
    with pytest.raises(InputError, match=r"mesh\.ply.*without sigma_m and views"):
        read_ply(tmp_path / "mesh.ply")
    # a truncated mesh is refused in one line
    write_ply(surface, tmp_path / "mesh.ply")
    whole = (tmp_path / "mesh.ply").read_bytes()
    (tmp_path / "mesh.ply").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="cannot be read"):
        read_ply(tmp_path / "mesh.ply")
