"""Sigma of a vertex: what is smooth keeps its noise, what is rough is less sure."""

import numpy as np
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.mapping.fusion.surface_extraction import roughness, vertex_sigma

SIDE_M, STEP_M = 0.2, 0.002


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


def test_a_plane_is_smooth_and_keeps_noise_and_the_share_of_one_view() -> None:
    plane = wavy(0.0, 1.0)
    plane.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.5, 0.7])))
    assert roughness(plane, 0.01).max() < 1e-6
    noise, view = (np.full(len(plane.vertices), sigma) for sigma in (3e-4, 1e-3))
    sigma = vertex_sigma(plane, noise, view, 2e-3, Mapping(shared_sigma=0.25, relief_sigma=1.5))
    np.testing.assert_allclose(sigma, np.hypot(3e-4, 0.25 * 1e-3), rtol=1e-4)


def test_waves_shorter_than_the_disc_have_the_root_mean_square_of_a_sine() -> None:
    mesh = wavy(4e-4, 0.012)
    rough = roughness(mesh, 0.02)[inner(mesh)]
    np.testing.assert_allclose(np.sqrt(np.mean(rough**2)), 4e-4 / np.sqrt(2.0), rtol=0.1)


def test_waves_longer_than_the_disc_count_less() -> None:
    mesh = wavy(4e-4, 0.15)
    assert roughness(mesh, 0.01)[inner(mesh)].max() < 0.2 * 4e-4


def test_a_mesh_without_faces_has_no_roughness() -> None:
    empty = trimesh.Trimesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64), process=False)
    np.testing.assert_array_equal(roughness(empty, 0.01), 0.0)
