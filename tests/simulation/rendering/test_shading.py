"""Reflection against closed forms.

What surfaces mirror: the Earth and other parts, rough and sharp.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Bools
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.rendering.appearance import SurfaceAppearance
from polhode.simulation.rendering.indirect import IndirectLight
from polhode.simulation.rendering.light import Lights
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.reflection import reflected, reflected_earth, specular_albedo
from polhode.simulation.rendering.sampling import Stratum, even_directions
from polhode.simulation.rendering.shading import IncidentLight, SpecularTracer, shade
from polhode.simulation.surface.materials import Material, MaterialTable, Surface

UP = np.array([0.0, 0.0, 1.0])


DARK = Lights(UP, 0.0, UP, 0.0, np.zeros(3), 0.0)
MATT = Material(0.6, specular=0.0)


def _plate_levels(
    material: Material, sun_G: Array, viewer_G: Array, incident: IncidentLight | None = None, **lights: Any
) -> Array:
    """Level of a plate in the xy plane, seen from directions viewer_G (n, 3)."""
    caster = RayCaster(assemble([Part(trimesh.creation.box([1.0, 1.0, 0.02]), material)]))
    n = len(viewer_G)
    up, p_G = np.tile(UP, (n, 1)), np.tile([0.0, 0.0, 0.01], (n, 1))
    corner = np.tile([1.0, 0.0, 0.0], (n, 1))
    hits = Hits(np.arange(n), np.zeros(n, np.int64), corner, np.ones(n), p_G, up, up)
    surface = MaterialTable((material,), 0).evaluate(np.zeros(n, np.int64), p_G, up)
    bright = Lights(sun_G, 1.0, UP, 0.0, np.array([0.0, 0.0, 2.01]), 0.0)
    return shade(hits, surface, viewer_G, replace(bright, **lights), caster, incident=incident)


@pytest.mark.parametrize("angle_deg", [0.0, 60.0])
def test_a_matt_surface_obeys_lamberts_law_from_everywhere(angle_deg: float) -> None:
    matt = Material(0.4, specular=0.0)
    sun = np.array([np.sin(np.deg2rad(angle_deg)), 0, np.cos(np.deg2rad(angle_deg))])
    viewers = np.array([UP, [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]])
    np.testing.assert_allclose(_plate_levels(matt, sun, viewers), 0.4 * np.cos(np.deg2rad(angle_deg)))


def test_lamp_earth_and_indirect_light_add_to_the_level() -> None:
    assert _plate_levels(Material(0.4), -UP, UP[None], sun=1.0) == 0.0
    assert _plate_levels(Material(0.4, specular=0.0), UP, UP[None], sun=0.0, lamp=1.0) == pytest.approx(0.1)
    matt, angle = Material(0.4, specular=0.0), np.deg2rad(66.0)
    lights = {"sun": 0.0, "earth": 0.15, "earth_radius_rad": angle}
    level = _plate_levels(matt, UP, UP[None], **lights)
    assert level == pytest.approx(0.4 * 0.15 * np.sin(angle) ** 2)
    matt, incident = (
        Material(0.4, specular=0.0),
        IncidentLight(bounced=np.full(1, 0.3), mirrored=np.full(1, 0.02)),
    )
    level = _plate_levels(matt, UP, UP[None], incident, sun=0.0)
    assert level == pytest.approx(0.4 * 0.3 + 0.02)
    hidden = _plate_levels(
        matt, UP, UP[None], IncidentLight(earth_share=np.full(1, 0.25)), sun=0.0, earth=0.15
    )
    assert hidden == pytest.approx(0.25 * _plate_levels(matt, UP, UP[None], sun=0.0, earth=0.15))


@pytest.mark.parametrize("roughness", [0.3, 1.0])
@pytest.mark.parametrize("angle_deg", [0.0, 45.0])
def test_metal_never_reflects_more_than_falls_on_it(roughness: float, angle_deg: float) -> None:
    """Integral of the reflected light over the hemisphere: at most 1, nearly all of it for smooth metal.

    At full roughness and normal incidence one bounce keeps 1 - ln 2 (the rest would bounce again).
    """
    cosine = (np.arange(400) + 0.5) / 400
    azimuth = 2 * np.pi * (np.arange(400) + 0.5) / 400
    c, a = (grid.ravel() for grid in np.meshgrid(cosine, azimuth))
    s = np.sqrt(1 - c**2)
    viewers = np.stack([s * np.cos(a), s * np.sin(a), c], axis=1)
    sun = np.array([np.sin(np.deg2rad(angle_deg)), 0, np.cos(np.deg2rad(angle_deg))])
    mirror = Material(0.01, specular=1.0, roughness=roughness)
    radiance = _plate_levels(mirror, sun, viewers) / np.pi
    albedo = float(np.mean(radiance * c)) * 2 * np.pi / sun[2]
    assert albedo < 1.001
    if roughness == 0.3:
        assert albedo > 0.97
    if (roughness, angle_deg) == (1.0, 0.0):
        assert albedo == pytest.approx(1 - np.log(2), abs=1e-3)


def _levels(
    parts: list[Part], lights: Lights, seen_from_G: list[float], at_G: Array, samples: int = 1
) -> Array:
    """Level (n,) in the mirror at points at_G (n, 3), as seen from a point (3,); mean over the samples."""
    body = assemble(parts)
    caster, appearance = RayCaster(body), SurfaceAppearance(body, config.TargetBody(contrast=0.0), 0)
    indirect = IndirectLight(body, caster, appearance, 1, probes=1500)
    rays = at_G - np.array(seen_from_G)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits = caster.first_hits(np.array(seen_from_G), rays)
    assert len(hits.ray) == len(at_G)
    surface = appearance.at(hits)
    mirror, around = SpecularTracer(caster, appearance, indirect, 1), indirect.at(hits, lights)
    pixel = np.arange(len(rays))
    strata = [Stratum(pixel, i, samples) for i in range(samples)]
    return np.asarray(
        np.mean([mirror.level(hits, surface, -rays, lights, around, s) for s in strata], axis=0)
    )


def _box(extents_m: list[float], centre_G: list[float]) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box(extents_m)
    mesh.apply_translation(centre_G)
    return mesh


def _integral(
    f0: float, roughness: float, viewer_G: Array, radiance: Callable[[Array], Array | Bools]
) -> float:
    """Level of a plate that faces up, under a radiance of directions (n, 3), by counting directions."""
    sky = even_directions(200_000)
    sky = sky[sky[:, 2] > 0]
    n = len(sky)
    facing, seen = np.tile(UP, (n, 1)), np.tile(viewer_G, (n, 1))
    lobe = reflected(facing, sky, seen, np.zeros(n), np.full(n, f0), np.full(n, roughness**4))
    return float((lobe * radiance(sky)).sum() * 2.0 / n)


def test_a_sharp_mirror_shows_the_earth_where_it_is_and_black_sky_elsewhere() -> None:
    plate = Part(_box([0.4, 0.4, 0.01], [0.0, 0.0, 0.0]), Material(0.02, 0.9, 0.1))
    lights = replace(DARK, earth=0.3, earth_direction_G=np.array([-0.8, 0.0, 0.6]), earth_radius_rad=0.6)
    at_G = np.array([[0.0, 0.0, 0.005], [0.02, 0.03, 0.005]])
    toward = _levels([plate], lights, [0.8, 0.0, 0.605], at_G, samples=4)
    np.testing.assert_allclose(toward, 0.9 * 0.3, rtol=0.01)
    assert _levels([plate], lights, [-0.8, 0.0, 0.605], at_G, samples=4).max() < 0.001


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0])
def test_a_rough_mirror_shows_the_earth_as_wide_as_its_lobe(angle_deg: float) -> None:
    plate = Part(_box([0.4, 0.4, 0.01], [0.0, 0.0, 0.0]), Material(0.02, 0.9, 0.5))
    earth, viewer = (
        np.array([-0.6, 0.0, 0.8]),
        np.array([np.sin(np.deg2rad(angle_deg)), 0.0, np.cos(np.deg2rad(angle_deg))]),
    )
    lights = replace(DARK, earth=0.3, earth_direction_G=earth, earth_radius_rad=0.6)
    found = _levels([plate], lights, (viewer * 2 + [0, 0, 0.005]).tolist(), np.array([[0, 0, 0.005]]))
    exact = _integral(0.9, 0.5, viewer, lambda sky: 0.3 * (sky @ earth > np.cos(0.6)))
    assert found[0] == pytest.approx(exact, abs=0.02)


@pytest.mark.parametrize("roughness", [0.1, 0.35, 0.6])
def test_a_mirror_shows_the_part_beside_it_at_its_level(roughness: float) -> None:
    """A sunlit wall in the mirror of the floor."""
    floor = Part(_box([0.6, 0.6, 0.02], [0.3, 0.0, -0.01]), Material(0.02, 0.8, roughness))
    wall = Part(_box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]), MATT)
    lights = replace(DARK, sun=1.0, sun_direction_G=np.array([0.8, 0.0, 0.6]))
    viewer = np.array([0.6, 0.0, 0.8])
    shown = _levels([floor, wall], lights, [0.7, 0.0, 0.8], np.array([[0.1, 0.0, 0.0]]), samples=4)

    def radiance(sky: Array) -> Array:
        reach = 0.1 / np.maximum(-sky[:, 0], 1e-9)
        return np.asarray(0.48 * ((reach * sky[:, 2] < 0.3) & (np.abs(reach * sky[:, 1]) < 0.3)))

    exact = 0.8 * 0.6 * 0.8 if roughness == 0.1 else _integral(0.8, roughness, viewer, radiance)
    assert shown[0] == pytest.approx(exact, rel=0.06)


def test_a_mirror_shows_black_sky_where_it_faces_away_or_is_hidden_and_matt_nothing() -> None:
    floor = Part(_box([0.6, 0.6, 0.02], [0.3, 0.0, -0.01]), Material(0.02, 0.8, 0.35))
    wall = Part(_box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]), MATT)
    lights = replace(DARK, sun=1.0, sun_direction_G=np.array([0.8, 0.0, 0.6]))
    assert _levels([floor, wall], lights, [0.02, 0.0, 0.4], np.array([[0.3, 0.05, 0.0]]), 4).max() < 0.02
    floor = Part(_box([0.6, 0.6, 0.02], [0.3, 0.0, -0.01]), Material(0.02, 0.8, 0.1))
    wall = Part(_box([0.02, 0.6, 0.3], [-0.01, 0.0, 0.15]), Material(0.01, 0.0))
    lights = replace(DARK, earth=0.3, earth_direction_G=np.array([-0.6, 0.0, 0.8]), earth_radius_rad=1.0)
    assert _levels([floor, wall], lights, [0.5, 0.0, 0.4], np.array([[0.1, 0.0, 0.0]])).max() < 0.01
    lights = replace(DARK, earth=1.0, earth_radius_rad=np.pi / 2)
    plate = Part(_box([0.4, 0.4, 0.01], [0.0, 0.0, 0.0]), MATT)
    assert _levels([plate], lights, [0.1, 0.0, 0.6], np.zeros((1, 3))) == 0.0


@pytest.mark.parametrize("roughness", [0.3, 0.5])
@pytest.mark.parametrize("angle_deg", [10.0, 50.0])
def test_the_closed_form_of_the_mirrored_earth_is_near_the_integral(
    roughness: float, angle_deg: float
) -> None:
    viewer = np.array([np.sin(np.deg2rad(angle_deg)), 0.0, np.cos(np.deg2rad(angle_deg))])
    surface = Surface(np.zeros(1), np.full(1, 0.05), np.full(1, roughness), UP[None])
    for earth in (UP, np.array([-0.9, 0.0, 0.436]), np.array([0.9, 0.0, 0.436])):
        lights = replace(DARK, earth=1.0, earth_direction_G=earth, earth_radius_rad=1.1)
        exact = _integral(0.05, roughness, viewer, partial(_within, earth))
        closed = specular_albedo(surface, viewer[None]) * reflected_earth(surface, viewer[None], lights)
        assert closed[0] == pytest.approx(exact, abs=0.012)


def _within(middle_G: Array, directions_G: Array) -> Bools:
    return np.asarray(directions_G @ middle_G > np.cos(1.1))
