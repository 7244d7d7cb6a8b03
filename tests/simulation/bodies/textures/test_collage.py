"""Two texture generators that share nothing, told apart by their statistics."""

import ast
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.simulation.bodies.textures import collage, drawn, drawn_marks
from polhode.simulation.bodies.textures.canvas import Canvas, Code, Draw
from polhode.simulation.surface import noise, spot_noise
from polhode.simulation.surface.materials import FOIL_GOLD

SHEETS = {
    "panel": (0.3,), "plain": (0.3,), "machined_plate": (), "cells": (40,), "radiator": (),
    "blanket": (FOIL_GOLD,), "tank_wall": (0.7,), "ring_wall": (0.4,), "nozzle_wall": (),
    "reflector": (0.7, 12),
}  # fmt: skip


def _code(draw: Draw, seed: int = 1, shape: tuple[int, int] = (160, 200)) -> Code:
    canvas = Canvas(shape, np.random.default_rng(seed))
    draw(canvas)
    return canvas.code


def test_neither_generator_imports_the_other() -> None:
    for module, other in [
        (drawn, ".collage"), (drawn_marks, ".collage"), (collage, ".drawn"),
        (noise, "surface.spot_noise"), (spot_noise, "surface.noise"),
    ]:  # fmt: skip
        tree = ast.parse(Path(str(module.__file__)).read_text())
        imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        assert not any(other in name for name in imported), module


@pytest.mark.parametrize("textures", [drawn, collage])
@pytest.mark.parametrize("sheet", SHEETS)
def test_a_sheet_is_its_seeds_and_of_any_size(textures: ModuleType, sheet: str) -> None:
    draw = getattr(textures, sheet)(*SHEETS[sheet])
    np.testing.assert_array_equal(_code(draw, 1), _code(draw, 1))
    assert (_code(draw, 1) != _code(draw, 2)).any()
    for shape in ((3, 40), (40, 3), (14, 14)):
        assert _code(draw, 3, shape).shape == shape


def test_drawn_panels_keep_to_rows_and_columns_and_collages_do_not() -> None:
    def share_along_axes(code: Code) -> float:
        """Share of the gradient's energy within 10 degrees of the sheet's rows or columns."""
        down, right = np.gradient(code.astype(np.float64))
        energy = np.asarray(right**2 + down**2)
        from_axis: Array = np.abs((np.arctan2(down, right) + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        return float(energy[from_axis < np.deg2rad(10)].sum() / energy.sum())

    # Directions without preference have 0.22.
    for seed in range(4):
        assert share_along_axes(_code(drawn.panel(0.3), seed, (300, 300))) > 0.4
        assert share_along_axes(_code(collage.panel(0.3), seed, (300, 300))) < 0.28


def test_leaves_have_structure_at_all_scales() -> None:
    """The spectrum of dead leaves falls with the square of the frequency (Lee, Mumford and Huang 2001)."""
    v, u = np.meshgrid(np.fft.fftfreq(256) * 256, np.fft.fftfreq(256) * 256, indexing="ij")
    radius = np.rint(np.hypot(u, v)).astype(np.int64)
    power: Array = np.zeros((256, 256))
    for seed in range(4):
        code = _code(collage.panel(0.3, 1.0), seed, (256, 256)).astype(np.float64)
        power += np.abs(np.fft.fft2(code - code.mean())) ** 2
    frequency = np.arange(4, 60)
    rings = [float(power[radius == f].mean()) for f in frequency]
    slope = np.polyfit(np.log(frequency), np.log(rings), 1)[0]
    assert -2.8 < slope < -1.2
