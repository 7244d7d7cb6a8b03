"""Mass against volume, for a box whose volume's centre, axes and ratios are known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.lie import exp_so3
from polhode.pipeline.uniform_density import check_physics
from polhode.records import Identifiability, MassProperties, SurfaceModel

BOX_M = (0.12, 0.20, 0.24)


def surface_of(mesh: trimesh.Trimesh) -> SurfaceModel:
    n = len(mesh.vertices)
    return SurfaceModel(mesh, np.full(n, 1e-3), np.full(n, 5, dtype=np.int64))


def box() -> trimesh.Trimesh:
    solid: trimesh.Trimesh = trimesh.creation.box(BOX_M).subdivide().subdivide().subdivide()
    return solid


def sentence(words: list[str], start: str) -> str:
    return next(text for text in words if text.startswith(start))


def known(mass: MassProperties, **flags: Any) -> Identifiability:
    return replace(mass.identifiable, **flags)


def test_an_offset_centre_of_mass_is_told_in_words(example: Any) -> None:
    mass = replace(example.estimate.mass, com_G=np.array([0.009, 0.0, 0.0]), cov_com_G=np.eye(3) * 1.6e-7)
    found = check_physics(mass, surface_of(box()))
    assert found is not None
    assert found.com_uniform_G == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert found.com_offset_G == pytest.approx((0.009, 0.0, 0.0), abs=1e-9)
    assert found.com_offset_sigma_m == pytest.approx(4e-4)
    text = sentence(found.words, "the centre of mass")
    assert text.startswith("the centre of mass is 9 mm off the volume's centre along +x of G (sigma 0.4 mm")
    assert text.endswith("mass is not spread evenly")


def test_uniform_density_agrees(example: Any) -> None:
    mass = replace(example.estimate.mass, com_G=np.zeros(3))
    found = check_physics(mass, surface_of(box()))
    assert found is not None and found.volume_m3 == pytest.approx(np.prod(BOX_M))
    assert found.axes_angle_deg == pytest.approx(0.0, abs=1e-6)
    assert found.k1_difference == pytest.approx(0.0, abs=1e-9) == found.k2_difference
    assert "agrees with the volume's centre within" in sentence(found.words, "the centre of mass")
    assert "axes agree" in sentence(found.words, "the principal axes")
    assert all("agrees" in sentence(found.words, name) for name in ("k1", "k2"))


def test_turned_axes_are_told_and_half_turns_are_none(example: Any) -> None:
    mass = example.estimate.mass
    for half_turn in ((1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)):
        turned = replace(mass, R_GP=exp_so3([0.0, 0.0, np.deg2rad(10.0)]) * np.array(half_turn))
        found = check_physics(turned, surface_of(box()))
        assert found is not None and found.axes_angle_deg == pytest.approx(10.0, abs=1e-6)
        assert "axes are rotated by 10 deg" in sentence(found.words, "the principal axes")


def test_ratios_that_differ_are_told(example: Any) -> None:
    mass = replace(example.estimate.mass, k1=example.estimate.mass.k1 + 0.2)
    found = check_physics(mass, surface_of(box()))
    assert found is not None and found.k1_difference == pytest.approx(0.2)
    assert "k1 is 0.200 larger than the volume's" in sentence(found.words, "k1")


def test_nothing_is_said_of_what_the_motion_does_not_determine(example: Any) -> None:
    mass = example.estimate.mass
    none = np.zeros(3, dtype=bool)
    lost = replace(
        mass,
        identifiable=known(mass, k1=False, k2=False, com=False, axes=False, com_P=none, axes_P=none),
        cov_k=np.diag([np.inf, np.inf]),
    )
    found = check_physics(lost, surface_of(box()))
    assert found is not None and len(found.words) == 1
    assert found.com_offset_G is None and found.axes_angle_deg is None
    assert found.k1_difference is None and found.k2_difference is None


def test_one_lost_component_is_left_out(example: Any) -> None:
    mass = example.estimate.mass
    x_lost = np.array([False, True, True])
    partly = replace(
        mass,
        com_G=np.array([0.05, 0.01, 0.0]),
        cov_com_G=np.diag([np.inf, np.inf, np.inf]),
        identifiable=known(
            mass,
            com=False,
            axes=False,
            com_P=x_lost,
            axes_P=np.array([True, True, False]),
            sigma=np.full(8, 1e-4),
        ),
    )
    found = check_physics(partly, surface_of(box()))
    assert found is not None and found.com_offset_G == pytest.approx((0.0, 0.01, 0.0), abs=1e-9)
    assert found.com_offset_sigma_m == pytest.approx(1e-4)
    text = sentence(found.words, "the centre of mass")
    assert (
        "10 mm" in text
        and "+y of G" in text
        and text.endswith("along x of P is not determined by the motion")
    )
    # the turn about z is lost, so z is the only axis that both tell
    assert sentence(found.words, "the principal axis z agrees")


def test_an_open_mesh_is_compared_by_its_hull_as_well_as_that_tells(example: Any) -> None:
    mass = replace(example.estimate.mass, com_G=np.array([0.0, 0.0, 0.02]))
    opened = trimesh.Trimesh(box().vertices, box().faces[40:], process=False)
    found = check_physics(mass, surface_of(opened))
    assert found is not None and "convex hull" in found.words[0]
    assert sentence(found.words, "the centre of mass").endswith("or the hull is not the body")
    # two plates: their hull is a box, they themselves enclose nothing
    sides = np.abs(box().triangles_center[:, 0]) > 0.059
    plates = trimesh.Trimesh(box().vertices, box().faces[sides], process=False)
    result = check_physics(mass, surface_of(plates))
    assert result is None or result.com_offset_G is None or "hull" in result.words[0]


def test_no_surface_has_no_volume(example: Any) -> None:
    assert check_physics(example.estimate.mass, surface_of(trimesh.Trimesh())) is None
