"""Sheets of the first generator: equipment panels, plain paint, machined plates."""

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.drawn.labels import sticker, write
from polhode.simulation.bodies.textures.drawn.marks import fill, groove, rivets, scratches, screw, smudges
from polhode.simulation.surface.materials import ANODISED, BRUSHED_METAL, PAINT_BLACK, TAPE

Tile = tuple[int, int, int, int]
"""Left, top, right, bottom in texels."""

STICKERS_PER_TEXEL = 1.4e-4
SMALLEST_TILE, LARGEST_TILE = 34, 150


def panel(base: float, richness: float = 1.0) -> Draw:
    """A painted panel: plates of slightly different shade, seams, screws, doors, vents, labels."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        for tile in _split((0, 0, width, height), rng):
            _plate(canvas, tile, base, rng)
        for _ in range(int(rng.poisson(richness * STICKERS_PER_TEXEL * canvas.area))):
            sticker(canvas, rng)
        _edge(canvas, rng)
        smudges(canvas, 0.02, rng)
        scratches(canvas, int(rng.poisson(1.5e-4 * canvas.area)), rng)

    return draw


def plain(base: float) -> Draw:
    """A painted panel with nothing on it but a seam and a few scratches: hard to track, as real ones are."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        smudges(canvas, 0.012, rng)
        _edge(canvas, rng)
        scratches(canvas, int(rng.poisson(6e-5 * canvas.area)), rng)

    return draw


