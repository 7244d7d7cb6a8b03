"""Light by way of the body against closed forms of radiative exchange."""

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
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.surface.materials import Material

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


@pytest.mark.parametrize("distance_m", [0.02, 0.05, 0.1, 0.2])
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


def test_a_highlight_carries_the_light_of_a_metal_to_its_neighbour() -> None:
    """A metal wall throws the Sun onto the floor: far more than its diffuse part, at most all of it."""
    metal = Material(0.05, specular=0.9, roughness=0.45)
    parts = [
        Part(_box([0.5, 0.6, 0.02], [0.25, 0.0, -0.01]), MATT),
        Part(_box([0.02, 0.6, 0.4], [-0.01, 0.0, 0.2]), metal),
    ]
    body = assemble(parts)
    caster = RayCaster(body)
    scene = (
        IndirectLight(
            body, caster, SurfaceAppearance(body, config.TargetBody(contrast=0.0), 0), 1, probes=2500
        ),
        caster,
    )
    sun = np.array([np.cos(1.0), 0.0, np.sin(1.0)])
    found = _irradiance(scene, replace(SUN, sun_direction_G=sun), [0.1, 0.0, 0.0], UP)
    assert 0.4 * np.sin(1.0) < found < np.sin(1.0)


def test_a_wall_hides_half_of_the_earth_from_its_foot() -> None:
    """At the foot of a high wall, under an Earth overhead; far from it, nearly nothing is hidden."""
    indirect, caster = _indirect(
        _box([1.6, 4.0, 0.02], [0.0, 0.0, -0.01]), _box([0.02, 4.0, 3.0], [0.0, 0.0, 1.5])
    )
    foot, away = (_hit(caster, [x, 0.0, 0.0], UP) for x in (0.03, 0.78))
    assert indirect.at(foot, EARTH).earth_share()[0] == pytest.approx(0.5, abs=0.03)
    assert indirect.at(away, EARTH).earth_share()[0] > 0.55


def test_nothing_is_hidden_on_a_ball_and_nothing_bounces_on_it() -> None:
    indirect, caster = _indirect(trimesh.creation.icosphere(subdivisions=3, radius=0.1))
    origin = np.array([0.0, 0.0, 0.5])
    rays = np.random.default_rng(0).normal((0, 0, -1), 0.08, (200, 3))
    hits = caster.first_hits(origin, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    around = indirect.at(hits, replace(EARTH, sun=1.0))
    np.testing.assert_allclose(around.earth_share(), 1.0, atol=1e-3)
    np.testing.assert_allclose(around.bounced(hits.normal_G), 0.0, atol=1e-6)


def test_what_was_asked_before_does_not_change_the_answer() -> None:
    """Lights are taken in small steps, so that moments close to each other share one answer."""
    meshes = (_box([0.5, 0.6, 0.02], [0.25, 0.0, -0.01]), _box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]))
    lights = [replace(SUN, sun_direction_G=np.array([np.cos(a), 0, np.sin(a)])) for a in (0.3, 0.3005, 0.8)]
    asked, fresh = _indirect(*meshes)[0], _indirect(*meshes)[0]
    for moment in lights:
        asked.for_lights(moment)
    np.testing.assert_array_equal(asked.for_lights(lights[0]).bounced, fresh.for_lights(lights[0]).bounced)
    assert asked.for_lights(lights[0]) is asked.for_lights(lights[0])
