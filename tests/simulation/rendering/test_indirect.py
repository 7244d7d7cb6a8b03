"""Light by way of the body against closed forms of radiative exchange; where probes are and what they see."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.indirect import IndirectLight
from polhode.simulation.rendering.light import Lights
from polhode.simulation.rendering.probes import BELOW, DARK, SKY, Probes, SurfaceInterpolation, place_probes
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.surface.materials import PAINT_WHITE, Material

MATT = Material(0.5, specular=0.0)
UP = np.array([0.0, 0.0, 1.0])
SUN = Lights(UP, 1.0, UP, 0.0, np.zeros(3), 0.0)
EARTH = replace(SUN, sun=0.0, earth=1.0, earth_radius_rad=np.deg2rad(66.0))


def _box(extents_m: list[float], centre_G: list[float]) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box(extents_m)
    mesh.apply_translation(centre_G)
    return mesh


def _indirect(*meshes: trimesh.Trimesh, material: Material = MATT) -> tuple[IndirectLight, RayCaster]:
    body = assemble([Part(mesh, material) for mesh in meshes])
    caster = RayCaster(body)
    return IndirectLight(
        body, caster, SurfaceAppearance(body, config.TargetBody(contrast=0.0), 0), 1, probes=2500
    ), caster


def _irradiance(
    scene: tuple[IndirectLight, RayCaster], lights: Lights, p_G: list[float], normal_G: Array
) -> float:
    """Bounced irradiance on the surface at p_G (3,), seen from along its normal (3,)."""
    indirect, caster = scene
    hits = _hit(caster, p_G, normal_G)
    return float(indirect.at(hits, lights).bounced(hits.normal_G)[0])


def _hit(caster: RayCaster, p_G: list[float], normal_G: Array) -> Hits:
    return caster.first_hits(np.array(p_G) + 0.003 * normal_G, -normal_G[None])


@pytest.mark.parametrize("distance_m", [0.02, 0.1])
def test_a_sunlit_wall_lights_the_floor_by_its_form_factor(distance_m: float) -> None:
    """From a point to an upright rectangle whose foot is on the plane (Howell, B-5), twice a half."""
    scene = _indirect(_box([0.5, 0.6, 0.02], [0.25, 0.0, -0.01]), _box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]))
    sun = np.array([1.0, 0.0, 1e-6])
    lights = replace(SUN, sun_direction_G=sun / np.linalg.norm(sun))
    half, height, c = 0.3, 0.3, distance_m
    slant = np.hypot(height, c)
    form_factor = 2 / (2 * np.pi) * (np.arctan(half / c) - c / slant * np.arctan(half / slant))
    assert _irradiance(scene, lights, [c, 0.0, 0.0], UP) == pytest.approx(0.5 * form_factor, rel=0.04)


def test_a_sunlit_floor_lights_the_plate_above_it() -> None:
    """From a point to a rectangle in a parallel plane (Howell, B-3), four quarters."""
    scene = _indirect(_box([0.6, 0.6, 0.02], [0.0, 0.0, -0.01]), _box([0.1, 0.1, 0.01], [0.0, 0.0, 0.205]))
    sun = np.array([np.cos(0.4), 0.0, np.sin(0.4)])
    a = 0.3 / np.hypot(0.3, 0.2)
    form_factor = 4 / (2 * np.pi) * 2 * a * np.arctan(a)
    level = 0.5 * np.sin(0.4)
    lights = replace(SUN, sun_direction_G=sun)
    assert _irradiance(scene, lights, [0.0, 0.0, 0.2], -UP) == pytest.approx(level * form_factor, rel=0.03)


def test_one_bounce_inside_a_bowl_is_the_same_everywhere() -> None:
    """An integrating sphere with a cap cut off: from everywhere the wall fills its share of the ball."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.2)
    bowl = ball.submesh([ball.triangles_center[:, 2] < 0.2 * np.cos(np.deg2rad(50.0))], append=True)
    share = bowl.area / (4 * np.pi * 0.2**2)
    scene = _indirect(bowl)
    lights = replace(SUN, sun=0.0, lamp=0.04)
    for direction in (-UP, np.array([0.6, 0.0, -0.8]), np.array([-0.9539, 0.0, 0.3])):
        found = _irradiance(scene, lights, (0.198 * direction).tolist(), -direction)
        assert found == pytest.approx(0.5 * 0.04 / 0.2**2 * share, rel=0.03)


