"""Lengths of the free flyer, measured on meshes whose lengths are known."""

import numpy as np
import pytest
import trimesh

from benchmarks.mapping.lengths import LENGTHS, measure
from polhode.errors import InputError
from polhode.simulation.bodies.families.free_flyer import free_flyer_parts
from polhode.simulation.bodies.textures.part_builder import PartBuilder, texture_generator


@pytest.fixture(scope="module")
def flyer() -> trimesh.Trimesh:
    rng = np.random.default_rng(0)
    parts = free_flyer_parts(0.22, PartBuilder(texture_generator("drawn"), rng, rng, 5e-3))
    start = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    faces = [np.asarray(part.mesh.faces) + at for part, at in zip(parts, start[:-1], strict=True)]
    vertices = [np.asarray(part.mesh.vertices) for part in parts]
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def test_the_true_mesh_has_the_true_lengths(flyer: trimesh.Trimesh) -> None:
    rows = measure(flyer, flyer)
    assert [row.name for row in rows] == [length.name for length in LENGTHS]
    for row in rows:
        assert row.found_mm == pytest.approx(row.true_mm, abs=1e-3)


def test_a_larger_and_noisy_mesh_has_larger_lengths(flyer: trimesh.Trimesh) -> None:
    vertices, faces = trimesh.remesh.subdivide_to_size(flyer.vertices, flyer.faces, 4e-3)
    noise = np.random.default_rng(0).normal(0.0, 1e-4, vertices.shape)
    noisy = trimesh.Trimesh(1.004 * vertices + noise, faces, process=False)
    for row in measure(noisy, flyer):
        assert row.found_mm == pytest.approx(1.004 * row.true_mm, abs=0.1)


def test_what_is_not_in_the_mesh_is_not_measured(flyer: trimesh.Trimesh) -> None:
    there = np.asarray(flyer.triangles_center)[:, 0] > 0.0
    half = trimesh.Trimesh(flyer.vertices, np.asarray(flyer.faces)[there], process=False)
    rows = {row.name: row for row in measure(half, flyer)}
    assert rows["shell across x"].found_mm is None
    assert rows["shell across z"].found_mm == pytest.approx(220.0, abs=1e-3)


def test_another_body_is_refused() -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    with pytest.raises(InputError, match="no such face"):
        measure(box, box)
