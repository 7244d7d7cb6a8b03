"""Distances between surfaces against closed forms."""

import numpy as np
import pytest
import trimesh

from polhode.records.mesh_metrics import closest_on_surface, compare_surfaces, encloses, sample_surface


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    return mesh


def test_spheres_are_apart_by_what_they_differ(sphere: trimesh.Trimesh) -> None:
    points = sample_surface(sphere, 5000)[0]
    same = compare_surfaces(sphere, sphere, points)
    assert same.chamfer_mm < 1e-3 and same.completeness_3mm == 1.0
    larger = trimesh.creation.icosphere(subdivisions=5, radius=0.102)
    metrics = compare_surfaces(larger, sphere, points)
    for value in (metrics.accuracy_mm, metrics.completion_mm, metrics.chamfer_mm, metrics.hausdorff95_mm):
        assert value == pytest.approx(2.0, abs=0.05)
    # |s cos(angle)| over the sphere has the mean s / 2 and the 95th percentile 0.95 s, s the shift
    shifted = sphere.copy()
    shifted.apply_translation([0.0, 0.0, 0.004])
    metrics = compare_surfaces(shifted, sphere, sample_surface(sphere, 20_000)[0])
    assert metrics.chamfer_mm == pytest.approx(2.0, abs=0.06)
    assert metrics.hausdorff95_mm == pytest.approx(3.8, abs=0.06)
    assert metrics.completeness_3mm == pytest.approx(0.75, abs=0.02)


def test_half_a_sphere_is_accurate_but_not_complete(sphere: trimesh.Trimesh) -> None:
    half = trimesh.Trimesh(sphere.vertices, sphere.faces[sphere.triangles_center[:, 2] > 0], process=False)
    metrics = compare_surfaces(half, sphere, sample_surface(sphere, 5000)[0])
    assert metrics.accuracy_mm < 0.01
    assert metrics.completion_mm > 10.0
    assert metrics.completeness_3mm == pytest.approx(0.5, abs=0.03)


def test_the_closest_point_lies_on_the_surface_at_the_exact_distance(sphere: trimesh.Trimesh) -> None:
    points = np.array([[0.05, 0.03, 0.13], [0.13, 0.14, 0.1], [0.0, 0.0, 0.095]])
    distance = closest_on_surface(trimesh.creation.box((0.2, 0.2, 0.2)), points)[1]
    np.testing.assert_allclose(distance, [0.03, 0.05, 0.005], atol=1e-9)
    points = np.random.default_rng(0).normal(size=(200, 3)) * 0.2
    closest, distance = closest_on_surface(sphere, points)
    np.testing.assert_allclose(np.linalg.norm(closest, axis=1), 0.1, atol=4e-4)
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), distance)


def test_a_point_is_inside_also_of_a_mesh_with_a_hole(sphere: trimesh.Trimesh) -> None:
    capped = sphere.copy()
    capped.update_faces(capped.triangles_center[:, 2] < 0.08)
    assert not capped.is_watertight
    turned = trimesh.Trimesh(sphere.vertices, sphere.faces[:, ::-1], process=False)
    for mesh in (sphere, capped, turned):
        assert all(encloses(mesh, np.array(p)) for p in ([0, 0, 0], [0, 0.09, 0], [0.05, -0.03, 0.04]))
        assert not any(encloses(mesh, np.array(p)) for p in ([0, 0, 0.11], [0, 0.11, 0], [1.0, 0, 0]))
