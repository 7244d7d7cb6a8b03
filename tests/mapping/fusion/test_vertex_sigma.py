"""Sigma of a vertex: noise that landmarks scale, relief that windows smooth away, two sides of thin parts."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.mapping.fusion.field import fuse
from polhode.mapping.fusion.vertex_sigma import (
    ERROR_CORRELATION,
    NoiseScale,
    border_share,
    noise_scale,
    over_discs,
    patch_quantile,
    separate_sides,
    vertex_sigma,
)
from polhode.mapping.fusion.vertex_views import VertexViews
from polhode.records.mesh_metrics import distance_to_surface
from tests.mapping.analytic_depth import RIG, views_of

SIDE_M, STEP_M = 0.2, 0.002
NOISE_M, VIEW_M = 3e-4, 1e-3


def seen_alike(mesh: trimesh.Trimesh, shared_m: float) -> VertexViews:
    """Every vertex is faced by the same frames."""
    V = len(mesh.vertices)
    weight = np.full(V, NOISE_M**-2)
    return VertexViews(
        weight=weight,
        shared_m=np.full(V, shared_m),
        front_weight=weight,
        front_m=np.zeros(V),
        front_chi2=np.full(V, 9.0),
        front_count=np.full(V, 10.0),
        back_share=np.zeros(V),
    )


def roughness(mesh: trimesh.Trimesh, radius_m: float) -> np.ndarray:
    return over_discs(mesh, radius_m, seen_alike(mesh, 0.0))[0]


def wavy(height_m: float, wave_m: float) -> trimesh.Trimesh:
    """A square sheet with waves along x."""
    axis = np.arange(0.0, SIDE_M, STEP_M)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = height_m * np.sin(2.0 * np.pi * x / wave_m)
    n = len(axis)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + n, corner + 1], axis=1),
            np.stack([corner + 1, corner + n, corner + n + 1], axis=1),
        ]
    )
    return trimesh.Trimesh(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces, process=False)


def inner(mesh: trimesh.Trimesh) -> np.ndarray:
    """(V,) vertices away from the rim."""
    away = np.minimum(mesh.vertices, SIDE_M - mesh.vertices)[:, :2].min(axis=1)
    return np.asarray(away > 0.3 * SIDE_M)


def test_a_plane_is_smooth_and_has_the_noise_of_frames_alone_and_in_common() -> None:
    plane = wavy(0.0, 1.0)
    plane.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.5, 0.7])))
    assert roughness(plane, 0.01).max() < 1e-6
    noise, view = (np.full(len(plane.vertices), sigma) for sigma in (NOISE_M, VIEW_M))
    config = Mapping(shared_sigma=0.25, relief_sigma=1.5, border_sigma=0.0)
    for shared_m in (6e-4, np.inf):
        # where no frame is kept, what they have in common is as large as for one
        common = 0.25 * min(shared_m, VIEW_M)
        sigma, errors = vertex_sigma(
            plane, plane.vertex_normals, noise, view, seen_alike(plane, shared_m), None, 2e-3, config
        )
        stated = np.hypot(NOISE_M, common)
        scale = NoiseScale(errors.scale, stated, 0).at(stated)
        np.testing.assert_allclose(sigma, scale * stated, rtol=1e-4)
        assert errors.landmarks == 0
    # shares of correlated errors add up and have lengths in voxels
    plane = wavy(0.0, 1.0)
    noise = np.full(len(plane.vertices), NOISE_M)
    _, errors = vertex_sigma(
        plane, plane.vertex_normals, noise, noise, seen_alike(plane, 1e-4), None, 2e-3, Mapping()
    )
    assert sum(each.share for each in errors.correlation) == pytest.approx(1.0)
    assert [each.length_m for each in errors.correlation] == [
        length * 2e-3 for _, length in ERROR_CORRELATION
    ]


def test_landmarks_scale_the_noise_by_their_median_distance() -> None:
    plane, rng = wavy(0.0, 1.0), np.random.default_rng(0)
    stated, views = np.full(len(plane.vertices), NOISE_M), seen_alike(plane, 0.0)
    plate = np.asarray(plane.vertices), np.asarray(plane.vertex_normals)
    usual = noise_scale(*plate, stated, views, None, STEP_M)
    assert usual.count == 0
    for actual in (0.4, 1.5):
        landmarks = np.array(plane.vertices)[rng.choice(len(plane.vertices), 5000)]
        landmarks[:, 2] += rng.normal(0.0, actual * NOISE_M, len(landmarks))
        found = noise_scale(*plate, stated, views, landmarks, STEP_M)
        assert found.count == 5000 and found.scale == pytest.approx(0.6 * actual, rel=0.06)
        few = noise_scale(*plate, stated, views, landmarks[:20], STEP_M)
        assert few.scale == pytest.approx(usual.scale, rel=0.1)
    # far landmarks, and those of parts that frames see from both sides, show nothing
    assert noise_scale(*plate, stated, views, landmarks + np.array([0.0, 0.0, 0.05]), STEP_M) == usual
    both = replace(views, back_share=np.full(len(stated), 0.3))
    assert noise_scale(*plate, stated, both, landmarks, STEP_M) == usual
    # landmarks show nothing where depth is much worse than at them
    stated = NOISE_M * np.array([0.1, 1.0, 3.0, 10.0, 100.0])
    for scale in (0.4, 1.2):
        at = NoiseScale(scale, NOISE_M, 500).at(stated)
        assert at[0] == pytest.approx(scale, rel=0.01)
        assert (np.diff(at) > 0.0).all()
    far = [NoiseScale(scale, NOISE_M, 500).at(stated)[-1] for scale in (0.4, 1.2)]
    assert far[0] == pytest.approx(far[1], rel=0.01)


def test_noise_is_larger_where_frames_disagree_by_more_than_elsewhere() -> None:
    plane = wavy(0.0, 1.0)
    there = np.linalg.norm(np.asarray(plane.vertices)[:, :2] - 0.5 * SIDE_M, axis=1) < 0.03
    views = replace(seen_alike(plane, 0.0), front_chi2=np.where(there, 36.0, 9.0))
    ratio = over_discs(plane, 0.01, views)[1]
    assert ratio[inner(plane)].max() == pytest.approx(2.0, rel=0.05)
    assert np.median(ratio) == pytest.approx(1.0)
    # one frame alone disagrees with nothing
    alone = replace(views, front_chi2=np.zeros(len(there)), front_count=np.ones(len(there)))
    np.testing.assert_array_equal(over_discs(plane, 0.01, alone)[1], 1.0)


def test_sigma_is_larger_at_the_border_and_a_closed_surface_has_none() -> None:
    plane = wavy(0.0, 1.0)
    share, edge = border_share(plane, STEP_M), np.asarray(plane.vertices)[:, 0] == 0.0
    np.testing.assert_allclose(share[edge], 1.0)
    assert share[inner(plane)].max() == 0.0
    assert border_share(trimesh.creation.icosphere(), STEP_M).max() == 0.0
    noise = np.full(len(plane.vertices), NOISE_M)
    views = seen_alike(plane, 1e-4)
    sigma = [
        vertex_sigma(
            plane, plane.vertex_normals, noise, noise, views, None, STEP_M, Mapping(border_sigma=border)
        )[0]
        for border in (0.0, 0.5)
    ]
    np.testing.assert_allclose(sigma[1][edge] ** 2 - sigma[0][edge] ** 2, (0.5 * STEP_M) ** 2)
    np.testing.assert_allclose(sigma[1][inner(plane)], sigma[0][inner(plane)])


def test_waves_are_rough_where_they_are_shorter_than_the_disc() -> None:
    mesh = wavy(4e-4, 0.012)
    rough = roughness(mesh, 0.02)[inner(mesh)]
    np.testing.assert_allclose(np.sqrt(np.mean(rough**2)), 4e-4 / np.sqrt(2.0), rtol=0.1)
    # waves longer than the disc count less
    mesh = wavy(4e-4, 0.15)
    assert roughness(mesh, 0.01)[inner(mesh)].max() < 0.2 * 4e-4
    # a mesh without faces has no roughness
    empty = trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64), process=False)
    np.testing.assert_array_equal(roughness(empty, 0.01), 0.0)
    # edges of a smooth body are no relief and waves all over are
    values = np.zeros(len(wavy(0.0, 1.0).vertices))
    values[::5] = 1.0
    assert patch_quantile(wavy(0.0, 1.0), values, STEP_M).max() == 0.0
    assert np.median(patch_quantile(wavy(0.0, 1.0), 1.0 - values, STEP_M)) == 1.0


def test_vertices_seen_from_behind_are_moved_to_what_frames_in_front_of_them_say() -> None:
    plane = wavy(0.0, 1.0)
    V = len(plane.vertices)
    front_m, back = np.full(V, 2e-4), np.repeat([0.0, 0.5], [V // 2, V - V // 2])
    views = replace(
        seen_alike(plane, 0.0),
        weight=np.full(V, 2e6),
        front_weight=np.full(V, 1e6),
        front_m=front_m,
        back_share=back,
    )
    mesh, noise = separate_sides(plane, np.full(V, NOISE_M), views)
    down = (plane.vertices - mesh.vertices)[:, 2] * np.sign(plane.vertex_normals[:, 2])
    np.testing.assert_allclose(down, np.where(back > 0.0, 2e-4, 0.0), atol=1e-12)
    np.testing.assert_allclose(noise, np.where(back > 0.0, 1e-3, NOISE_M))
    untouched = replace(views, back_share=np.zeros(V))
    assert separate_sides(plane, noise, untouched)[0] is plane


def test_both_sides_of_a_thin_panel_lie_where_they_are() -> None:
    panel = trimesh.creation.box((0.12, 0.10, 0.006))
    panel.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.6, 0.4])))
    config = Mapping(voxel_mm=3.0)
    found = fuse(views_of(panel, 30, sigma_m=1e-3), RIG, config)
    off = distance_to_surface(panel, np.asarray(found.mesh.vertices))
    # averaged with each other they are 0.9 mm off
    assert np.median(off) < 3e-4
