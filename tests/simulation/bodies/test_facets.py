"""Which faces lie in one plane."""

import numpy as np
import trimesh

from polhode.simulation.bodies.solids import box, flat_facets, flat_regions, revolve


def test_a_box_has_six_sides_whatever_its_size() -> None:
    for scale in (0.01, 1.0, 300.0):
        mesh = trimesh.creation.box().subdivide()
        mesh.apply_scale(scale)
        assert len(flat_facets(mesh)) == 6
        regions = flat_regions(mesh, 0.5 * scale**2)
        assert sorted(len(faces) for faces in regions) == [8] * 6
        assert flat_regions(mesh, 1.5 * scale**2) == []


def test_bevels_part_the_sides_of_a_box() -> None:
    assert len(flat_regions(box([1, 1, 1], bevel=0.05), 0.1)) == 6


def test_the_largest_side_comes_first() -> None:
    regions = flat_regions(trimesh.creation.box([1, 2, 3]), 1.0)
    mesh = trimesh.creation.box([1, 2, 3])
    np.testing.assert_allclose([mesh.area_faces[faces].sum() for faces in regions], [6, 6, 3, 3, 2, 2])


def test_curved_walls_have_no_sides_but_their_ends_have() -> None:
    wall = revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 32).mesh
    assert len(flat_regions(wall, 0.05)) == 2
    assert flat_regions(trimesh.creation.icosphere(subdivisions=4), 1e-4) == []
    assert flat_regions(trimesh.creation.icosphere(subdivisions=2), 1e-4) == []


def test_a_hexagonal_tower_has_sides() -> None:
    assert len(flat_regions(revolve([(0, 0), (1.0, 0), (1.0, 3.0), (0, 3.0)], 6).mesh, 0.05)) == 8


def test_an_open_sheet_is_one_side() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert [len(faces) for faces in flat_regions(sheet, 0.5)] == [2]