def test_a_wall_hides_half_of_the_earth_from_its_foot() -> None:
    """At the foot of a high wall, under an Earth overhead; far from it, nearly nothing is hidden."""
    indirect, caster = _indirect(
        _box([1.6, 4.0, 0.02], [0.0, 0.0, -0.01]), _box([0.02, 4.0, 3.0], [0.0, 0.0, 1.5])
    )
    foot, away = (_hit(caster, [x, 0.0, 0.0], UP) for x in (0.03, 0.78))
    assert indirect.at(foot, EARTH).earth_share()[0] == pytest.approx(0.5, abs=0.03)
    assert indirect.at(away, EARTH).earth_share()[0] > 0.55


def test_what_was_asked_before_does_not_change_the_answer() -> None:
    """Lights are taken in small steps, so that moments close to each other share one answer."""
    meshes = (_box([0.5, 0.6, 0.02], [0.25, 0.0, -0.01]), _box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]))
    lights = [replace(SUN, sun_direction_G=np.array([np.cos(a), 0, np.sin(a)])) for a in (0.3, 0.3005, 0.8)]
    asked, fresh = _indirect(*meshes)[0], _indirect(*meshes)[0]
    for moment in lights:
        asked.for_lights(moment)
    np.testing.assert_array_equal(asked.for_lights(lights[0]).bounced, fresh.for_lights(lights[0]).bounced)
    assert asked.for_lights(lights[0]) is asked.for_lights(lights[0])


def _probes(*meshes: trimesh.Trimesh) -> Probes:
    body = assemble([Part(mesh, PAINT_WHITE) for mesh in meshes])
    return place_probes(body.mesh, RayCaster(body), 1200)


def test_probes_are_where_light_reaches() -> None:
    """Two boxes through each other, one of them wound inside out."""
    probes = _probes(trimesh.creation.icosphere(subdivisions=3, radius=0.1))
    assert (np.einsum("nk,nk->n", probes.p_G, probes.normal_G) > 0).all()
    assert set(np.unique(probes.sees)) == {SKY, BELOW}
    assert 900 < len(probes.p_G) < 1500
    inner = trimesh.creation.box([0.1, 0.1, 0.4])
    inner.invert()
    probes = _probes(trimesh.creation.box([0.3, 0.3, 0.2]), inner)
    within_box = (np.abs(probes.p_G) < [0.149, 0.149, 0.099]).all(axis=1)
    within_rod = (np.abs(probes.p_G) < [0.049, 0.049, 0.199]).all(axis=1)
    assert not (within_box | within_rod).any()
    outward = np.einsum("nk,nk->n", probes.p_G, probes.normal_G)
    assert (outward > 0).all()
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    probes = _probes(sheet)
    share = (probes.normal_G[:, 2] > 0).mean()
    assert 0.45 < share < 0.55