def machined_plate() -> Draw:
    """Bare metal: milled pockets, bolt rows, holes, a part number."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(0.09)
        layer = canvas.layer_of(ANODISED if rng.random() < 0.4 else BRUSHED_METAL)
        canvas.layer[:] = layer
        pitch = int(rng.integers(26, 60))
        for top in range(8, height - pitch, pitch):
            for left in range(8, width - pitch, pitch):
                if rng.random() < 0.75:
                    pocket = slice(top + 4, top + pitch - 3), slice(left + 4, left + pitch - 3)
                    canvas.height[pocket] -= 0.9
                    canvas.code[pocket] = (canvas.code[pocket] * rng.uniform(0.75, 0.95)).astype(np.uint8)
        canvas.height[:] = cv2.GaussianBlur(canvas.height, (5, 5), 1.0)
        _edge(canvas, rng)
        for _ in range(int(rng.poisson(1.2e-4 * canvas.area))):
            at = rng.uniform((0, 0), (width, height)).astype(int).tolist()
            cv2.circle(canvas.code, tuple(at), int(rng.integers(1, 5)), code(0.01), -1, cv2.LINE_AA)
        for _ in range(int(rng.poisson(2e-5 * canvas.area))):
            sticker(canvas, rng)

    return draw


def _split(tile: Tile, rng: np.random.Generator) -> list[Tile]:
    """Cut a rectangle into smaller ones, edge to edge."""
    left, top, right, bottom = tile
    w, h = right - left, bottom - top
    longest = max(w, h)
    if longest < 2 * SMALLEST_TILE or (longest < LARGEST_TILE and rng.random() < 0.35):
        return [tile]
    share = float(rng.choice([0.33, 0.4, 0.5, 0.6, 0.67]))
    if w >= h:
        cut = left + int(share * w)
        return _split((left, top, cut, bottom), rng) + _split((cut, top, right, bottom), rng)
    cut = top + int(share * h)
    return _split((left, top, right, cut), rng) + _split((left, cut, right, bottom), rng)


def _plate(canvas: Canvas, tile: Tile, base: float, rng: np.random.Generator) -> None:
    """One plate of a panel with what is mounted on it."""
    left, top, right, bottom = tile
    w, h = right - left, bottom - top
    shade = base * float(np.exp(rng.normal(0, 0.07)))
    fill(canvas, tile, code(shade))
    groove(canvas, tile, 0.6)
    if min(w, h) < 20:
        return
    kind = rng.random()
    if kind < 0.22:
        _door(canvas, tile, shade, rng)
    elif kind < 0.34:
        _vent(canvas, tile, shade, rng)
    elif kind < 0.44:
        _connectors(canvas, tile, rng)
    elif kind < 0.52:
        _tape(canvas, tile, rng)
    elif kind < 0.58:
        fill(canvas, (left + 1, top + 1, right, bottom), code(float(rng.choice([0.05, 0.1, 0.6, 0.75]))))
    elif kind < 0.75:
        for v in (top + 5, bottom - 5):
            rivets(canvas, np.array([left + 5.0, v]), np.array([right - 5.0, v]), 9.0, 1.7)


def _door(canvas: Canvas, tile: Tile, shade: float, rng: np.random.Generator) -> None:
    """An access door with a rounded seam, screws around it and its number."""
    left, top, right, bottom = tile
    m = 6
    corners = (left + m, top + m, right - m, bottom - m)
    fill(canvas, corners, code(shade * float(rng.choice([0.8, 1.0, 1.15]))))
    groove(canvas, corners, 1.0, 0.6)
    columns = np.linspace(left + m + 5, right - m - 5, max(2, (right - left) // 24))
    for u in columns:
        for v in (top + m + 5, bottom - m - 5):
            screw(canvas, np.array([u, v]), 1.6, rng)
    size = int(min(0.2 * (bottom - top), 0.12 * (right - left)))
    if size >= 5:
        middle = np.array([0.5 * (left + right), 0.5 * (top + bottom)])
        write(canvas, f"{rng.choice(list('ABCDEFGHJKL'))}{rng.integers(10, 99)}", size, middle,
              0.06 if shade > 0.2 else 0.6)  # fmt: skip


def _vent(canvas: Canvas, tile: Tile, shade: float, rng: np.random.Generator) -> None:
    """A row of slots or a field of holes."""
    left, top, right, bottom = (tile[0] + 8, tile[1] + 8, tile[2] - 8, tile[3] - 8)
    dark = code(0.25 * shade)
    if rng.random() < 0.5:
        for v in range(top, bottom, 6):
            fill(canvas, (left, v, right, v + 3), dark)
            canvas.height[v : v + 3, left:right] -= 1.2
    else:
        for v in range(top + 2, bottom, 7):
            for u in range(left + 2, right, 7):
                cv2.circle(canvas.code, (u, v), 2, dark, -1, cv2.LINE_AA)


def _connectors(canvas: Canvas, tile: Tile, rng: np.random.Generator) -> None:
    """A black plate with rows of sockets, bright rims around them."""
    left, top, right, bottom = (tile[0] + 5, tile[1] + 5, tile[2] - 5, tile[3] - 5)
    fill(canvas, (left, top, right, bottom), code(0.05), canvas.layer_of(PAINT_BLACK))
    metal = canvas.layer_of(BRUSHED_METAL)
    radius = int(rng.integers(4, 8))
    for v in range(top + radius + 3, bottom - radius - 1, 2 * radius + 5):
        for u in range(left + radius + 3, right - radius - 1, 2 * radius + 5):
            cv2.circle(canvas.code, (u, v), radius, code(0.3), -1, cv2.LINE_AA)
            cv2.circle(canvas.layer, (u, v), radius, metal, -1)
            cv2.circle(canvas.code, (u, v), radius - 2, code(0.02), -1, cv2.LINE_AA)
            cv2.circle(canvas.layer, (u, v), radius - 2, 0, -1)
            cv2.circle(canvas.code, (u, v), 1, code(0.4), -1, cv2.LINE_AA)


def _tape(canvas: Canvas, tile: Tile, rng: np.random.Generator) -> None:
    """Strips of metal tape over a cable or a sensor."""
    left, top, right, bottom = tile
    layer = canvas.layer_of(TAPE)
    across = rng.random() < 0.5
    for _ in range(int(rng.integers(1, 3))):
        wide = int(rng.integers(5, 12))
        if across:
            v = int(rng.integers(top + 2, max(top + 3, bottom - wide)))
            corners = (left + 3, v, right - 3, v + wide)
        else:
            u = int(rng.integers(left + 2, max(left + 3, right - wide)))
            corners = (u, top + 3, u + wide, bottom - 3)
        fill(canvas, corners, code(0.1), layer)
        canvas.height[corners[1] : corners[3], corners[0] : corners[2]] += 0.4


def _edge(canvas: Canvas, rng: np.random.Generator) -> None:
    """A row of screws along the edges of a sheet, where there is room."""
    height, width = canvas.shape
    if min(height, width) < 60:
        return
    inset, pitch = 7.0, float(rng.uniform(32, 56))
    for u in np.linspace(inset, width - inset, max(2, int(width / pitch))):
        for v in (inset, height - inset):
            screw(canvas, np.array([u, v]), 2.0, rng)
    for v in np.linspace(inset, height - inset, max(2, int(height / pitch)))[1:-1]:
        for u in (inset, width - inset):
            screw(canvas, np.array([u, v]), 2.0, rng)
