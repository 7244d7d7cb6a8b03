"""Flat sheets of the second generator: panels, plain paint, metal plates, foil."""

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.collage.leaves import Leaves, strew
from polhode.simulation.bodies.textures.collage.strokes import combs, inscriptions, strokes
from polhode.simulation.surface.materials import ANODISED, TAPE, VINYL, Material


def panel(base: float, richness: float = 1.0) -> Draw:
    """A collage of flat patches with glyphs, strokes and combs on it."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        kind = Leaves(smallest=4.0 / np.sqrt(richness), spread=0.75, coverings=1.6 + 0.6 * min(richness, 2.5))
        strew(canvas, 1.15 * base, kind, rng, canvas.layer_of(VINYL))
        area = canvas.area
        inscriptions(canvas, int(rng.poisson(1.2e-4 * richness * area)), rng)
        strokes(canvas, int(rng.poisson(1.0e-4 * richness * area)), rng)
        combs(canvas, int(rng.poisson(0.6e-4 * richness * area)), rng)

    return draw


def plain(base: float) -> Draw:
    """Large pale patches, hardly to be told apart."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        strew(canvas, base, Leaves(smallest=14.0, largest=120.0, spread=0.05, coverings=1.5, relief=0.0), rng)

    return draw


def machined_plate() -> Draw:
    """Metal with round lands of all sizes, turned and bored."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(0.12)
        canvas.layer[:] = canvas.layer_of(ANODISED)
        for _ in range(int(9e-4 * canvas.area)):
            at = tuple(rng.uniform((0, 0), (width, height)).astype(int).tolist())
            radius = int(3.0 / np.sqrt(1.0 - 0.985 * rng.random()))
            cv2.circle(canvas.code, at, radius, code(float(rng.uniform(0.05, 0.3))), -1, cv2.LINE_AA)
            cv2.circle(canvas.height, at, radius, float(rng.uniform(-1.5, 1.0)), -1)
        strokes(canvas, int(rng.poisson(4e-5 * canvas.area)), rng)

    return draw


def blanket(foil: Material) -> Draw:
    """Foil: patches of tape of all sizes and straight wrinkles across the sheet."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(foil.albedo)
        canvas.layer[:] = canvas.layer_of(foil)
        few = Leaves(smallest=9.0, largest=60.0, spread=0.5, coverings=0.25, relief=0.8)
        strew(canvas, 0.15, few, rng, canvas.layer_of(TAPE))
        folds = np.zeros(canvas.shape, np.float32)
        i, j = np.mgrid[:height, :width].astype(np.float32)
        for _ in range(9):
            angle, where = rng.uniform(0, np.pi), rng.uniform((0, 0), (width, height))
            across = (j - where[0]) * np.float32(np.cos(angle)) + (i - where[1]) * np.float32(np.sin(angle))
            folds += np.float32(rng.normal(0, 0.06)) * np.abs(across)
        canvas.height += folds
        inscriptions(canvas, int(rng.poisson(1e-5 * canvas.area)), rng)

    return draw
