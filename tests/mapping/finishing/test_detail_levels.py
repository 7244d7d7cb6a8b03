"""Lighter meshes stay near the full one, and say how near."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.visual import ColorVisuals

from polhode.mapping.finishing.detail_levels import levels_of
from polhode.mapping.mesh_files import read_ply, write_glb, write_ply
from polhode.records.surface import SurfaceModel

RADIUS_M = 0.1


def colours_of(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    assert isinstance(mesh.visual, ColorVisuals)
    return np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)


@pytest.fixture(scope="module")
def surface() -> SurfaceModel:
    ball = trimesh.creation.icosphere(5, RADIUS_M)
    n = len(ball.vertices)
    grey = np.round(127.0 + 1000.0 * ball.vertices[:, 2]).astype(np.uint8)
    rgba = np.column_stack([grey, grey, grey, np.full(n, 255, dtype=np.uint8)])
    mesh = trimesh.Trimesh(ball.vertices, ball.faces, vertex_colors=rgba, process=False)
    invented = mesh.triangles_center[:, 2] > 0.09
    sigma_m = np.where(ball.vertices[:, 2] > 0.092, np.inf, 1e-3)
    return SurfaceModel(mesh, sigma_m, np.full(n, 5, dtype=np.int64), invented)


def test_a_sphere_keeps_its_shape_with_fewer_faces(surface: SurfaceModel, tmp_path: Path) -> None:
    levels = levels_of(surface, (0.25, 0.0625))
    assert [len(level.surface.mesh.faces) for level in levels] == [5120, 1280]
    for level in levels:
        mesh = level.surface.mesh
        # a chord of a sphere is off by its edge squared over eight radii
        sagitta_m = float(np.max(mesh.edges_unique_length)) ** 2 / (8.0 * RADIUS_M)
        assert 0.0 < level.mean_m < level.largest_m < 3.0 * sagitta_m
        assert mesh.is_volume and mesh.volume == pytest.approx(surface.mesh.volume, rel=0.01)
    assert levels[0].mean_m < levels[1].mean_m
    # colours sigma and invention come along
    light = levels_of(surface, (0.25,))[0].surface
    z = light.mesh.vertices[:, 2]
    grey = colours_of(light.mesh)[:, 0].astype(float)
    assert np.abs(grey - (127.0 + 1000.0 * z)).max() < 6.0
    assert np.all(np.isinf(light.sigma_m[z > 0.096])) and np.all(np.isfinite(light.sigma_m[z < 0.088]))
    middle = light.mesh.triangles_center[:, 2]
    assert np.all(light.is_invented[middle > 0.094]) and not np.any(light.is_invented[middle < 0.086])
    # a level that would be too light is left out
    assert len(levels_of(surface, (0.5, 0.001))) == 1
    assert levels_of(surface, ()) == []
    # the same mesh gives the same bytes
    for name in ("a", "b"):
        write_glb(levels_of(surface, (0.25,))[0].surface, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_mesh_read_from_its_file_has_the_same_levels(surface: SurfaceModel, tmp_path: Path) -> None:
    noise = np.random.default_rng(4).normal(scale=1e-4, size=surface.mesh.vertices.shape)
    rough = surface.mesh.copy()
    rough.vertices = rough.vertices + noise
    whole = SurfaceModel(rough, surface.sigma_m, surface.views, surface.invented)
    write_ply(whole, tmp_path / "mesh.ply")
    for ours, theirs in zip(
        levels_of(whole, (0.25, 0.0625)),
        levels_of(read_ply(tmp_path / "mesh.ply"), (0.25, 0.0625)),
        strict=True,
    ):
        np.testing.assert_array_equal(ours.surface.mesh.vertices, theirs.surface.mesh.vertices)
        np.testing.assert_array_equal(ours.surface.mesh.faces, theirs.surface.mesh.faces)
