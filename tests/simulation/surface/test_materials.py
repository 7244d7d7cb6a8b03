"""Materials: believable values, and what contrast and scale do."""

from dataclasses import fields, replace

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.simulation.surface import materials
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    FOIL_GOLD,
    REGOLITH,
    WORN_PANEL,
    Material,
    MaterialTable,
    Surface,
)

ALL = {name: value for name, value in vars(materials).items() if isinstance(value, Material)}
UP = np.array([0.0, 0.0, 1.0])


def _surface(material: Material, points: Array, **more: float) -> Surface:
    table = MaterialTable((material,), 3, **more)  # type: ignore[arg-type]
    return table.evaluate(np.zeros(len(points), np.int64), points, np.tile(UP, (len(points), 1)))


def _points(n: int = 2000) -> Array:
    return np.random.default_rng(0).uniform(-0.1, 0.1, (n, 3)) * [1, 1, 0]


def test_a_drawing_counts_by_the_contrast_and_a_relief_bends_the_normal() -> None:
    for place, field in enumerate(fields(Material)):
        assert getattr(materials, field.name.upper()) == place
    plain = Material(0.4, 0.04)
    table = MaterialTable((plain,), 0, contrast=0.5)
    drawn = np.array([0.8, np.nan])
    surface = table.evaluate(np.zeros(2, np.int64), np.zeros((2, 3)), np.tile(UP, (2, 1)), drawn)
    np.testing.assert_allclose(surface.albedo, [0.6, 0.4])
    table = MaterialTable((Material(0.4),), 0)
    slope = np.array([[0.5, 0.0, 0.0]])
    surface = table.evaluate(np.zeros(1, np.int64), np.zeros((1, 3)), UP[None], slope_G=slope)
    np.testing.assert_allclose(surface.normal_G[0], np.array([-0.5, 0, 1]) / np.sqrt(1.25))


@pytest.mark.parametrize("name", ALL)
def test_no_material_reflects_more_than_falls_on_it(name: str) -> None:
    m = ALL[name]
    assert 0 < m.albedo < 0.9 and 0 <= m.specular < 0.9 and 0.1 <= m.roughness <= 1
    assert m.specular + m.albedo * (1 - m.specular) < 0.95


@pytest.mark.parametrize("collage", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_normals_stay_unit_and_near_the_surfaces(name: str, collage: bool) -> None:
    surface = _surface(ALL[name], _points(500), collage=collage)
    np.testing.assert_allclose(np.linalg.norm(surface.normal_G, axis=1), 1.0, atol=1e-12)
    assert surface.normal_G[:, 2].min() > 0.3


@pytest.mark.parametrize("collage", [False, True])
def test_without_contrast_there_is_one_reflectance(collage: bool) -> None:
    albedo = _surface(WORN_PANEL, _points(), contrast=0.0, collage=collage).albedo
    np.testing.assert_array_equal(albedo, WORN_PANEL.albedo)
    spread = [_surface(WORN_PANEL, _points(), contrast=c, collage=collage).albedo.std() for c in (0.5, 1.0)]
    assert spread[1] == pytest.approx(2.0 * spread[0], rel=0.1)


@pytest.mark.parametrize("material", [REGOLITH, FOIL_GOLD, WORN_PANEL, BRUSHED_METAL])
@pytest.mark.parametrize("collage", [False, True])
def test_textures_grow_with_the_scale(material: Material, collage: bool) -> None:
    points = _points(300)
    one = _surface(material, points, collage=collage)
    large = _surface(material, 2.5 * points, scale=2.5, collage=collage)
    np.testing.assert_allclose(one.albedo, large.albedo, atol=1e-9)
    np.testing.assert_allclose(one.normal_G, large.normal_G, atol=1e-9)


@pytest.mark.parametrize("collage", [False, True])
def test_foil_is_made_of_flat_pieces_with_sharp_creases(collage: bool) -> None:
    """Along a line the normal rests, then jumps; smooth bumps would never rest."""
    points = np.linspace(-0.1, 0.1, 4000)[:, None] * [1.0, 0.3, 0.0]
    normal = _surface(FOIL_GOLD, points, collage=collage).normal_G
    step = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    assert (step == 0).mean() > 0.9
    assert (step > 0.02).sum() > 15


def test_brushed_metal_has_its_grain_along_z() -> None:
    fine = np.linspace(0, 0.02, 400)[:, None]
    flat = replace(BRUSHED_METAL, bump=0.0)
    across = _surface(flat, fine * [1.0, 0, 0]).albedo
    along = _surface(flat, fine * [0, 0, 1.0]).albedo
    assert np.abs(np.diff(across)).sum() > 3.0 * np.abs(np.diff(along)).sum()
