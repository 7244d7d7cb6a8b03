"""Dead leaves: opaque shapes whose sizes follow a power law, one on top of another.

Lee, Mumford and Huang, "Occlusion models for natural images", IJCV 2001: with a density of radii of r^-3 the
statistics are those of natural images at every scale.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from polhode.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code

COVERINGS = 2.5
"""Area of all leaves over that of the sheet: what is left of the ground is exp(-COVERINGS)."""


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


def strew(
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
