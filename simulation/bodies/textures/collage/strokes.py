"""Marks of the second generator: glyphs of an invented script, long strokes, combs, dots."""

import cv2
import numpy as np

from polhode.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, code

SHIFT = 3
"""OpenCV takes points in fractions of a texel of 2^-SHIFT."""


def inscription(canvas: Canvas, at: Array, height: float, glyphs: int, tone: float, turn: float) -> None:
    """A line of glyphs from a point (column, row), ``turn`` [rad] from the columns' direction."""
    rng = np.random.default_rng(np.abs(np.rint([*at, height, glyphs])).astype(np.int64).tolist())
    along, up = np.array([np.cos(turn), np.sin(turn)]), np.array([np.sin(turn), -np.cos(turn)])
    for k in range(glyphs):
        corner = at + 0.8 * height * k * along
        _glyph(canvas, corner, along * height * 0.6, up * height, code(tone), rng)


def _glyph(
    canvas: Canvas, corner: Array, across: Array, up: Array, value: int, rng: np.random.Generator
) -> None:
    """Two to four strokes between the nine nodes of a small grid, and sometimes an arc or a dot."""
    thick = max(1, round(0.13 * float(np.linalg.norm(up))))
    nodes = [corner + a * across + b * up for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)]
    walk = rng.permutation(9)[: int(rng.integers(3, 6))]
    path = np.rint(np.array([nodes[n] for n in walk]) * 2**SHIFT).astype(np.int32)
    cv2.polylines(canvas.code, [path], bool(rng.random() < 0.2), value, thick, cv2.LINE_AA, SHIFT)
    if rng.random() < 0.35:
        middle = tuple(np.rint(nodes[4]).astype(int).tolist())
        radius = max(1, round(0.35 * float(np.linalg.norm(across))))
        start = float(rng.uniform(0, 360))
        cv2.ellipse(canvas.code, middle, (radius, radius), 0.0, start, start + 200, value, thick, cv2.LINE_AA)


def strokes(canvas: Canvas, count: int, rng: np.random.Generator) -> None:
    """Curved lines of any length, light or dark."""
    height, width = canvas.shape
    for _ in range(count):
        start = rng.uniform((0, 0), (width, height))
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.25, 8))
        steps = rng.uniform(3, 22) * np.column_stack([np.cos(heading), np.sin(heading)])
        path = np.rint((start + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])) * 2**SHIFT)
        tone = code(float(rng.choice([0.03, 0.1, 0.5, 0.75])))
        cv2.polylines(
            canvas.code, [path.astype(np.int32)], False, tone, int(rng.integers(1, 4)), cv2.LINE_AA, SHIFT
        )


def combs(canvas: Canvas, count: int, rng: np.random.Generator) -> None:
    """Fans of short parallel lines."""
    height, width = canvas.shape
    for _ in range(count):
        at, angle = rng.uniform((0, 0), (width, height)), rng.uniform(0, np.pi)
        along, aside = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        length, pitch = rng.uniform(8, 34), rng.uniform(3, 7)
        tone = code(float(rng.choice([0.04, 0.7])))
        for k in range(int(rng.integers(4, 11))):
            a = at + k * pitch * aside
            ends = np.rint(np.array([a, a + length * along]) * 2**SHIFT).astype(np.int32)
            cv2.polylines(canvas.code, [ends], False, tone, 1, cv2.LINE_AA, SHIFT)


def inscriptions(canvas: Canvas, count: int, rng: np.random.Generator, tallest: float = 26.0) -> None:
    """Lines of glyphs anywhere, of all sizes up to ``tallest`` texels."""
    height, width = canvas.shape
    for _ in range(count):
        at = rng.uniform((0, 0), (width, height))
        size = float(np.exp(rng.uniform(np.log(7.0), np.log(tallest))))
        tone = float(rng.choice([0.03, 0.06, 0.6, 0.8]))
        inscription(canvas, at, size, int(rng.integers(2, 9)), tone, float(rng.uniform(0, 2 * np.pi)))
