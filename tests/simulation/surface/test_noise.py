"""Solid textures: no repetition between parallel faces, no dependence on the order of evaluation."""

import numpy as np
import pytest

from polhode.geometry.lie import Array, Ints
from polhode.simulation.surface.materials import (
    FOIL_GOLD,
    PAINT_WHITE,
    REGOLITH,
    WORN_PANEL,
    Material,
    MaterialTable,
)
from polhode.simulation.surface.noise import cell_at, creases_at, fractal, fractal_at

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


@pytest.mark.parametrize("material", [PAINT_WHITE, FOIL_GOLD, REGOLITH, WORN_PANEL])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_opposite_faces_share_no_pattern_under_any_shift_or_turn(material: Material, axis: int) -> None:
    front, back = _face(axis, 0.11), _face(axis, -0.11)
    itself = _highest_correlation(_albedo(material, front), _albedo(material, front))
    assert itself == pytest.approx(1.0)
    assert _highest_correlation(_albedo(material, front), _albedo(material, back)) < 0.65


def test_another_seed_gives_another_pattern() -> None:
    face = _face(2, 0.11)
    assert _highest_correlation(_albedo(WORN_PANEL, face, 3), _albedo(WORN_PANEL, face, 4)) < 0.65


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


def test_creased_foil_is_flat_between_jumps() -> None:
    points = np.random.default_rng(1).uniform(-5, 5, (500, 3))
    here = np.array([creases_at(x, y, z, 5) for x, y, z in points])
    there = np.array([creases_at(x, y, z, 5) for x, y, z in points + 0.004])
    same = (here == there).all(axis=1)
    assert 0.8 < same.mean() < 0.995
    assert np.linalg.norm(here - there, axis=1)[~same].min() > 1e-3
    assert np.abs(here.mean(axis=0)).max() < 0.1
