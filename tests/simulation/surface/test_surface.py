"""Materials and their solid noise: contrast and scale, no repetition, gradients, flat pieces of foil."""

from dataclasses import fields, replace

import numpy as np
import pytest

from polhode.geometry.lie import Array, Ints
from polhode.simulation.surface import materials
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    FOIL_GOLD,
    PAINT_WHITE,
    REGOLITH,
    WORN_PANEL,
    Material,
    MaterialTable,
    Surface,
)
from polhode.simulation.surface.noise import cell_at, fractal, fractal_at
from polhode.simulation.surface.spot_noise import discs_at, layered_spots_at, spots_at

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


@pytest.mark.parametrize("collage", [False, True])
@pytest.mark.parametrize("name", ["FOIL_GOLD", "REGOLITH", "BRUSHED_METAL"])
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


@pytest.mark.parametrize("material", [REGOLITH, BRUSHED_METAL])
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


SIDE = 64


def _face(normal_axis: int, height_m: float) -> Array:
    """Points (SIDE^2, 3) of a square face of 0.2 m, in one order on every face."""
    grid = np.linspace(-0.1, 0.1, SIDE)
    a, b = (g.ravel() for g in np.meshgrid(grid, grid))
    points = np.empty((SIDE**2, 3))
    points[:, (normal_axis + 1) % 3], points[:, (normal_axis + 2) % 3] = a, b
    points[:, normal_axis] = height_m
    return points


def _albedo(material: Material, points: Array, seed: int = 3) -> Array:
    normal = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    table = MaterialTable((material,), seed)
    return table.evaluate(np.zeros(len(points), np.int64), points, normal).albedo


def _highest_correlation(one: Array, other: Array) -> float:
    """Over all shifts, turns by 90 degrees and mirrorings of the other, by Fourier transform."""
    one, other = (x.reshape(SIDE, SIDE) - x.mean() for x in (one, other))
    scale = np.linalg.norm(one) * np.linalg.norm(other)
    spectrum = np.fft.fft2(one)
    variants = [np.rot90(m, k) for m in (other, other[::-1]) for k in range(4)]
    best = max(np.fft.ifft2(spectrum * np.conj(np.fft.fft2(v))).real.max() for v in variants)
    return float(best / scale)


@pytest.mark.parametrize(("material", "axis"), [(PAINT_WHITE, 0), (FOIL_GOLD, 1), (REGOLITH, 2)])
def test_opposite_faces_share_no_pattern_under_any_shift_or_turn(material: Material, axis: int) -> None:
    front, back = _face(axis, 0.11), _face(axis, -0.11)
    itself = _highest_correlation(_albedo(material, front), _albedo(material, front))
    assert itself == pytest.approx(1.0)
    assert _highest_correlation(_albedo(material, front), _albedo(material, back)) < 0.65


def test_noise_depends_on_the_point_alone_is_continuous_and_has_its_gradient() -> None:
    rng = np.random.default_rng(0)
    points, order = rng.uniform(-1, 1, (500, 3)), rng.permutation(500)
    scale: Array = np.full(500, 0.03)
    seed: Ints = np.full(500, 7)
    values = fractal(points, scale, seed)
    np.testing.assert_array_equal(values[order], fractal(points[order], scale, seed))
    assert np.abs(values).max() <= 1.0
    cells = np.array([cell_at(x, y, z, 7) for x, y, z in points / 0.03])
    np.testing.assert_array_equal(cells[order], [cell_at(x, y, z, 7) for x, y, z in points[order] / 0.03])
    assert np.abs(cells).max() <= 1.0
    at = np.array([[0.2, 0.4, 0.6], [-0.2, 0.0, 0.2]])
    scale, seed = np.full(2, 0.2), np.full(2, 5)
    jump = fractal(at + 1e-9, scale, seed) - fractal(at - 1e-9, scale, seed)
    assert np.abs(jump).max() < 1e-6
    rng = np.random.default_rng(1)
    points, direction = rng.uniform(-1, 1, (50, 3)), np.array([0.6, -0.48, 0.64])
    scale, seed, step = np.full(50, 0.5), np.full(50, 9), 1e-5
    ahead = fractal(points + step * direction, scale, seed, octaves=1)
    behind = fractal(points - step * direction, scale, seed, octaves=1)
    gradient = np.array([fractal_at(x, y, z, 1, 9)[1:] for x, y, z in points / 0.5]) @ direction
    np.testing.assert_allclose(gradient, 0.5 * (ahead - behind) / (2 * step), atol=0.02)


def test_the_gradient_of_spots_is_that_of_their_sum() -> None:
    rng = np.random.default_rng(2)
    step = 1e-6
    for p in rng.uniform(-5, 5, (60, 3)):
        for noise in (spots_at, layered_spots_at):
            _, *gradient = noise(p[0], p[1], p[2], 7)
            for axis in range(3):
                d = step * np.eye(3)[axis]
                (a, b, c), (e, f, g) = p + d, p - d
                change = (noise(a, b, c, 7)[0] - noise(e, f, g, 7)[0]) / (2 * step)
                np.testing.assert_allclose(gradient[axis], change, atol=1e-5)


def test_spots_vary_and_stay_within_bounds() -> None:
    points = np.random.default_rng(0).uniform(-20, 20, (4000, 3))
    values = np.array([layered_spots_at(x, y, z, 3)[0] for x, y, z in points])
    assert 0.15 < values.std() < 0.6 and abs(values.mean()) < 0.05 and np.abs(values).max() < 4.0
    discs = np.array([discs_at(x, y, z, 3) for x, y, z in points])
    assert np.abs(discs).max() <= 1.0
    # Hard edges: most close neighbours have exactly the same value, some a very different one.
    jump = np.abs(discs - np.array([discs_at(p[0] + 0.02, p[1], p[2], 3) for p in points]))
    assert (jump == 0).mean() > 0.7 and (jump > 0.3).mean() > 0.02
