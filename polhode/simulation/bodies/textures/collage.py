"""The second texture generator: overlapping shapes of all sizes, strokes and glyphs (body.texture: collage).

Marks first, then flat sheets, then the unrolled walls of tanks, rings, nozzles and reflectors.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code, drawing
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

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
    coverings: float = 2.5
    """Area of all leaves over that of the sheet: what is left of the ground is exp(-coverings)."""
    relief: float = 0.3
    """Height of a leaf's edge [texels]."""


def scatter_leaves(c: Canvas, base: float, kind: Leaves, material: int | None = None) -> None:
    """Lay leaves around the mean reflectance ``base`` onto the canvas."""
    rng, (height, width) = c.rng, c.shape
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
        cv2.fillPoly(c.code, [outline], code(float(tone[k])), cv2.LINE_AA)
        if material is not None:
            cv2.fillPoly(c.layer, [outline], material)
        if kind.relief > 0 and radius[k] > 5:
            cv2.fillPoly(c.relief, [outline], float(rng.uniform(0, kind.relief)))


def _outline(centre: Array, radius: float, rng: np.random.Generator) -> Code:
    """A polygon (n, 2) of whole texels: ellipse, box, triangle, star or blob."""
    kind = ("ellipse", "box", "box", "triangle", "star", "blob")[int(rng.integers(6))]
    r: Array | float = 1.0
    flat = 1.0
    if kind == "ellipse":
        t, flat = np.linspace(0, 2 * np.pi, 17)[:-1], rng.uniform(0.35, 1.0)
    elif kind == "triangle":
        t = np.sort(rng.uniform(0, 2 * np.pi, 3))
    elif kind == "star":
        n = int(rng.integers(4, 8))
        t = np.arange(2 * n) * np.pi / n
        r = np.where(np.arange(2 * n) % 2 == 0, 1.0, rng.uniform(0.35, 0.7))
    else:
        t = np.linspace(0, 2 * np.pi, 25)[:-1]
        if kind == "blob":
            r = 0.75 + 0.2 * np.cos(2 * t + rng.uniform(0, 6)) + 0.12 * np.cos(3 * t + rng.uniform(0, 6))
    points = np.column_stack([r * np.cos(t), flat * r * np.sin(t)])
    if kind == "box":
        h = rng.uniform(0.15, 0.9)
        points = np.array([[-1.0, -h], [1.0, -h], [1.0, h], [-1.0, h]])
    angle = rng.uniform(0, 2 * np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.rint(centre + radius * (points @ np.array([[cos, sin], [-sin, cos]])))
    return np.asarray(turned, dtype=np.int32)


def _polyline(c: Canvas, points: Array, value: int, thick: int, closed: bool = False) -> None:
    path = np.rint(points * 2**SHIFT).astype(np.int32)
    cv2.polylines(c.code, [path], closed, value, thick, cv2.LINE_AA, SHIFT)


def inscription(c: Canvas, at: Array, height: float, glyphs: int, tone: float, turn: float) -> None:
    """A line of glyphs from a point (column, row), ``turn`` [rad] from the columns' direction.

    A glyph: two to four strokes between the nine nodes of a small grid, and sometimes an arc.
    """
    rng = np.random.default_rng(np.abs(np.rint([*at, height, glyphs])).astype(np.int64).tolist())
    along, up = np.array([np.cos(turn), np.sin(turn)]), height * np.array([np.sin(turn), -np.cos(turn)])
    across, value = along * height * 0.6, code(tone)
    thick = max(1, round(0.13 * float(np.linalg.norm(up))))
    for k in range(glyphs):
        corner = at + 0.8 * height * k * along
        nodes = [corner + a * across + b * up for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)]
        walk = rng.permutation(9)[: int(rng.integers(3, 6))]
        _polyline(c, np.array([nodes[n] for n in walk]), value, thick, bool(rng.random() < 0.2))
        if rng.random() < 0.35:
            middle = tuple(np.rint(nodes[4]).astype(int).tolist())
            radius, start = max(1, round(0.35 * float(np.linalg.norm(across)))), float(rng.uniform(0, 360))
            cv2.ellipse(c.code, middle, (radius, radius), 0.0, start, start + 200, value, thick, cv2.LINE_AA)


def strokes(c: Canvas, per_texel: float) -> None:
    """Curved lines of any length, light or dark."""
    rng = c.rng
    for _ in range(c.count(per_texel)):
        start = c.anywhere()
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.25, 8))
        steps = rng.uniform(3, 22) * np.column_stack([np.cos(heading), np.sin(heading)])
        tone = code(float(rng.choice([0.03, 0.1, 0.5, 0.75])))
        path = start + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        _polyline(c, path, tone, int(rng.integers(1, 4)))


