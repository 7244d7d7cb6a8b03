"""Solids against closed forms; which faces lie in one plane."""

import numpy as np
import pytest
import trimesh

from polhode.simulation.bodies.solids import (
    ball,
    box,
    drum,
    ellipsoid_cap,
    flat_facets,
    flat_regions,
    frame,
    pose,
    prism,
    revolve,
    strut,
    tube,
)


def test_all_solids_are_closed_and_wound_outwards() -> None:
    bent = tube(np.array([[0, 0, 0], [0, 0, 1.0], [0.5, 0, 1.5], [0.5, 1.0, 1.5]]), 0.1)
    ring = revolve([(1.0, 0.0), (1.2, 0.0), (1.2, 0.1), (1.0, 0.1)], 24, closed=True).mesh
    for solid in (
        box([1, 2, 3]),
        drum(1.0, 2.0),
        ball(1.0),
        prism([(0, 0), (1, 0), (0, 1)], 2.0, 0.5),
        bent,
        ring,
    ):
        assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0
    assert revolve([(0, 1.0), (1.0, 1.0), (1.0, 0.0), (0, 0)], 12).mesh.volume > 0


def test_volumes_are_those_of_the_closed_forms() -> None:
    n = 40
    polygon = 0.5 * n * np.sin(2 * np.pi / n)
    assert revolve([(0, 0), (0.3, 0), (0.3, 0.5), (0, 0.5)], n).mesh.volume == pytest.approx(
        polygon * 0.3**2 * 0.5
    )
    ring = revolve([(1.0, 0), (1.2, 0), (1.2, 0.1), (1.0, 0.1)], n, closed=True).mesh
    assert ring.volume == pytest.approx(polygon * (1.2**2 - 1.0) * 0.1)
    assert strut([0, 0, 0], [1.0, 2.0, 2.0], 0.05, n).volume == pytest.approx(polygon * 0.05**2 * 3.0)
    assert ball(1.0, 80, 40).volume == pytest.approx(4 / 3 * np.pi, rel=0.01)
    assert prism([(0, 0), (1, 0), (1, 1), (0, 1)], 3.0).volume == pytest.approx(3.0)


def test_a_bevelled_box_keeps_its_extents_and_loses_its_edges() -> None:
    for extents in ([0.3, 0.2, 0.1], [1.0, 1.0, 0.01]):
        solid = box(extents, bevel=0.1)
        np.testing.assert_allclose(solid.extents, extents)
        assert 0.8 * np.prod(extents) < solid.volume < np.prod(extents)
        slanted = np.abs(solid.face_normals).max(axis=1) < 0.9
        assert 0 < solid.area_faces[slanted].sum() < 0.5 * solid.area


def test_panels_of_a_revolved_solid_are_flat_and_a_cap_runs_from_the_axis_to_the_rim() -> None:
    solid = revolve([(0, 0), (1.0, 0.2), (0.6, 0.8), (0, 1.0)], 16)
    assert (solid.panels[[0, 2]] >= 0).sum() == 2 * 16 and (solid.panels[1] >= 0).all()
    normals = solid.mesh.face_normals[solid.panels[1]]
    np.testing.assert_allclose(normals[:, 0], normals[:, 1], atol=1e-12)
    cap = ellipsoid_cap(2.0, 0.5)
    np.testing.assert_allclose(cap[[0, -1]], [[0, 0.5], [2.0, 0]], atol=1e-12)
    np.testing.assert_allclose((cap[:, 0] / 2.0) ** 2 + (cap[:, 1] / 0.5) ** 2, 1.0)


@pytest.mark.parametrize("direction", [[0, 0, 1.0], [0, 0, -2.0], [1.0, 0, 0], [-1, 2, 3]])
def test_poses_are_rigid_and_turn_z_to_the_direction(direction: list[float]) -> None:
    X = pose(direction, [1, 2, 3], 0.7)
    np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(X[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(X[:3, 2], np.array(direction) / np.linalg.norm(direction))
    np.testing.assert_allclose(X[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(frame(X[:3, 0], X[:3, 2], [1, 2, 3]), X, atol=1e-12)


def test_flat_sides_are_those_of_boxes_and_towers_and_ends_of_curved_walls() -> None:
    for scale in (0.01, 1.0, 300.0):
        mesh = trimesh.creation.box().subdivide()
        mesh.apply_scale(scale)
        assert len(flat_facets(mesh)) == 6
        regions = flat_regions(mesh, 0.5 * scale**2)
        assert sorted(len(faces) for faces in regions) == [8] * 6
        assert flat_regions(mesh, 1.5 * scale**2) == []
    assert len(flat_regions(box([1, 1, 1], bevel=0.05), 0.1)) == 6
    regions = flat_regions(trimesh.creation.box([1, 2, 3]), 1.0)
    mesh = trimesh.creation.box([1, 2, 3])
    np.testing.assert_allclose([mesh.area_faces[faces].sum() for faces in regions], [6, 6, 3, 3, 2, 2])
    wall = revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 32).mesh
    assert len(flat_regions(wall, 0.05)) == 2
    assert flat_regions(trimesh.creation.icosphere(subdivisions=4), 1e-4) == []
    assert flat_regions(trimesh.creation.icosphere(subdivisions=2), 1e-4) == []
    assert len(flat_regions(revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 6).mesh, 0.05)) == 8


def test_an_open_sheet_is_one_side() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert [len(faces) for faces in flat_regions(sheet, 0.5)] == [2]
