"""Mass properties of meshes that are closed, open, flat or inside out."""

import warnings

import numpy as np
import pytest
import trimesh

from polhode.simulation.bodies.part import SHEET_THICKNESS, PartMass, join, masses_by_name


def _one(mesh: trimesh.Trimesh) -> PartMass:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (mass,) = masses_by_name([("it", mesh, 1.0)])
    return mass


def test_an_inside_out_box_weighs_as_a_box() -> None:
    mesh = trimesh.creation.box([1.0, 2.0, 3.0])
    mesh.invert()
    mass = _one(mesh)
    assert mass.volume_m3 == pytest.approx(6.0)
    np.testing.assert_allclose(mass.inertia_per_density, 0.5 * np.diag([13.0, 10.0, 5.0]))


def test_an_open_box_weighs_as_its_hull() -> None:
    mesh = trimesh.creation.box([1.0, 2.0, 3.0])
    mesh.update_faces(np.arange(12) > 0)
    assert _one(mesh).volume_m3 == pytest.approx(6.0)


def test_pieces_of_an_open_mesh_are_weighed_one_by_one() -> None:
    """Two open boxes far apart: not the hull of both."""
    halves = []
    for x in (-5.0, 5.0):
        mesh = trimesh.creation.box([1.0, 1.0, 1.0])
        mesh.update_faces(np.arange(12) > 0)
        mesh.apply_translation([x, 0, 0])
        halves.append(mesh)
    mass = _one(join(halves))
    assert mass.volume_m3 == pytest.approx(2.0)
    assert mass.inertia_per_density[1, 1] == pytest.approx(2.0 * (25.0 + 1.0 / 6.0))


def test_a_flat_sheet_is_a_thin_plate() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    mass = _one(sheet)
    thickness = SHEET_THICKNESS * np.sqrt(2.0)
    volume = 2.0 * thickness
    assert mass.volume_m3 == pytest.approx(volume)
    np.testing.assert_allclose(mass.com_G, [1.0, 0.5, 0.0])
    plate = volume / 12.0 * np.diag([1.0 + thickness**2, 4.0 + thickness**2, 5.0])
    np.testing.assert_allclose(mass.inertia_per_density, plate, rtol=1e-9, atol=1e-15)


def test_a_folded_sheet_that_holds_nothing_weighs_as_a_sheet() -> None:
    folded = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [2, 1, 0]], process=False)
    assert _one(folded).volume_m3 > 0


def test_names_gather_their_parts_and_densities() -> None:
    box = trimesh.creation.box()
    masses = masses_by_name([("a", box, 1.0), ("b", box, 2.0), ("a", box, 3.0)])
    assert [mass.name for mass in masses] == ["a", "b"]
    assert masses[0].volume_m3 * masses[0].density_factor == pytest.approx(4.0)
    assert masses[1].density_factor == 2.0
