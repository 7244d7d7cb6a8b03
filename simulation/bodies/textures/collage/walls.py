"""Unrolled walls of the second generator: tanks, rings, nozzles, reflectors."""

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.collage.marks import (
    Leaves,
    combs,
    inscription,
    inscriptions,
    scatter_leaves,
    strokes,
)
from polhode.simulation.surface.materials import PAINT_WHITE, VINYL


def tank_wall(base: float) -> Draw:
    """Large patches, lines of tall glyphs along the tank, darker towards the lower end."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        large = Leaves(smallest=10.0, largest=0.3 * height, spread=0.3, coverings=1.2)
        scatter_leaves(canvas, base, large, rng, canvas.layer_of(PAINT_WHITE))
        scatter_leaves(
            canvas,
            base,
            Leaves(smallest=4.0, largest=30.0, spread=0.8, coverings=0.25),
            rng,
            canvas.layer_of(VINYL),
        )
        tone = 0.04 if base > 0.2 else 0.7
        for column in np.linspace(0.1, 0.9, 3) * width:
            size = 0.075 * width
            count = max(2, int(0.7 * height / (0.8 * size)))
            start = np.array([column, 0.86 * height])
            inscription(canvas, start, size, count, tone, -0.5 * np.pi)
        inscriptions(canvas, 4e-5, rng)
        combs(canvas, 2e-5, rng)
        fade = 1.0 - 0.5 * np.linspace(0, 1, height)[:, None] ** 6
        canvas.code[...] = (canvas.code * fade).astype(np.uint8)

    return draw


def ring_wall(base: float) -> Draw:
    """Triangles of a space frame in relief, patches between them."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        scatter_leaves(canvas, base, Leaves(smallest=4.0, largest=24.0, spread=0.35, coverings=1.0), rng)
        count = max(3, round(width / (1.2 * height + 8)))
        for k in range(count + 1):
            for a, b in (((k - 0.5), k), ((k + 0.5), k)):
                top, bottom = (round(a * width / count), 0), (round(b * width / count), height - 1)
                cv2.line(canvas.height, top, bottom, 1.5, 3)
                cv2.line(canvas.code, top, bottom, code(0.7 * base), 2, cv2.LINE_AA)
        inscriptions(canvas, 8e-5, rng, tallest=0.5 * height + 8)

    return draw


def nozzle_wall() -> Draw:
    """Rings of different heat, crossed by a winding groove."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        edges = np.sort(rng.uniform(0, height, 14)).astype(int)
        tone = np.repeat(rng.uniform(0.05, 0.22, 15), np.diff([0, *edges, height]))
        canvas.code[:] = (255.0 * np.sqrt(tone))[:, None].astype(np.uint8)
        scatter_leaves(canvas, 0.12, Leaves(smallest=3.0, largest=12.0, spread=0.5, coverings=0.3), rng)
        i, j = np.mgrid[:height, :width].astype(np.float32)
        phase = 2 * np.pi * (i / rng.uniform(9, 16) + 3.0 * j / width)
        canvas.height += (0.9 * np.maximum(np.sin(phase), 0.3)).astype(np.float32)

    return draw


def reflector(base: float, gores: int) -> Draw:
    """Crossing seams in a net, patches and glyphs along the rim."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        scatter_leaves(
            canvas, base, Leaves(smallest=12.0, largest=90.0, spread=0.1, coverings=1.0, relief=0.0), rng
        )
        for k in range(-gores, 2 * gores):
            for lean in (-1, 1):
                start = round(k * width / gores)
                end = (start + lean * width // gores, height - 1)
                cv2.line(canvas.code, (start, 0), end, code(0.7 * base), 1, cv2.LINE_AA)
                cv2.line(canvas.height, (start, 0), end, -0.8, 2)
        strokes(canvas, 2e-5, rng)
        inscriptions(canvas, 4e-5, rng)

    return draw
