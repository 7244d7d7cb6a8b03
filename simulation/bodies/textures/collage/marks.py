"""Marks of the collage textures: opaque shapes one on top of another, glyphs, long strokes, combs."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from polhode.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code

COVERINGS = 2.5
"""Area of all leaves over that of the sheet: what is left of the ground is exp(-COVERINGS)."""


SHIFT = 3
"""OpenCV takes points in fractions of a texel of 2^-SHIFT."""


@dataclass(frozen=True)
class Leaves:
    """A kind of collage."""

    smallest: float = 3.0
    """Radius [texels]."""
    largest: float = 70.0
    spread: float = 0.5
    """Standard deviation of the logarithm of a leaf's reflectance."""
    coverings: float = COVERINGS
    relief: float = 0.3
    """Height of a leaf's edge [texels]."""


def scatter_leaves(
    canvas: Canvas, base: float, kind: Leaves, rng: np.random.Generator, material: int | None = None
) -> None:
    """Lay leaves around the mean reflectance ``base`` onto the canvas."""
    height, width = canvas.shape
    largest = min(kind.largest, 0.4 * min(height, width) + 1.0)
    smallest = min(kind.smallest, 0.7 * largest)
    # Mean area of a leaf under r^-3 between the two radii.
    area = 2.0 * np.pi * np.log(largest / smallest) / (smallest**-2 - largest**-2)
    count = int(kind.coverings * height * width / area)
    share = rng.random(count)
    radius = 1.0 / np.sqrt(smallest**-2 - share * (smallest**-2 - largest**-2))
    centre = rng.uniform((0, 0), (width, height), (count, 2))
    tone = np.clip(base * np.exp(rng.normal(-0.5 * kind.spread**2, kind.spread, count)), 0.02, 0.85)
    for k in range(count):
        outline = _outline(centre[k], float(radius[k]), rng)
        cv2.fillPoly(canvas.code, [outline], code(float(tone[k])), cv2.LINE_AA)
        if material is not None:
            cv2.fillPoly(canvas.layer, [outline], material)
        if kind.relief > 0 and radius[k] > 5:
            cv2.fillPoly(canvas.height, [outline], float(rng.uniform(0, kind.relief)))


def _outline(centre: Array, radius: float, rng: np.random.Generator) -> Code:
    """A polygon (n, 2) of whole texels: ellipse, box, triangle, star or blob."""
    return np.rint(centre + radius * _turned(SHAPES[int(rng.integers(len(SHAPES)))](rng), rng)).astype(
        np.int32
    )


def _turned(points: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _ellipse(rng: np.random.Generator) -> Array:
    t = np.linspace(0, 2 * np.pi, 17)[:-1]
    return np.column_stack([np.cos(t), rng.uniform(0.35, 1.0) * np.sin(t)])


def _box(rng: np.random.Generator) -> Array:
    h = rng.uniform(0.15, 0.9)
    return np.array([[-1.0, -h], [1.0, -h], [1.0, h], [-1.0, h]])


def _triangle(rng: np.random.Generator) -> Array:
    t = np.sort(rng.uniform(0, 2 * np.pi, 3))
    return np.column_stack([np.cos(t), np.sin(t)])


def _star(rng: np.random.Generator) -> Array:
    n = int(rng.integers(4, 8))
    t = np.arange(2 * n) * np.pi / n
    r = np.where(np.arange(2 * n) % 2 == 0, 1.0, rng.uniform(0.35, 0.7))
    return np.column_stack([r * np.cos(t), r * np.sin(t)])


def _blob(rng: np.random.Generator) -> Array:
    t = np.linspace(0, 2 * np.pi, 25)[:-1]
    r = 0.75 + 0.2 * np.cos(2 * t + rng.uniform(0, 6)) + 0.12 * np.cos(3 * t + rng.uniform(0, 6))
    return np.column_stack([r * np.cos(t), r * np.sin(t)])


SHAPES: tuple[Callable[[np.random.Generator], Array], ...] = (_ellipse, _box, _box, _triangle, _star, _blob)


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


def strokes(canvas: Canvas, per_texel: float, rng: np.random.Generator) -> None:
    """Curved lines of any length, light or dark."""
    height, width = canvas.shape
    for _ in range(int(rng.poisson(per_texel * canvas.area))):
        start = rng.uniform((0, 0), (width, height))
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.25, 8))
        steps = rng.uniform(3, 22) * np.column_stack([np.cos(heading), np.sin(heading)])
        path = np.rint((start + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])) * 2**SHIFT)
        tone = code(float(rng.choice([0.03, 0.1, 0.5, 0.75])))
        cv2.polylines(
            canvas.code, [path.astype(np.int32)], False, tone, int(rng.integers(1, 4)), cv2.LINE_AA, SHIFT
        )


def combs(canvas: Canvas, per_texel: float, rng: np.random.Generator) -> None:
    """Fans of short parallel lines."""
    height, width = canvas.shape
    for _ in range(int(rng.poisson(per_texel * canvas.area))):
        at, angle = rng.uniform((0, 0), (width, height)), rng.uniform(0, np.pi)
        along, aside = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        length, pitch = rng.uniform(8, 34), rng.uniform(3, 7)
        tone = code(float(rng.choice([0.04, 0.7])))
        for k in range(int(rng.integers(4, 11))):
            a = at + k * pitch * aside
            ends = np.rint(np.array([a, a + length * along]) * 2**SHIFT).astype(np.int32)
            cv2.polylines(canvas.code, [ends], False, tone, 1, cv2.LINE_AA, SHIFT)


def inscriptions(canvas: Canvas, per_texel: float, rng: np.random.Generator, tallest: float = 26.0) -> None:
    """Lines of glyphs anywhere, of all sizes up to ``tallest`` texels."""
    height, width = canvas.shape
    for _ in range(int(rng.poisson(per_texel * canvas.area))):
        at = rng.uniform((0, 0), (width, height))
        size = float(np.exp(rng.uniform(np.log(7.0), np.log(tallest))))
        tone = float(rng.choice([0.03, 0.06, 0.6, 0.8]))
        inscription(canvas, at, size, int(rng.integers(2, 9)), tone, float(rng.uniform(0, 2 * np.pi)))
