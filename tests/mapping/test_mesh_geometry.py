"""Boundaries and pieces of a mesh against what is counted by hand; mass properties in any place."""

import numpy as np
import pytest
import trimesh

from polhode.geometry.lie import exp_so3, make_pose
from polhode.mapping.mesh_geometry import border_vertices, boundary_edges, piece_areas
from polhode.mapping.uniform_solid import solid_body


def test_a_solid_has_the_mass_properties_of_its_mesh_also_when_wound_inwards() -> None:
    mesh = trimesh.creation.box((0.12, 0.20, 0.24)).subdivide()
    mesh.apply_transform(make_pose(exp_so3([0.3, -0.5, 0.9]), [0.05, -0.02, 0.4]))
    for wound in (mesh, trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)):
        solid = solid_body(wound, "")
        assert solid.volume_m3 == pytest.approx(mesh.volume, rel=1e-12)
        np.testing.assert_allclose(solid.com_G, mesh.center_mass, rtol=1e-12)
        np.testing.assert_allclose(solid.inertia, mesh.moment_inertia, rtol=1e-9, atol=1e-12)


def test_edges_with_one_face_are_those_around_what_is_missing() -> None:
    ball = trimesh.creation.icosphere(2)
    faces = np.asarray(ball.faces)
    assert len(boundary_edges(faces)) == 0
    opened = np.delete(faces, [5, 40], axis=0)
    found = boundary_edges(opened)
    missing = {frozenset(pair) for f in (5, 40) for pair in zip(faces[f], np.roll(faces[f], -1), strict=True)}
    assert {frozenset(pair) for pair in found.tolist()} == missing
    assert set(border_vertices(opened, len(ball.vertices)).tolist()) == frozenset().union(*missing)
    assert len(border_vertices(faces, len(ball.vertices))) == 0
    assert len(border_vertices(faces[:0], 0)) == 0
    # a face given twice, as a flat lid may be, shares each of its edges with four
    twice = np.concatenate([faces, faces[:1]])
    assert len(boundary_edges(twice)) == 0


def test_pieces_have_their_own_areas() -> None:
    parts = [trimesh.creation.icosphere(2, radius) for radius in (1.0, 0.5)]
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([parts[0].faces, parts[1].faces + len(parts[0].vertices)])
    piece, area = piece_areas(vertices, faces)
    n = len(parts[0].vertices)
    assert len(set(piece[:n].tolist())) == len(set(piece[n:].tolist())) == 1
    assert area[piece[0]] == pytest.approx(parts[0].area) and area[piece[-1]] == pytest.approx(parts[1].area)
