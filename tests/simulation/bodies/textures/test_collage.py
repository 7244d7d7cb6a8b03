"""Two texture generators that share nothing, told apart by their statistics."""

import ast
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.simulation.bodies.textures import collage, drawn, drawn_marks
from polhode.simulation.bodies.textures.canvas import Canvas, Code, Draw
from polhode.simulation.bodies.textures.part_builder import TextureGenerator, texture_generator
from polhode.simulation.surface import noise, spot_noise
from polhode.simulation.surface.materials import FOIL_GOLD

MODULES = {"drawn": (drawn, drawn_marks), "collage": (collage,)}
SHEETS: dict[str, Callable[[TextureGenerator], Draw]] = {
    "panel": lambda textures: textures.panel(0.3),
    "plain": lambda textures: textures.plain(0.3),
    "machined_plate": lambda textures: textures.machined_plate(),
    "cells": lambda textures: textures.cells(40),
    "radiator": lambda textures: textures.radiator(),
    "blanket": lambda textures: textures.blanket(FOIL_GOLD),
    "tank_wall": lambda textures: textures.tank_wall(0.7),
    "ring_wall": lambda textures: textures.ring_wall(0.4),
    "nozzle_wall": lambda textures: textures.nozzle_wall(),
    "reflector": lambda textures: textures.reflector(0.7, 12),
}


def _canvas(draw: Draw, seed: int = 1, shape: tuple[int, int] = (160, 200)) -> Canvas:
    canvas = Canvas.blank(*shape)
    draw(canvas, np.random.default_rng(seed))
    return canvas


def _imports(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    return {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}


def test_neither_generator_imports_the_other() -> None:
    for own, other in (("drawn", "collage"), ("collage", "drawn")):
        for module in MODULES[own]:
            assert not any(f".{other}" in name for name in _imports(Path(str(module.__file__)))), module
    assert "polhode.simulation.surface.spot_noise" not in _imports(Path(noise.__file__))
    assert "polhode.simulation.surface.noise" not in _imports(Path(spot_noise.__file__))


@pytest.mark.parametrize("texture", ["drawn", "collage"])
@pytest.mark.parametrize("sheet", SHEETS)
def test_a_sheet_is_its_seeds_and_of_any_size(texture: str, sheet: str) -> None:
    draw = SHEETS[sheet](texture_generator("drawn" if texture == "drawn" else "collage"))
    np.testing.assert_array_equal(_canvas(draw, 1).code, _canvas(draw, 1).code)
    assert (_canvas(draw, 1).code != _canvas(draw, 2).code).any()
    for shape in ((3, 40), (40, 3), (14, 14)):
        assert _canvas(draw, 3, shape).code.shape == shape


def _along_axes(code: Code) -> float:
    """Share of the gradient's energy within 10 degrees of the sheet's rows or columns."""
    down, right = np.gradient(code.astype(np.float64))
    energy = np.asarray(right**2 + down**2)
    from_axis: Array = np.abs((np.arctan2(down, right) + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    return float(energy[from_axis < np.deg2rad(10)].sum() / energy.sum())


def test_drawn_panels_keep_to_rows_and_columns_and_collages_do_not() -> None:
    def shares(texture: TextureGenerator) -> list[float]:
        return [_along_axes(_canvas(texture.panel(0.3), seed, (300, 300)).code) for seed in range(4)]

    # Directions without preference have 0.22.
    assert min(shares(texture_generator("drawn"))) > 0.4
    assert max(shares(texture_generator("collage"))) < 0.28


def test_leaves_have_structure_at_all_scales() -> None:
    """The spectrum of dead leaves falls with the square of the frequency (Lee, Mumford and Huang 2001)."""
    v, u = np.meshgrid(np.fft.fftfreq(256) * 256, np.fft.fftfreq(256) * 256, indexing="ij")
    radius = np.rint(np.hypot(u, v)).astype(np.int64)
    power: Array = np.zeros((256, 256))
    for seed in range(4):
        code = _canvas(texture_generator("collage").panel(0.3, 1.0), seed, (256, 256)).code.astype(np.float64)
        power += np.abs(np.fft.fft2(code - code.mean())) ** 2
    frequency = np.arange(4, 60)
    rings = [float(power[radius == f].mean()) for f in frequency]
    slope = np.polyfit(np.log(frequency), np.log(rings), 1)[0]
    assert -2.8 < slope < -1.2
