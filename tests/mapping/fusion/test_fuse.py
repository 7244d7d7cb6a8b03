"""The fused surface against analytic solids."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.mapping.fusion.field import choose_voxel_m, fuse
from polhode.mapping.mesh_files import write_glb, write_ply
from polhode.records.mesh_metrics import distance_to_surface, sample_surface
from polhode.records.surface import SurfaceModel
from tests.mapping.analytic_depth import RIG, views_of

VOXEL_M = 3e-3
# depth made here has independent noise, and no window has smoothed it
CONFIG = Mapping(voxel_mm=VOXEL_M * 1e3, shared_sigma=0.0, relief_sigma=0.0, border_sigma=0.0)


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=0.08)
    return mesh


@pytest.fixture(scope="module")
def fused_sphere(sphere: trimesh.Trimesh) -> SurfaceModel:
    return fuse(views_of(sphere, 30, sigma_m=2e-3), RIG, CONFIG)


def test_a_noisy_sphere_is_found_to_a_third_of_a_voxel(
    sphere: trimesh.Trimesh, fused_sphere: SurfaceModel
) -> None:
    there = distance_to_surface(sphere, np.asarray(fused_sphere.mesh.vertices))
    back = distance_to_surface(fused_sphere.mesh, sample_surface(sphere, 3000)[0])
    assert there.mean() < VOXEL_M / 3
    assert back.mean() < VOXEL_M / 3
    assert np.percentile(back, 99) < VOXEL_M
    # the surface is wound outwards
    assert fused_sphere.mesh.volume == pytest.approx(sphere.volume, rel=0.03)
    # sigma bounds the error
    assert 0.5 < np.mean(there < fused_sphere.sigma_m) < 0.95
    # The sphere spans several chunks of 64 voxels; a seam would leave open edges by the hundred.
    mesh = fused_sphere.mesh
    edges, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    assert np.mean(count == 1) < 0.01
    assert len(edges) > 10_000


def test_views_are_counted_and_sigma_falls_with_them(
    sphere: trimesh.Trimesh, fused_sphere: SurfaceModel
) -> None:
    few = fuse(views_of(sphere, 8, sigma_m=2e-3), RIG, CONFIG)
    assert 2.5 < np.median(fused_sphere.views) / np.median(few.views) < 6.0
    assert fused_sphere.views.max() <= 30
    assert 1.4 < np.median(few.sigma_m) / np.median(fused_sphere.sigma_m) < 2.8


def test_a_wrong_surface_in_a_few_frames_is_carved_away(sphere: trimesh.Trimesh) -> None:
    frames = views_of(sphere, 30, sigma_m=1e-3)
    for k in (3, 7, 11, 15):
        depth, X_RG = frames[k]
        wrong = depth.depth_m.copy()
        wrong[50:70, 70:90] -= 0.05
        frames[k] = (replace(depth, depth_m=wrong), X_RG)
    surface = fuse(frames, RIG, CONFIG)
    error = distance_to_surface(sphere, np.asarray(surface.mesh.vertices))
    assert error.max() < 3 * VOXEL_M


def test_the_same_input_gives_the_same_files(sphere: trimesh.Trimesh, tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        surface = fuse(views_of(sphere, 6, sigma_m=2e-3), RIG, CONFIG)
        write_ply(surface, tmp_path / f"{name}.ply")
        write_glb(surface, tmp_path / f"{name}.glb")
        contents.append([(tmp_path / f"{name}.{kind}").read_bytes() for kind in ("ply", "glb")])
    assert contents[0] == contents[1]


def test_what_is_not_seen_is_left_out(sphere: trimesh.Trimesh) -> None:
    depth, X_RG = views_of(sphere, 1, sigma_m=1e-3)[0]
    blind = replace(depth, depth_m=np.full_like(depth.depth_m, np.nan))
    for frames in ([], [(blind, X_RG)] * 3):
        surface = fuse(frames, RIG, CONFIG)
        assert len(surface.mesh.faces) == len(surface.sigma_m) == len(surface.views) == 0
    # a pose with nan is left out
    frames = views_of(sphere, 8, sigma_m=1e-3)
    broken = [*frames, (frames[0][0], np.full((4, 4), np.nan))]
    with_it, without = fuse(broken, RIG, CONFIG), fuse(frames, RIG, CONFIG)
    np.testing.assert_array_equal(with_it.mesh.vertices, without.mesh.vertices)
    # one frame gives the side that was seen
    frames = views_of(sphere, 1, sigma_m=5e-4)
    surface = fuse(frames, RIG, CONFIG)
    towards_camera = np.asarray(surface.mesh.vertices) @ frames[0][1][2, :3]
    assert len(surface.mesh.faces) > 500
    assert towards_camera.max() < 0.01


def test_the_voxel_follows_the_scale_and_the_memory(sphere: trimesh.Trimesh) -> None:
    depth, _ = views_of(sphere, 1, sigma_m=1e-3)[0]
    auto = Mapping()
    near = choose_voxel_m([depth], RIG, auto)
    far = choose_voxel_m([replace(depth, depth_m=depth.depth_m * 50)], RIG, auto)
    assert far == pytest.approx(50 * near, rel=1e-5)
    assert choose_voxel_m([depth], RIG, Mapping(memory_mib=1.0)) > near
