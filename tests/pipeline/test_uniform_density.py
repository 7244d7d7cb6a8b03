"""Uniform density of a box whose centre, axes and ratios are known: assumed, or compared with the motion."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.config.backend_settings import Backend
from polhode.geometry.lie import exp_so3
from polhode.mapping.uniform_solid import coverage, solid_of
from polhode.mapping.visibility import Caster
from polhode.pipeline.uniform_density import assumed_properties, check_physics
from polhode.records.estimate import MassProperties
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Physics

BOX_M = (0.12, 0.20, 0.24)
BOX = trimesh.creation.box(BOX_M).subdivide().subdivide().subdivide()
VOLUME_M3 = float(np.prod(BOX_M))
MOMENTS = (np.sum(np.square(BOX_M)) - np.square(BOX_M)) / 12.0
"""Of a box of 1 kg"""
GIVEN = Backend(mass_kg=4.5)


def surface_of(mesh: trimesh.Trimesh) -> SurfaceModel:
    n = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


def part_of(faces: Any) -> trimesh.Trimesh:
    return trimesh.Trimesh(BOX.vertices, BOX.faces[faces], process=False)


@pytest.fixture
def mass(example: Any) -> MassProperties:
    found: MassProperties = example.estimate.mass
    return found


def partly_known(mass: MassProperties, **flags: Any) -> MassProperties:
    return replace(mass, identifiable=replace(mass.identifiable, **flags))


def compared(mass: MassProperties, mesh: trimesh.Trimesh = BOX) -> Physics:
    found = check_physics(mass, surface_of(mesh))
    assert found is not None
    return found


def sentence(found: Physics, start: str) -> str:
    return next(text for text in found.words if text.startswith(start))


def test_a_given_mass_scales_the_inertia_that_the_motion_determines(mass: MassProperties) -> None:
    assert assumed_properties(mass, surface_of(BOX), Backend()) == (None, [])
    found, warnings = assumed_properties(mass, surface_of(BOX), GIVEN)
    assert found is not None and warnings == []
    assert found.mass_kg == 4.5 and found.volume_m3 == pytest.approx(VOLUME_M3, rel=1e-9)
    np.testing.assert_allclose(np.diag(found.inertia_kg_m2), 4.5 * MOMENTS, rtol=1e-9)
    # what the motion determines stays its own
    assert (found.k1, found.k2, found.com_G, found.R_GP) == (None, None, None, None)
    assert "as given" in found.words[1]
    other = np.diag([1.4, 1.0, 0.7])
    found, _ = assumed_properties(replace(mass, J_G=other), surface_of(BOX), GIVEN)
    assert found is not None
    inertia = np.array(found.inertia_kg_m2)
    np.testing.assert_allclose(inertia / inertia[1, 1], other, atol=1e-12)
    assert np.trace(inertia) == pytest.approx(4.5 * MOMENTS.sum(), rel=1e-9)


def test_a_density_tells_mass_and_all_that_the_motion_does_not(mass: MassProperties) -> None:
    lost = partly_known(mass, k1=False, axes=False, com=False, com_P=np.array([True, False, True]))
    found, _ = assumed_properties(lost, surface_of(BOX), Backend(density_kg_m3=1000.0))
    assert found is not None
    assert found.mass_kg == pytest.approx(1000.0 * VOLUME_M3, rel=1e-9)
    assert found.k1 == pytest.approx(np.log(MOMENTS[0] / MOMENTS[1])) and found.k2 is None
    assert found.R_GP is not None and np.abs(np.array(found.R_GP)).max(axis=0) == pytest.approx(np.ones(3))
    # along the lost axis the box's own middle, along the others the estimate
    assert found.com_G == pytest.approx((0.003, 0.0, 0.002))
    assert {text.split(":")[0] for text in found.words} >= {"k1", "axes", "com", "inertia"}


def test_an_open_mesh_is_its_hull_and_one_side_or_nothing_has_no_volume(mass: MassProperties) -> None:
    solid, _ = solid_of(part_of(slice(80, None)))
    assert solid is not None and "convex hull" in solid.words and "open" in solid.words
    assert solid.volume_m3 == pytest.approx(VOLUME_M3, rel=0.02)
    bowl = part_of((BOX.triangles_center[:, 2] > 0.119) | (BOX.triangles_center[:, 0] > 0.059))
    for mesh, words in ((bowl, "covers only"), (trimesh.Trimesh(), "no surface")):
        found, warnings = assumed_properties(mass, surface_of(mesh), GIVEN)
        assert found is None and len(warnings) == 1 and words in warnings[0]
    assert check_physics(mass, surface_of(trimesh.Trimesh())) is None
    ball = trimesh.creation.icosphere(3)
    assert coverage(Caster(ball), np.zeros(3)) == 1.0
    half = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] > 0.0], process=False)
    assert coverage(Caster(half), np.zeros(3)) == pytest.approx(0.5, abs=0.03)


def test_uniform_density_agrees_and_what_differs_is_told(mass: MassProperties) -> None:
    found = compared(replace(mass, com_G=np.zeros(3)))
    assert found.volume_m3 == pytest.approx(VOLUME_M3)
    assert found.axes_angle_deg == pytest.approx(0.0, abs=1e-6)
    assert found.k1_difference == pytest.approx(0.0, abs=1e-9) == found.k2_difference
    assert "agrees with the volume's centre within" in sentence(found, "the centre of mass")
    assert "axes agree" in sentence(found, "the principal axes")
    assert all("agrees" in sentence(found, name) for name in ("k1", "k2"))
    found = compared(replace(mass, com_G=np.array([0.009, 0.0, 0.0]), cov_com_G=np.eye(3) * 1.6e-7))
    assert found.com_uniform_G == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert found.com_offset_G == pytest.approx((0.009, 0.0, 0.0), abs=1e-9)
    assert found.com_offset_sigma_m == pytest.approx(4e-4)
    text = sentence(found, "the centre of mass")
    assert text.startswith("the centre of mass is 9 mm off the volume's centre along +x of G (sigma 0.4 mm")
    assert text.endswith("mass is not spread evenly")
    for half_turn in ((1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)):
        found = compared(replace(mass, R_GP=exp_so3([0.0, 0.0, np.deg2rad(10.0)]) * np.array(half_turn)))
        assert found.axes_angle_deg == pytest.approx(10.0, abs=1e-6)
        assert "axes are rotated by 10 deg" in sentence(found, "the principal axes")
    found = compared(replace(mass, k1=mass.k1 + 0.2))
    assert found.k1_difference == pytest.approx(0.2)
    assert "k1 is 0.200 larger than the volume's" in sentence(found, "k1")


def test_what_the_motion_does_not_determine_is_left_out(mass: MassProperties) -> None:
    none, inf = np.zeros(3, dtype=bool), np.diag([np.inf] * 3)
    lost = partly_known(mass, k1=False, k2=False, com=False, axes=False, com_P=none, axes_P=none)
    found = compared(replace(lost, cov_k=inf[:2, :2]))
    assert len(found.words) == 1
    assert found.com_offset_G is None and found.axes_angle_deg is None
    assert found.k1_difference is None and found.k2_difference is None
    x_lost, z_lost = np.array([False, True, True]), np.array([True, True, False])
    flags = {"com": False, "axes": False, "com_P": x_lost, "axes_P": z_lost, "sigma": np.full(8, 1e-4)}
    partly = replace(partly_known(mass, **flags), com_G=np.array([0.05, 0.01, 0.0]), cov_com_G=inf)
    found = compared(partly)
    assert found.com_offset_G == pytest.approx((0.0, 0.01, 0.0), abs=1e-9)
    assert found.com_offset_sigma_m == pytest.approx(1e-4)
    text = sentence(found, "the centre of mass")
    assert "10 mm" in text and "+y of G" in text
    assert text.endswith("along x of P is not determined by the motion")
    # the turn about z is lost, so z is the only axis that both tell
    assert sentence(found, "the principal axis z agrees")


def test_an_open_mesh_is_compared_by_its_hull_as_well_as_that_tells(mass: MassProperties) -> None:
    moved = replace(mass, com_G=np.array([0.0, 0.0, 0.02]))
    found = compared(moved, part_of(slice(40, None)))
    assert "convex hull" in found.words[0]
    assert sentence(found, "the centre of mass").endswith("or the hull is not the body")
    # two plates: their hull is a box, they themselves enclose nothing
    result = check_physics(moved, surface_of(part_of(np.abs(BOX.triangles_center[:, 0]) > 0.059)))
    assert result is None or result.com_offset_G is None or "hull" in result.words[0]
