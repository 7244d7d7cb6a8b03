"""The second texture generator: overlapping shapes of all sizes, strokes and glyphs (body.texture: collage).

Marks first, then flat sheets, then the unrolled walls of tanks, rings, nozzles and reflectors.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code, drawing
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

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


@drawing
def panel(canvas: Canvas, rng: np.random.Generator, base: float, richness: float = 1.0) -> None:
    """A collage of flat patches with glyphs, strokes and combs on it."""
    canvas.code[:] = code(base)
    kind = Leaves(smallest=4.0 / np.sqrt(richness), spread=0.75, coverings=1.6 + 0.6 * min(richness, 2.5))
    scatter_leaves(canvas, 1.15 * base, kind, rng, canvas.layer_of(mat.VINYL))
    inscriptions(canvas, 1.2e-4 * richness, rng)
    strokes(canvas, 1.0e-4 * richness, rng)
    combs(canvas, 0.6e-4 * richness, rng)


@drawing
def plain(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """Large pale patches, hardly distinguishable."""
    canvas.code[:] = code(base)
    scatter_leaves(
        canvas, base, Leaves(smallest=14.0, largest=120.0, spread=0.05, coverings=1.5, relief=0.0), rng
    )


@drawing
def machined_plate(canvas: Canvas, rng: np.random.Generator) -> None:
    """Metal with round lands of all sizes, turned and bored."""
    height, width = canvas.shape
    canvas.code[:] = code(0.12)
    canvas.layer[:] = canvas.layer_of(mat.ANODISED)
    for _ in range(int(9e-4 * canvas.area)):
        at = tuple(rng.uniform((0, 0), (width, height)).astype(int).tolist())
        radius = int(3.0 / np.sqrt(1.0 - 0.985 * rng.random()))
        cv2.circle(canvas.code, at, radius, code(float(rng.uniform(0.05, 0.3))), -1, cv2.LINE_AA)
        cv2.circle(canvas.height, at, radius, float(rng.uniform(-1.5, 1.0)), -1)
    strokes(canvas, 4e-5, rng)


@drawing
def blanket(canvas: Canvas, rng: np.random.Generator, foil: Material) -> None:
    """Foil: patches of tape of all sizes and straight wrinkles across the sheet."""
    height, width = canvas.shape
    canvas.code[:] = code(foil.albedo)
    canvas.layer[:] = canvas.layer_of(foil)
    few = Leaves(smallest=9.0, largest=60.0, spread=0.5, coverings=0.25, relief=0.8)
    scatter_leaves(canvas, 0.15, few, rng, canvas.layer_of(mat.TAPE))
    folds = np.zeros(canvas.shape, np.float32)
    i, j = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(9):
        angle, where = rng.uniform(0, np.pi), rng.uniform((0, 0), (width, height))
        across = (j - where[0]) * np.float32(np.cos(angle)) + (i - where[1]) * np.float32(np.sin(angle))
        folds += np.float32(rng.normal(0, 0.06)) * np.abs(across)
    canvas.height += folds
    inscriptions(canvas, 1e-5, rng)


@drawing
def cells(canvas: Canvas, rng: np.random.Generator, cell: int = 60) -> None:
    """Cells in rows that are shifted against each other, each row of its own height."""
    height, width = canvas.shape
    canvas.code[:] = code(float(rng.uniform(0.1, 0.4)))
    canvas.layer[:] = canvas.layer_of(mat.PAINT_WHITE)
    glass = canvas.layer_of(mat.SOLAR_CELL)
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


def _ramp(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A cell that is a little brighter towards one end, with fine lines across."""
    tone = rng.uniform(0.02, 0.06) * (1.0 + 0.35 * np.linspace(-1, 1, shape[1]) * rng.choice([-1.0, 1.0]))
    sheet = np.repeat(255.0 * np.sqrt(tone)[None], shape[0], axis=0)
    sheet[:: int(rng.integers(9, 16))] += 9.0
    return np.asarray(np.clip(sheet, 0, 255), np.uint8)


@drawing
def radiator(canvas: Canvas, rng: np.random.Generator) -> None:
    """A mosaic: the cells of random points, mirrors or white paint, each askew in its own way."""
    height, width = canvas.shape
    mirrors = rng.random() < 0.5
    canvas.layer[:] = canvas.layer_of(mat.MIRROR if mirrors else mat.PAINT_WHITE)
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


def _mosaic(height: int, width: int, points: NDArray[np.float32]) -> NDArray[np.int64]:
    """Index (h, w) of the nearest of points (n, 2) at each texel."""
    seeds = np.full((height, width), 255, np.uint8)
    where = points.astype(int)
    seeds[where[:, 1], where[:, 0]] = 0
    _, nearest = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    return np.asarray(np.minimum(nearest - 1, len(points) - 1), dtype=np.int64)


@drawing
def tank_wall(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """Large patches, lines of tall glyphs along the tank, darker towards the lower end."""
    height, width = canvas.shape
    canvas.code[:] = code(base)
    large = Leaves(smallest=10.0, largest=0.3 * height, spread=0.3, coverings=1.2)
    scatter_leaves(canvas, base, large, rng, canvas.layer_of(mat.PAINT_WHITE))
    scatter_leaves(
        canvas,
        base,
        Leaves(smallest=4.0, largest=30.0, spread=0.8, coverings=0.25),
        rng,
        canvas.layer_of(mat.VINYL),
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


@drawing
def ring_wall(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """Triangles of a space frame in relief, patches between them."""
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


@drawing
def nozzle_wall(canvas: Canvas, rng: np.random.Generator) -> None:
    """Rings of different heat, crossed by a winding groove."""
    height, width = canvas.shape
    edges = np.sort(rng.uniform(0, height, 14)).astype(int)
    tone = np.repeat(rng.uniform(0.05, 0.22, 15), np.diff([0, *edges, height]))
    canvas.code[:] = (255.0 * np.sqrt(tone))[:, None].astype(np.uint8)
    scatter_leaves(canvas, 0.12, Leaves(smallest=3.0, largest=12.0, spread=0.5, coverings=0.3), rng)
    i, j = np.mgrid[:height, :width].astype(np.float32)
    phase = 2 * np.pi * (i / rng.uniform(9, 16) + 3.0 * j / width)
    canvas.height += (0.9 * np.maximum(np.sin(phase), 0.3)).astype(np.float32)


@drawing
def reflector(canvas: Canvas, rng: np.random.Generator, base: float, gores: int) -> None:
    """Crossing seams in a net, patches and glyphs along the rim."""
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