def test_probes_see_each_other_across_a_gap() -> None:
    """The middle of the floor sees the ceiling in the directions that lead there, and names probes of it."""
    ceiling = trimesh.creation.box([0.4, 0.4, 0.01])
    ceiling.apply_translation([0, 0, 0.2])
    probes = _probes(trimesh.creation.box([0.4, 0.4, 0.01]), ceiling)
    floor = np.linalg.norm(probes.p_G - [0, 0, 0.005], axis=1).argmin()
    seen = probes.sees[floor]
    up = probes.directions_G[:, 2]
    reach = 0.19 * np.abs(probes.directions_G[:, :2]) / np.maximum(up, 1e-9)[:, None]
    inside = (up > 0) & (np.abs(probes.p_G[floor, :2]) + reach < 0.19).all(axis=1)
    assert inside.sum() > 100
    assert (seen[inside] >= 0).all()
    met = probes.p_G[seen[inside]]
    np.testing.assert_allclose(met[:, 2], 0.195, atol=1e-6)
    expected = probes.p_G[floor] + probes.directions_G[inside] * (0.19 / up[inside])[:, None]
    assert np.linalg.norm(met - expected, axis=1).max() < 0.03
    assert (seen[up < 0] == BELOW).all()
    assert DARK not in seen


UP = np.array([0.0, 0.0, 1.0])


def _grid(height_m: float = 0.0) -> Array:
    x, y = (0.01 * index.ravel() for index in np.mgrid[:21, :21])
    return np.stack([x, y, np.full_like(x, height_m)], axis=1)


def _facing(normal: Array, count: int) -> Array:
    return np.tile(normal, (count, 1))


def test_an_even_field_stays_even_and_a_slope_is_followed() -> None:
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, len(points)), 0.025)
    at = np.random.default_rng(0).uniform([0.03, 0.03, 0.0], [0.17, 0.17, 0.0], (300, 3))
    near = around.near(at, _facing(UP, 300))
    np.testing.assert_allclose(near.weight.sum(axis=1), 1.0, rtol=1e-5)
    values = np.stack([np.ones(len(points)), points[:, 0]], axis=1).astype(np.float32)
    found = near.mean(values)
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(found[:, 1], at[:, 0], atol=0.002)


def test_the_other_side_of_a_plate_or_a_parallel_plane_does_not_count() -> None:
    points = np.concatenate([_grid(0.0), _grid(-0.001)])
    normals = np.concatenate([_facing(UP, 441), _facing(-UP, 441)])
    around = SurfaceInterpolation(points, normals, 0.025)
    side = np.repeat([[0.0], [1.0]], 441, axis=0).astype(np.float32)
    at = _grid(0.0)[100:200]
    assert around.near(at, _facing(UP, 100)).mean(side).max() == 0.0
    assert around.near(at, _facing(-UP, 100)).mean(side).min() > 0.999
    points = np.concatenate([_grid(0.0), _grid(0.012)])
    around = SurfaceInterpolation(points, _facing(UP, 882), 0.025)
    upper = np.repeat([[0.0], [1.0]], 441, axis=0).astype(np.float32)
    assert around.near(_grid(0.0), _facing(UP, 441)).mean(upper).max() == 0.0


def test_a_place_without_points_takes_the_nearest_that_faces_the_same_half() -> None:
    points = np.concatenate([_grid(0.0), _grid(-0.01)])
    around = SurfaceInterpolation(points, np.concatenate([_facing(UP, 441), _facing(-UP, 441)]), 0.025)
    tilted = np.array([[0.98, 0.0, 0.2]])
    near = around.near(np.array([[0.1, 0.1, 0.012]]), tilted)
    assert near.weight.tolist() == [[1.0] + 11 * [0.0]]
    np.testing.assert_allclose(points[near.index[0, 0]], [0.1, 0.1, 0.0])


def test_the_nearest_is_found_or_none() -> None:
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, 441), 0.025)
    away = np.array([[0.1, 0.1, 0.04], [9.0, 9.0, 9.0], [0.1, 0.1, 0.0]])
    facing = np.array([UP, UP, [1.0, 0.0, 0.0]])
    assert (around.nearest(away, facing) == -1).all()
    assert around.near(away, facing).mean(np.ones((441, 1), np.float32)).max() == 0.0
    points = _grid()
    around = SurfaceInterpolation(points, _facing(UP, 441), 0.025)
    found = around.nearest(points + np.array([0.002, -0.001, 0.0]), _facing(UP, 441))
    np.testing.assert_array_equal(found, np.arange(441))