def combs(c: Canvas, per_texel: float) -> None:
    """Fans of short parallel lines."""
    rng = c.rng
    for _ in range(c.count(per_texel)):
        at, angle = c.anywhere(), rng.uniform(0, np.pi)
        along, aside = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        length, pitch = rng.uniform(8, 34), rng.uniform(3, 7)
        tone = code(float(rng.choice([0.04, 0.7])))
        for k in range(int(rng.integers(4, 11))):
            a = at + k * pitch * aside
            _polyline(c, np.array([a, a + length * along]), tone, 1)


def inscriptions(c: Canvas, per_texel: float, tallest: float = 26.0) -> None:
    """Lines of glyphs anywhere, of all sizes up to ``tallest`` texels."""
    rng = c.rng
    for _ in range(c.count(per_texel)):
        at = c.anywhere()
        size = float(np.exp(rng.uniform(np.log(7.0), np.log(tallest))))
        tone = float(rng.choice([0.03, 0.06, 0.6, 0.8]))
        inscription(c, at, size, int(rng.integers(2, 9)), tone, float(rng.uniform(0, 2 * np.pi)))


@drawing
def panel(c: Canvas, base: float, richness: float = 1.0) -> None:
    """A collage of flat patches with glyphs, strokes and combs on it."""
    c.ground(base)
    kind = Leaves(smallest=4.0 / np.sqrt(richness), spread=0.75, coverings=1.6 + 0.6 * min(richness, 2.5))
    scatter_leaves(c, 1.15 * base, kind, c.layer_of(mat.VINYL))
    inscriptions(c, 1.2e-4 * richness)
    strokes(c, 1.0e-4 * richness)
    combs(c, 0.6e-4 * richness)


@drawing
def plain(c: Canvas, base: float) -> None:
    """Large pale patches, hardly distinguishable."""
    c.ground(base)
    scatter_leaves(c, base, Leaves(smallest=14.0, largest=120.0, spread=0.05, coverings=1.5, relief=0.0))


@drawing
def machined_plate(c: Canvas) -> None:
    """Metal with round lands of all sizes, turned and bored."""
    c.ground(0.12, mat.ANODISED)
    for _ in range(int(9e-4 * c.code.size)):
        at = tuple(c.anywhere().astype(int).tolist())
        radius = int(3.0 / np.sqrt(1.0 - 0.985 * c.rng.random()))
        c.disc(at, radius, float(c.rng.uniform(0.05, 0.3)))
        cv2.circle(c.relief, at, radius, float(c.rng.uniform(-1.5, 1.0)), -1)
    strokes(c, 4e-5)


@drawing
def blanket(c: Canvas, foil: Material) -> None:
    """Foil: patches of tape of all sizes and straight wrinkles across the sheet."""
    c.ground(foil.albedo, foil)
    few = Leaves(smallest=9.0, largest=60.0, spread=0.5, coverings=0.25, relief=0.8)
    scatter_leaves(c, 0.15, few, c.layer_of(mat.TAPE))
    folds = np.zeros(c.shape, np.float32)
    i, j = np.mgrid[: c.shape[0], : c.shape[1]].astype(np.float32)
    for _ in range(9):
        angle, where = c.rng.uniform(0, np.pi), c.anywhere()
        across = (j - where[0]) * np.float32(np.cos(angle)) + (i - where[1]) * np.float32(np.sin(angle))
        folds += np.float32(c.rng.normal(0, 0.06)) * np.abs(across)
    c.relief += folds
    inscriptions(c, 1e-5)


@drawing
def cells(c: Canvas, cell: int = 60) -> None:
    """Cells in rows that are shifted against each other, each row of its own height."""
    rng, (height, width) = c.rng, c.shape
    c.ground(float(rng.uniform(0.1, 0.4)), mat.PAINT_WHITE)
    glass = c.layer_of(mat.SOLAR_CELL)
    scatter_leaves(c, 0.2, Leaves(spread=0.4, coverings=0.6))
    row = int(rng.integers(2, 5))
    while row < height - 4:
        tall = int(cell * rng.uniform(0.4, 0.8))
        column = int(rng.integers(-cell, 2))
        while column < width:
            wide = int(cell * rng.uniform(0.7, 1.1))
            rows = slice(row, min(row + tall - 2, height - 2))
            window = rows, slice(max(column, 2), min(column + wide - 2, width - 2))
            h, w = c.code[window].shape
            if h * w > 0:
                # A cell is a little brighter towards one end, with fine lines across.
                tone = rng.uniform(0.02, 0.06) * (
                    1.0 + 0.35 * np.linspace(-1, 1, w) * rng.choice([-1.0, 1.0])
                )
                sheet = np.repeat(255.0 * np.sqrt(tone)[None], h, axis=0)
                sheet[:: int(rng.integers(9, 16))] += 9.0
                c.code[window] = np.clip(sheet, 0, 255)
                c.layer[window] = glass
                c.tilt[window] = 0.011 * rng.standard_t(5, 2)
            column += wide
        row += tall
    inscriptions(c, 1.5e-5)


