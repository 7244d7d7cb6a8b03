"""Flat sheets of the collage textures: panels, paint, metal plates, foil, solar cells, radiators."""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.collage.marks import (
    Leaves,
    combs,
    inscriptions,
    scatter_leaves,
    strokes,
)
from polhode.simulation.surface.materials import (
    ANODISED,
    MIRROR,
    PAINT_WHITE,
    SOLAR_CELL,
    TAPE,
    VINYL,
    Material,
)


def panel(base: float, richness: float = 1.0) -> Draw:
    """A collage of flat patches with glyphs, strokes and combs on it."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        kind = Leaves(smallest=4.0 / np.sqrt(richness), spread=0.75, coverings=1.6 + 0.6 * min(richness, 2.5))
        scatter_leaves(canvas, 1.15 * base, kind, rng, canvas.layer_of(VINYL))
        inscriptions(canvas, 1.2e-4 * richness, rng)
        strokes(canvas, 1.0e-4 * richness, rng)
        combs(canvas, 0.6e-4 * richness, rng)

    return draw


def plain(base: float) -> Draw:
    """Large pale patches, hardly to be told apart."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        scatter_leaves(
            canvas, base, Leaves(smallest=14.0, largest=120.0, spread=0.05, coverings=1.5, relief=0.0), rng
        )

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
        strokes(canvas, 4e-5, rng)

    return draw


def blanket(foil: Material) -> Draw:
    """Foil: patches of tape of all sizes and straight wrinkles across the sheet."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(foil.albedo)
        canvas.layer[:] = canvas.layer_of(foil)
        few = Leaves(smallest=9.0, largest=60.0, spread=0.5, coverings=0.25, relief=0.8)
        scatter_leaves(canvas, 0.15, few, rng, canvas.layer_of(TAPE))
        folds = np.zeros(canvas.shape, np.float32)
        i, j = np.mgrid[:height, :width].astype(np.float32)
        for _ in range(9):
            angle, where = rng.uniform(0, np.pi), rng.uniform((0, 0), (width, height))
            across = (j - where[0]) * np.float32(np.cos(angle)) + (i - where[1]) * np.float32(np.sin(angle))
            folds += np.float32(rng.normal(0, 0.06)) * np.abs(across)
        canvas.height += folds
        inscriptions(canvas, 1e-5, rng)

    return draw


def cells(cell: int = 60) -> Draw:
    """Cells in rows that are shifted against each other, each row of its own height."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(float(rng.uniform(0.1, 0.4)))
        canvas.layer[:] = canvas.layer_of(PAINT_WHITE)
        glass = canvas.layer_of(SOLAR_CELL)
        scatter_leaves(canvas, 0.2, Leaves(spread=0.4, coverings=0.6), rng)
        row = int(rng.integers(2, 5))
        while row < height - 4:
            tall = int(cell * rng.uniform(0.4, 0.8))
            column = int(rng.integers(-cell, 2))
            while column < width:
                wide = int(cell * rng.uniform(0.7, 1.1))
                window = (
                    slice(row, min(row + tall - 2, height - 2)),
                    slice(max(column, 2), min(column + wide - 2, width - 2)),
                )
                if canvas.code[window].size > 0:
                    canvas.code[window] = _ramp(canvas.code[window].shape, rng)
                    canvas.layer[window] = glass
                    canvas.tilt[window] = 0.011 * rng.standard_t(5, 2)
                column += wide
            row += tall
        inscriptions(canvas, 1.5e-5, rng)

    return draw


def _ramp(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A cell that is a little brighter towards one end, with fine lines across."""
    tone = rng.uniform(0.02, 0.06) * (1.0 + 0.35 * np.linspace(-1, 1, shape[1]) * rng.choice([-1.0, 1.0]))
    sheet = np.repeat(255.0 * np.sqrt(tone)[None], shape[0], axis=0)
    sheet[:: int(rng.integers(9, 16))] += 9.0
    return np.asarray(np.clip(sheet, 0, 255), np.uint8)


def radiator() -> Draw:
    """A mosaic: the cells of random points, mirrors or white paint, each askew in its own way."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        mirrors = rng.random() < 0.5
        canvas.layer[:] = canvas.layer_of(MIRROR if mirrors else PAINT_WHITE)
        count = max(4, int(canvas.area / rng.uniform(500, 1400)))
        labels = _mosaic(height, width, rng.uniform((0, 0), (width, height), (count, 2)).astype(np.float32))
        low, high = (0.02, 0.06) if mirrors else (0.6, 0.8)
        tone = np.array([code(float(r)) for r in rng.uniform(low, high, count)], np.uint8)
        canvas.code[:] = tone[labels]
        canvas.tilt[:] = (0.012 * rng.normal(0, 1, (count, 2)))[labels]
        edge = (np.diff(labels, axis=0, append=labels[-1:]) != 0) | (
            np.diff(labels, axis=1, append=labels[:, -1:]) != 0
        )
        canvas.code[edge] = code(0.3)
        inscriptions(canvas, 3e-5, rng)

    return draw


def _mosaic(height: int, width: int, points: NDArray[np.float32]) -> NDArray[np.int64]:
    """Index (h, w) of the nearest of points (n, 2) at each texel."""
    seeds = np.full((height, width), 255, np.uint8)
    where = points.astype(int)
    seeds[where[:, 1], where[:, 0]] = 0
    _, nearest = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    return np.asarray(np.minimum(nearest - 1, len(points) - 1), dtype=np.int64)
