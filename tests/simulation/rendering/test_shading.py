"""Reflection against closed forms."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.lie import Array
from polhode.simulation.bodies.parts.part import Part, assemble
from polhode.simulation.rendering.light import Lights
from polhode.simulation.rendering.raycast import Hits, RayCaster
from polhode.simulation.rendering.shading import Arriving, shade
from polhode.simulation.surface.materials import Material, MaterialTable

UP = np.array([0.0, 0.0, 1.0])


def _plate_levels(
    material: Material, sun_G: Array, viewer_G: Array, arriving: Arriving | None = None, **lights: Any
) -> Array:
    """Level of a plate in the xy plane, seen from directions viewer_G (n, 3)."""
    caster = RayCaster(assemble([Part(trimesh.creation.box([1.0, 1.0, 0.02]), material)]))
    n = len(viewer_G)
    up, p_G = np.tile(UP, (n, 1)), np.tile([0.0, 0.0, 0.01], (n, 1))
    corner = np.tile([1.0, 0.0, 0.0], (n, 1))
    hits = Hits(np.arange(n), np.zeros(n, np.int64), corner, np.ones(n), p_G, up, up)
    surface = MaterialTable((material,), 0).evaluate(np.zeros(n, np.int64), p_G, up)
    bright = Lights(sun_G, 1.0, UP, 0.0, np.array([0.0, 0.0, 2.01]), 0.0)
    return shade(hits, surface, viewer_G, replace(bright, **lights), caster, arriving=arriving)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0, 85.0])
def test_a_matt_surface_obeys_lamberts_law_from_everywhere(angle_deg: float) -> None:
    matt = Material(0.4, specular=0.0)
    sun = np.array([np.sin(np.deg2rad(angle_deg)), 0, np.cos(np.deg2rad(angle_deg))])
    viewers = np.array([UP, [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]])
    np.testing.assert_allclose(_plate_levels(matt, sun, viewers), 0.4 * np.cos(np.deg2rad(angle_deg)))


def test_a_surface_turned_from_the_sun_is_black_without_fill() -> None:
    assert _plate_levels(Material(0.4), -UP, UP[None], sun=1.0) == 0.0


def test_the_lamp_falls_with_the_square_of_the_distance() -> None:
    assert _plate_levels(Material(0.4, specular=0.0), UP, UP[None], sun=0.0, lamp=1.0) == pytest.approx(0.1)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
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


def test_the_highlight_lies_in_the_mirror_direction() -> None:
    sun = np.array([0.6, 0.0, 0.8])
    angles = np.deg2rad(np.linspace(-80, 80, 321))
    viewers = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)
    levels = _plate_levels(Material(0.01, specular=0.6, roughness=0.3), sun, viewers)
    np.testing.assert_allclose(viewers[np.argmax(levels)], [-0.6, 0, 0.8], atol=0.02)


def test_a_plate_under_the_earth_has_the_level_of_its_disc() -> None:
    matt, angle = Material(0.4, specular=0.0), np.deg2rad(66.0)
    lights = {"sun": 0.0, "earth": 0.15, "earth_radius_rad": angle}
    level = _plate_levels(matt, UP, UP[None], **lights)
    assert level == pytest.approx(0.4 * 0.15 * np.sin(angle) ** 2)


def test_what_arrives_by_way_of_the_body_adds_to_the_diffuse_level() -> None:
    matt, arriving = Material(0.4, specular=0.0), Arriving(bounced=np.full(1, 0.3), mirrored=np.full(1, 0.02))
    level = _plate_levels(matt, UP, UP[None], arriving, sun=0.0)
    assert level == pytest.approx(0.4 * 0.3 + 0.02)
    hidden = _plate_levels(matt, UP, UP[None], Arriving(earth_share=np.full(1, 0.25)), sun=0.0, earth=0.15)
    assert hidden == pytest.approx(0.25 * _plate_levels(matt, UP, UP[None], sun=0.0, earth=0.15))
