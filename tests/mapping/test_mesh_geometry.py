"""Loops over a mesh's faces against trimesh and against what is counted by hand."""

import numpy as np
import pytest
import trimesh

from polhode.lie import exp_so3, make_pose
from polhode.mapping.mesh_geometry import neighbours, piece_areas, rim_edges, volume_moments


def test_volume_moments_are_those_of_trimesh() -> None:
    mesh = trimesh.creation.box((0.12, 0.20, 0.24)).subdivide()
    mesh.apply_transform(make_pose(exp_so3([0.3, -0.5, 0.9]), [0.05, -0.02, 0.4]))
    sums = volume_moments(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert sums[0] == pytest.approx(mesh.volume, rel=1e-12)
    np.testing.assert_allclose(sums[1:4] / sums[0], mesh.center_mass, rtol=1e-12)
    second = np.zeros((3, 3))
    second[np.triu_indices(3)] = sums[4:]
    second += np.triu(second, 1).T
    inertia = np.trace(second) * np.eye(3) - second
    centre, volume = mesh.center_mass, mesh.volume
    about = mesh.moment_inertia + volume * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    np.testing.assert_allclose(inertia, about, rtol=1e-9, atol=1e-12)


def test_edges_with_one_face_are_those_around_what_is_missing() -> None:
    ball = trimesh.creation.icosphere(2)
    faces = np.asarray(ball.faces)
    assert len(rim_edges(faces, *neighbours(faces, len(ball.vertices)))) == 0
    opened = np.delete(faces, [5, 40], axis=0)
    found = rim_edges(opened, *neighbours(opened, len(ball.vertices)))
    missing = {frozenset(pair) for f in (5, 40) for pair in zip(faces[f], np.roll(faces[f], -1), strict=True)}
    assert {frozenset(pair) for pair in found.tolist()} == missing
    # a face given twice, as a flat lid may be, shares each of its edges with four
    twice = np.concatenate([faces, faces[:1]])
    assert len(rim_edges(twice, *neighbours(twice, len(ball.vertices)))) == 0


def test_pieces_have_their_own_areas() -> None:
    parts = [trimesh.creation.icosphere(2, radius) for radius in (1.0, 0.5)]
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([parts[0].faces, parts[1].faces + len(parts[0].vertices)])
    piece, area = piece_areas(vertices, faces)
    n = len(parts[0].vertices)
    assert len(set(piece[:n].tolist())) == len(set(piece[n:].tolist())) == 1
    assert area[piece[0]] == pytest.approx(parts[0].area) and area[piece[-1]] == pytest.approx(parts[1].area)