@drawing
def radiator(c: Canvas) -> None:
    """A mosaic: the cells of random points, mirrors or white paint, each askew in its own way."""
    rng, (height, width) = c.rng, c.shape
    mirrors = rng.random() < 0.5
    c.layer[:] = c.layer_of(mat.MIRROR if mirrors else mat.PAINT_WHITE)
    count = max(4, int(c.code.size / rng.uniform(500, 1400)))
    column, row = rng.uniform((0, 0), (width, height), (count, 2)).astype(np.float32).astype(int).T
    seeds = np.full(c.shape, 255, np.uint8)
    seeds[row, column] = 0
    nearest = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
    labels = np.minimum(nearest - 1, count - 1)
    low, high = (0.02, 0.06) if mirrors else (0.6, 0.8)
    tone = np.array([code(float(r)) for r in rng.uniform(low, high, count)], np.uint8)
    c.code[:] = tone[labels]
    c.tilt[:] = (0.012 * rng.normal(0, 1, (count, 2)))[labels]
    edge = np.diff(labels, axis=0, append=labels[-1:]) != 0
    edge |= np.diff(labels, axis=1, append=labels[:, -1:]) != 0
    c.code[edge] = code(0.3)
    inscriptions(c, 3e-5)


@drawing
def tank_wall(c: Canvas, base: float) -> None:
    """Large patches, lines of tall glyphs along the tank, darker towards the lower end."""
    height, width = c.shape
    c.ground(base)
    large = Leaves(smallest=10.0, largest=0.3 * height, spread=0.3, coverings=1.2)
    scatter_leaves(c, base, large, c.layer_of(mat.PAINT_WHITE))
    small = Leaves(smallest=4.0, largest=30.0, spread=0.8, coverings=0.25)
    scatter_leaves(c, base, small, c.layer_of(mat.VINYL))
    size = 0.075 * width
    count = max(2, int(0.7 * height / (0.8 * size)))
    for column in np.linspace(0.1, 0.9, 3) * width:
        start = np.array([column, 0.86 * height])
        inscription(c, start, size, count, 0.04 if base > 0.2 else 0.7, -0.5 * np.pi)
    inscriptions(c, 4e-5)
    combs(c, 2e-5)
    fade = 1.0 - 0.5 * np.linspace(0, 1, height)[:, None] ** 6
    c.code[...] = (c.code * fade).astype(np.uint8)


@drawing
def ring_wall(c: Canvas, base: float) -> None:
    """Triangles of a space frame in relief, patches between them."""
    height, width = c.shape
    c.ground(base)
    scatter_leaves(c, base, Leaves(smallest=4.0, largest=24.0, spread=0.35, coverings=1.0))
    count = max(3, round(width / (1.2 * height + 8)))
    for k in range(count + 1):
        for a in (k - 0.5, k + 0.5):
            top, bottom = (round(a * width / count), 0), (round(k * width / count), height - 1)
            cv2.line(c.relief, top, bottom, 1.5, 3)
            cv2.line(c.code, top, bottom, code(0.7 * base), 2, cv2.LINE_AA)
    inscriptions(c, 8e-5, tallest=0.5 * height + 8)


@drawing
def nozzle_wall(c: Canvas) -> None:
    """Rings of different heat, crossed by a winding groove."""
    rng, (height, width) = c.rng, c.shape
    edges = np.sort(rng.uniform(0, height, 14)).astype(int)
    tone = np.repeat(rng.uniform(0.05, 0.22, 15), np.diff([0, *edges, height]))
    c.code[:] = (255.0 * np.sqrt(tone))[:, None].astype(np.uint8)
    scatter_leaves(c, 0.12, Leaves(smallest=3.0, largest=12.0, spread=0.5, coverings=0.3))
    i, j = np.mgrid[:height, :width].astype(np.float32)
    phase = 2 * np.pi * (i / rng.uniform(9, 16) + 3.0 * j / width)
    c.relief += (0.9 * np.maximum(np.sin(phase), 0.3)).astype(np.float32)


@drawing
def reflector(c: Canvas, base: float, gores: int) -> None:
    """Crossing seams in a net, patches and glyphs along the rim."""
    height, width = c.shape
    c.ground(base)
    scatter_leaves(c, base, Leaves(smallest=12.0, largest=90.0, spread=0.1, coverings=1.0, relief=0.0))
    for k in range(-gores, 2 * gores):
        for lean in (-1, 1):
            start = round(k * width / gores)
            end = (start + lean * width // gores, height - 1)
            cv2.line(c.code, (start, 0), end, code(0.7 * base), 1, cv2.LINE_AA)
            cv2.line(c.relief, (start, 0), end, -0.8, 2)
    strokes(c, 2e-5)
    inscriptions(c, 4e-5)
