"""Distances between surfaces against closed forms."""

import numpy as np
import pytest
import trimesh

from polhode.records.mesh_metrics import compare_surfaces, distance_to_surface, encloses, sample_surface


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    return mesh


def test_a_surface_is_within_a_micrometre_of_itself(sphere: trimesh.Trimesh) -> None:
    metrics = compare_surfaces(sphere, sphere, sample_surface(sphere, 2000)[0])
    assert metrics.chamfer_mm < 1e-3
    assert metrics.completeness_3mm == 1.0


def test_concentric_spheres_are_apart_by_the_difference_of_their_radii(sphere: trimesh.Trimesh) -> None:
    larger = trimesh.creation.icosphere(subdivisions=5, radius=0.102)
    metrics = compare_surfaces(larger, sphere, sample_surface(sphere, 5000)[0])
    for value in (metrics.accuracy_mm, metrics.completion_mm, metrics.chamfer_mm, metrics.hausdorff95_mm):
        assert value == pytest.approx(2.0, abs=0.05)


def test_a_shifted_sphere_is_off_by_half_the_shift_on_average(sphere: trimesh.Trimesh) -> None:
    # |s cos(angle)| over the sphere has the mean s / 2 and the 95th percentile 0.95 s, s the shift.
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


def test_distance_to_large_triangles_is_exact() -> None:
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    points = np.array([[0.05, 0.03, 0.13], [0.13, 0.14, 0.1], [0.0, 0.0, 0.095]])
    expected = [0.03, 0.05, 0.005]
    np.testing.assert_allclose(distance_to_surface(box, points), expected, atol=1e-9)


def test_a_point_is_inside_also_of_a_mesh_with_a_hole(sphere: trimesh.Trimesh) -> None:
    capped = sphere.copy()
    capped.update_faces(capped.triangles_center[:, 2] < 0.08)
    assert not capped.is_watertight
    turned = trimesh.Trimesh(sphere.vertices, sphere.faces[:, ::-1], process=False)
    for mesh in (sphere, capped, turned):
        for p in ([0.0, 0.0, 0.0], [0.0, 0.09, 0.0], [0.05, -0.03, 0.04]):
            assert encloses(mesh, np.array(p))
        for p in ([0.0, 0.0, 0.11], [0.0, 0.11, 0.0], [1.0, 0.0, 0.0]):
            assert not encloses(mesh, np.array(p))
