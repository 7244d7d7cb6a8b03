"""Tiled sheets of the first generator: solar cells under cover glass, radiators of mirrors or white paint."""

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.drawn.labels import sticker
from polhode.simulation.bodies.textures.drawn.marks import fill, rivets, screw, smudges
from polhode.simulation.surface.materials import BRUSHED_METAL, MIRROR, PAINT_WHITE, SOLAR_CELL

CELL_TILT = 0.012
"""Standard deviation of a cell's slope: each glints at its own moment."""


def cells(cell: int = 60) -> Draw:
    """Strings of cells, ``cell`` texels long, with cut corners, on a substrate with wires and hold-downs."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        substrate = float(rng.choice([0.09, 0.16, 0.5]))
        canvas.code[:] = code(substrate)
        canvas.layer[:] = canvas.layer_of(PAINT_WHITE)
        glass, metal = canvas.layer_of(SOLAR_CELL), canvas.layer_of(BRUSHED_METAL)
        margin = max(3, cell // 14)
        long, short = cell, max(6, int(cell * rng.choice([0.5, 0.55, 0.98])))
        if rng.random() < 0.5:
            long, short = short, long
        gap = max(1, cell // 40)
        columns, rows = (
            max(1, round((width - 2 * margin) / long)),
            max(1, round((height - 2 * margin) / short)),
        )
        lefts = np.linspace(margin, width - margin, columns + 1).astype(int)
        tops = np.linspace(margin, height - margin, rows + 1).astype(int)
        corner = int(0.13 * min(long, short)) if rng.random() < 0.8 else 0
        tone = float(rng.uniform(0.025, 0.05))
        string = int(rng.integers(3, 7))
        for row in range(rows):
            for column in range(columns):
                # A wider gap parts the strings.
                wide = gap + (2 * gap if (column + 1) % string == 0 and column + 1 < columns else 0)
                corners = (lefts[column], tops[row], lefts[column + 1] - wide, tops[row + 1] - gap)
                if corners[2] - corners[0] > 3 and corners[3] - corners[1] > 3:
                    _cell(canvas, corners, corner, tone, (glass, metal), rng)
        _hold_downs(canvas, rng)
        for _ in range(int(rng.poisson(1.2e-5 * canvas.area))):
            sticker(canvas, rng)

    return draw


def _cell(
    canvas: Canvas,
    corners: tuple[int, int, int, int],
    cut: int,
    tone: float,
    layers: tuple[int, int],
    rng: np.random.Generator,
) -> None:
    """One cell: dark glass with its own tilt and tone, bright tabs on one side; some replaced or cracked."""
    left, top, right, bottom = corners
    outline = np.array([
        (left + cut, top), (right - cut, top), (right, top + cut), (right, bottom - cut),
        (right - cut, bottom), (left + cut, bottom), (left, bottom - cut), (left, top + cut),
    ])  # fmt: skip
    own = tone * float(np.exp(rng.normal(0, 0.16)))
    if rng.random() < 0.03:
        own *= 2.2
    cv2.fillPoly(canvas.code, [outline], code(own))
    cv2.fillPoly(canvas.layer, [outline], layers[0])
    canvas.tilt[top:bottom, left:right] = rng.normal(0, CELL_TILT, 2)
    for share in (0.2, 0.5, 0.8):
        u = left + int(share * (right - left))
        fill(canvas, (u - 1, bottom - 1, u + 2, bottom + 2), code(0.3), layers[1])
    middle = (top + bottom) // 2
    if bottom - top > 20:
        canvas.code[middle, left + 2 : right - 2] = code(own + 0.03)
    if rng.random() < 0.02:
        a, b = rng.uniform((left, top), (right, bottom), (2, 2)).astype(int).tolist()
        cv2.line(canvas.code, tuple(a), tuple(b), code(0.12), 1, cv2.LINE_AA)


def _hold_downs(canvas: Canvas, rng: np.random.Generator) -> None:
    """Round fittings that held the folded wing, and a frame around the sheet."""
    height, width = canvas.shape
    if min(height, width) < 80:
        return
    metal = canvas.layer_of(BRUSHED_METAL)
    for v in (0.25, 0.75):
        for u in (0.3, 0.7):
            at = (int(u * width), int(v * height))
            radius = int(rng.integers(7, 11))
            cv2.circle(canvas.layer, at, radius, metal, -1)
            cv2.circle(canvas.code, at, radius, code(0.35), -1, cv2.LINE_AA)
            cv2.circle(canvas.code, at, max(2, radius // 2), code(0.03), -1, cv2.LINE_AA)
    edge = max(2, min(height, width) // 90)
    for corners in ((0, 0, width, edge), (0, height - edge, width, height), (0, 0, edge, height),
                    (width - edge, 0, width, height)):  # fmt: skip
        fill(canvas, corners, code(0.25), metal)


def radiator() -> Draw:
    """A heat radiator: small mirror tiles, each a little askew, or white paint over heat pipes."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        if rng.random() < 0.55:
            _mirrors(canvas, rng)
        else:
            _white_paint(canvas, rng)
        height, width = canvas.shape
        if min(height, width) > 60:
            for at in ((9.0, 9.0), (width - 9.0, 9.0), (9.0, height - 9.0), (width - 9.0, height - 9.0)):
                screw(canvas, np.array(at), 3.0, rng)

    return draw


def _mirrors(canvas: Canvas, rng: np.random.Generator) -> None:
    height, width = canvas.shape
    canvas.code[:] = code(0.35)
    layer = canvas.layer_of(MIRROR)
    tile = int(rng.integers(20, 34))
    for top in range(4, height - 4, tile + 1):
        for left in range(4, width - 4, tile + 1):
            window = (slice(top, min(top + tile, height - 4)), slice(left, min(left + tile, width - 4)))
            canvas.code[window] = code(float(rng.uniform(0.02, 0.05)))
            canvas.layer[window] = layer
            canvas.tilt[window] = rng.normal(0, 0.008, 2)


def _white_paint(canvas: Canvas, rng: np.random.Generator) -> None:
    height, width = canvas.shape
    canvas.code[:] = code(0.76)
    canvas.layer[:] = canvas.layer_of(PAINT_WHITE)
    smudges(canvas, 0.02, rng)
    pitch = int(rng.integers(40, 80))
    for v in range(pitch // 2, height, pitch):
        i = np.arange(height)[:, None]
        canvas.height += (2.5 * np.exp(-(((i - v) / 7.0) ** 2))).astype(np.float32)
        for side in (-11, 11):
            rivets(canvas, np.array([6.0, v + side]), np.array([width - 6.0, v + side]), 14.0, 1.6)
    for _ in range(int(rng.poisson(4e-5 * canvas.area))):
        sticker(canvas, rng)
