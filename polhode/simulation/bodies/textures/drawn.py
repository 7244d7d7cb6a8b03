"""The first texture generator: stickers, lettering, seams, rivets (body.texture: drawn).

Flat sheets first, then the unrolled walls of tanks, rings, nozzles and reflectors.
"""

from itertools import pairwise

import cv2
import numpy as np

from polhode.simulation.bodies.textures import drawn_marks as marks
from polhode.simulation.bodies.textures.canvas import Canvas, code, drawing
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

Tile = tuple[int, int, int, int]
"""Left, top, right, bottom in texels."""

STICKERS_PER_TEXEL = 1.4e-4
MIN_TILE, MAX_TILE = 34, 150


CELL_TILT = 0.012
"""Standard deviation of a cell's slope: each glints at its own moment."""


@drawing
def panel(canvas: Canvas, rng: np.random.Generator, base: float, richness: float = 1.0) -> None:
    """A painted panel: plates of slightly different shade, seams, screws, doors, vents, labels."""
    height, width = canvas.shape
    canvas.code[:] = code(base)
    for tile in _split((0, 0, width, height), rng):
        _plate(canvas, tile, base, rng)
    marks.stickers(canvas, richness * STICKERS_PER_TEXEL, rng)
    _edge(canvas, rng)
    marks.smudges(canvas, 0.02, rng)
    marks.scratches(canvas, 1.5e-4, rng)


@drawing
def plain(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """A painted panel with nothing on it but a seam and a few scratches: hard to track, as real ones are."""
    canvas.code[:] = code(base)
    marks.smudges(canvas, 0.012, rng)
    _edge(canvas, rng)
    marks.scratches(canvas, 6e-5, rng)


@drawing
def machined_plate(canvas: Canvas, rng: np.random.Generator) -> None:
    """Bare metal: milled pockets, bolt rows, holes, a part number."""
    height, width = canvas.shape
    canvas.code[:] = code(0.09)
    layer = canvas.layer_of(mat.ANODISED if rng.random() < 0.4 else mat.BRUSHED_METAL)
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
    marks.stickers(canvas, 2e-5, rng)


def _split(tile: Tile, rng: np.random.Generator) -> list[Tile]:
    """Cut a rectangle into smaller ones, edge to edge."""
    left, top, right, bottom = tile
    w, h = right - left, bottom - top
    longest = max(w, h)
    if longest < 2 * MIN_TILE or (longest < MAX_TILE and rng.random() < 0.35):
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
    marks.fill(canvas, tile, code(shade))
    marks.groove(canvas, tile, 0.6)
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
        marks.fill(
            canvas, (left + 1, top + 1, right, bottom), code(float(rng.choice([0.05, 0.1, 0.6, 0.75])))
        )
    elif kind < 0.75:
        for v in (top + 5, bottom - 5):
            marks.rivets(canvas, np.array([left + 5.0, v]), np.array([right - 5.0, v]), 9.0, 1.7)


def _door(canvas: Canvas, tile: Tile, shade: float, rng: np.random.Generator) -> None:
    """An access door with a rounded seam, screws around it and its number."""
    left, top, right, bottom = tile
    m = 6
    corners = (left + m, top + m, right - m, bottom - m)
    marks.fill(canvas, corners, code(shade * float(rng.choice([0.8, 1.0, 1.15]))))
    marks.groove(canvas, corners, 1.0, 0.6)
    columns = np.linspace(left + m + 5, right - m - 5, max(2, (right - left) // 24))
    for u in columns:
        for v in (top + m + 5, bottom - m - 5):
            marks.screw(canvas, np.array([u, v]), 1.6, rng)
    size = int(min(0.2 * (bottom - top), 0.12 * (right - left)))
    if size >= 5:
        middle = np.array([0.5 * (left + right), 0.5 * (top + bottom)])
        marks.write(canvas, f"{rng.choice(list('ABCDEFGHJKL'))}{rng.integers(10, 99)}", size, middle,
              0.06 if shade > 0.2 else 0.6)  # fmt: skip


def _vent(canvas: Canvas, tile: Tile, shade: float, rng: np.random.Generator) -> None:
    """A row of slots or a field of holes."""
    left, top, right, bottom = (tile[0] + 8, tile[1] + 8, tile[2] - 8, tile[3] - 8)
    dark = code(0.25 * shade)
    if rng.random() < 0.5:
        for v in range(top, bottom, 6):
            marks.fill(canvas, (left, v, right, v + 3), dark)
            canvas.height[v : v + 3, left:right] -= 1.2
    else:
        for v in range(top + 2, bottom, 7):
            for u in range(left + 2, right, 7):
                cv2.circle(canvas.code, (u, v), 2, dark, -1, cv2.LINE_AA)


def _connectors(canvas: Canvas, tile: Tile, rng: np.random.Generator) -> None:
    """A black plate with rows of sockets, bright rims around them."""
    left, top, right, bottom = (tile[0] + 5, tile[1] + 5, tile[2] - 5, tile[3] - 5)
    marks.fill(canvas, (left, top, right, bottom), code(0.05), canvas.layer_of(mat.PAINT_BLACK))
    metal = canvas.layer_of(mat.BRUSHED_METAL)
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
    layer = canvas.layer_of(mat.TAPE)
    across = rng.random() < 0.5
    for _ in range(int(rng.integers(1, 3))):
        wide = int(rng.integers(5, 12))
        if across:
            v = int(rng.integers(top + 2, max(top + 3, bottom - wide)))
            corners = (left + 3, v, right - 3, v + wide)
        else:
            u = int(rng.integers(left + 2, max(left + 3, right - wide)))
            corners = (u, top + 3, u + wide, bottom - 3)
        marks.fill(canvas, corners, code(0.1), layer)
        canvas.height[corners[1] : corners[3], corners[0] : corners[2]] += 0.4


def _edge(canvas: Canvas, rng: np.random.Generator) -> None:
    """A row of screws along the edges of a sheet, where there is room."""
    height, width = canvas.shape
    if min(height, width) < 60:
        return
    inset, pitch = 7.0, float(rng.uniform(32, 56))
    for u in np.linspace(inset, width - inset, max(2, int(width / pitch))):
        for v in (inset, height - inset):
            marks.screw(canvas, np.array([u, v]), 2.0, rng)
    for v in np.linspace(inset, height - inset, max(2, int(height / pitch)))[1:-1]:
        for u in (inset, width - inset):
            marks.screw(canvas, np.array([u, v]), 2.0, rng)


@drawing
def cells(canvas: Canvas, rng: np.random.Generator, cell: int = 60) -> None:
    """Strings of cells, ``cell`` texels long, with cut corners, on a substrate with wires and hold-downs."""
    height, width = canvas.shape
    substrate = float(rng.choice([0.09, 0.16, 0.5]))
    canvas.code[:] = code(substrate)
    canvas.layer[:] = canvas.layer_of(mat.PAINT_WHITE)
    glass, metal = canvas.layer_of(mat.SOLAR_CELL), canvas.layer_of(mat.BRUSHED_METAL)
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
    marks.stickers(canvas, 1.2e-5, rng)


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
        marks.fill(canvas, (u - 1, bottom - 1, u + 2, bottom + 2), code(0.3), layers[1])
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
    metal = canvas.layer_of(mat.BRUSHED_METAL)
    for v in (0.25, 0.75):
        for u in (0.3, 0.7):
            at = (int(u * width), int(v * height))
            radius = int(rng.integers(7, 11))
            cv2.circle(canvas.layer, at, radius, metal, -1)
            cv2.circle(canvas.code, at, radius, code(0.35), -1, cv2.LINE_AA)
            cv2.circle(canvas.code, at, max(2, radius // 2), code(0.03), -1, cv2.LINE_AA)
    edge = max(2, min(height, width) // 90)
    marks.border(canvas, edge, code(0.25), metal)


@drawing
def radiator(canvas: Canvas, rng: np.random.Generator) -> None:
    """A heat radiator: small mirror tiles, each a little askew, or white paint over heat pipes."""
    if rng.random() < 0.55:
        _mirrors(canvas, rng)
    else:
        _white_paint(canvas, rng)
    height, width = canvas.shape
    if min(height, width) > 60:
        for at in ((9.0, 9.0), (width - 9.0, 9.0), (9.0, height - 9.0), (width - 9.0, height - 9.0)):
            marks.screw(canvas, np.array(at), 3.0, rng)


def _mirrors(canvas: Canvas, rng: np.random.Generator) -> None:
    height, width = canvas.shape
    canvas.code[:] = code(0.35)
    layer = canvas.layer_of(mat.MIRROR)
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
    canvas.layer[:] = canvas.layer_of(mat.PAINT_WHITE)
    marks.smudges(canvas, 0.02, rng)
    pitch = int(rng.integers(40, 80))
    for v in range(pitch // 2, height, pitch):
        i = np.arange(height)[:, None]
        canvas.height += (2.5 * np.exp(-(((i - v) / 7.0) ** 2))).astype(np.float32)
        for side in (-11, 11):
            marks.rivets(canvas, np.array([6.0, v + side]), np.array([width - 6.0, v + side]), 14.0, 1.6)
    marks.stickers(canvas, 4e-5, rng)


@drawing
def blanket(canvas: Canvas, rng: np.random.Generator, foil: Material) -> None:
    """Foil in sheets, under tape, buttons and labels."""
    height, width = canvas.shape
    canvas.code[:] = code(foil.albedo)
    canvas.layer[:] = canvas.layer_of(foil)
    _sheets(canvas, rng)
    _quilting(canvas, rng)
    _pull_lines(canvas, rng)
    _buttons(canvas, rng)
    marks.stickers(canvas, 2.2e-5, rng, askew_deg=8.0)
    edge = max(3, min(height, width) // 60)
    tape = canvas.layer_of(mat.TAPE)
    marks.border(canvas, edge, code(0.12), tape)


def _sheets(canvas: Canvas, rng: np.random.Generator) -> None:
    """Seams of tape where the sheets overlap, none quite straight."""
    height, width = canvas.shape
    tape = canvas.layer_of(mat.TAPE)
    for along, across in ((width, height), (height, width)):
        for place in np.arange(rng.uniform(60, 160), across, rng.uniform(110, 220)):
            wide = int(rng.integers(7, 13))
            start, end = (place + rng.normal(0, 4, 2)).tolist()
            line = np.array([[0, start], [along, end], [along, end + wide], [0, start + wide]])
            points = [np.rint(line if along == width else line[:, ::-1]).astype(np.int32)]
            cover = np.zeros(canvas.shape, np.uint8)
            cv2.fillPoly(cover, points, 1)
            on = cover > 0
            canvas.code[on] = code(float(rng.uniform(0.08, 0.16)))
            canvas.layer[on] = tape
            canvas.height[on] += 0.6


def _quilting(canvas: Canvas, rng: np.random.Generator) -> None:
    """Pillows between rows of stitches."""
    height, width = canvas.shape
    pitch = rng.uniform(48, 90)
    i, j = np.mgrid[:height, :width].astype(np.float32)
    turn = rng.normal(0, 0.06)
    u = (np.cos(turn) * j + np.sin(turn) * i) / pitch + rng.random()
    v = (np.cos(turn) * i - np.sin(turn) * j) / pitch + rng.random()
    pillow = np.sqrt(np.abs(np.sin(np.pi * u) * np.sin(np.pi * v)))
    canvas.height += (rng.uniform(2.0, 5.0) * pillow).astype(np.float32)


def _pull_lines(canvas: Canvas, rng: np.random.Generator) -> None:
    """Sharp folds that run out from where the blanket is held."""
    height, width = canvas.shape
    for _ in range(int(rng.poisson(1.5e-4 * canvas.area))):
        start = rng.uniform((0, 0), (width, height))
        angle = rng.uniform(0, 2 * np.pi)
        end = start + rng.uniform(20, 90) * np.array([np.cos(angle), np.sin(angle)])
        a, b = (tuple(np.rint(p).astype(int).tolist()) for p in (start, end))
        fold = np.zeros((height, width), np.float32)
        low = np.maximum(np.minimum(a, b) - 6, 0)
        high = np.minimum(np.maximum(a, b) + 7, (width, height))
        if (high <= low).any():
            continue
        window = (slice(low[1], high[1]), slice(low[0], high[0]))
        ridge = np.ascontiguousarray(fold[window])
        cv2.line(ridge, tuple(np.subtract(a, low).tolist()), tuple(np.subtract(b, low).tolist()), 1.0, 3)
        canvas.height[window] += float(rng.choice([-1, 1]) * rng.uniform(0.6, 1.6)) * cv2.blur(ridge, (3, 3))


def _buttons(canvas: Canvas, rng: np.random.Generator) -> None:
    """Stand-offs that hold the blanket, in a loose grid."""
    height, width = canvas.shape
    pitch = float(rng.uniform(70, 120))
    layer = canvas.layer_of(mat.VINYL)
    for v in np.arange(0.3 * pitch, height - 8, pitch):
        for u in np.arange(0.3 * pitch, width - 8, pitch):
            at = tuple(np.rint(np.array([u, v]) + rng.normal(0, 3, 2)).astype(int).tolist())
            cv2.circle(canvas.layer, at, 4, layer, -1)
            cv2.circle(canvas.code, at, 4, code(float(rng.choice([0.03, 0.7]))), -1, cv2.LINE_AA)
            cv2.circle(canvas.code, at, 1, code(0.1), -1)


NAMES = ("STAGE 2", "UPPER STAGE", "POLHODE", "BLOCK 7", "K-3M", "L-14", "NORD", "ALTAIR", "HERPOL", "TS-38")


@drawing
def tank_wall(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """A painted tank: weld rings, stiffeners, black fields, large lettering down the side, a scorched end."""
    canvas.code[:] = code(base)
    _weld_rings(canvas, base, rng)
    if rng.random() < 0.45:
        _corrugation(canvas, rng)
    _livery(canvas, base, rng)
    _doors(canvas, rng)
    marks.stickers(canvas, 2.5e-5, rng)
    marks.smudges(canvas, 0.05, rng, streak=5)
    _scorch(canvas, float(rng.uniform(0.1, 0.3)), rng)
    marks.scratches(canvas, 6e-5, rng)


@drawing
def ring_wall(canvas: Canvas, rng: np.random.Generator, base: float) -> None:
    """An interstage or adapter: stringers, rows of rivets at both rims, holes, labels."""
    height, width = canvas.shape
    canvas.code[:] = code(base)
    pitch = float(rng.uniform(16, 30))
    j = np.arange(width)[None]
    count = max(4, round(width / pitch))
    ridge = np.clip(np.cos(2 * np.pi * j * count / width) * 3.0 - 1.6, 0, 1)
    canvas.height += (1.6 * ridge).astype(np.float32) * np.ones((height, 1), np.float32)
    for v in (3.0, 7.0, height - 4.0, height - 8.0):
        marks.rivets(canvas, np.array([3.0, v]), np.array([width - 3.0, v]), 7.0, 1.5)
    for u in np.arange(40, width - 40, rng.uniform(90, 200)):
        kind = rng.random()
        at = (int(u), int(rng.uniform(0.35, 0.65) * height))
        if kind < 0.4:
            cv2.circle(canvas.code, at, max(2, height // 7), code(0.02), -1, cv2.LINE_AA)
        elif kind < 0.7:
            marks.write(
                canvas,
                str(rng.integers(1, 32)),
                max(6, height // 4),
                np.array(at),
                0.05 if base > 0.2 else 0.7,
            )
    marks.stickers(canvas, 4e-5, rng)
    marks.smudges(canvas, 0.06, rng, streak=3)


@drawing
def nozzle_wall(canvas: Canvas, rng: np.random.Generator) -> None:
    """A nozzle's appearance: fine tubes, stiffening bands, colours of heat."""
    height, width = canvas.shape
    v = np.linspace(0, 1, height)[:, None]
    heat = 0.10 + 0.10 * np.sin(7.0 * v + rng.uniform(0, 3)) * (1 - v) + 0.06 * v
    canvas.code[:] = np.clip(255 * np.sqrt(np.clip(heat, 0.03, 1)), 0, 255).astype(np.uint8)
    j = np.arange(width)[None]
    count = width // int(rng.integers(5, 9))
    canvas.height += (0.8 * np.abs(np.sin(np.pi * j * count / width))).astype(np.float32) * np.ones(
        (height, 1), np.float32
    )
    metal = canvas.layer_of(mat.BRUSHED_METAL)
    for place in np.linspace(0.12, 0.97, int(rng.integers(3, 7))):
        top = int(place * (height - 5))
        marks.fill(canvas, (0, top, width, top + 4), code(0.12), metal)
        canvas.height[top : top + 4] += 2.0
    marks.smudges(canvas, 0.12, rng, streak=4)


@drawing
def reflector(canvas: Canvas, rng: np.random.Generator, base: float, gores: int) -> None:
    """A dish's surface: gores with seams and rivets, targets for photogrammetry, slight dirt."""
    height, width = canvas.shape
    canvas.code[:] = code(base)
    edges = np.linspace(0, width, gores + 1).astype(int)
    for left, right in pairwise(edges.tolist()):
        marks.fill(canvas, (left, 0, right, height), code(base * float(np.exp(rng.normal(0, 0.035)))))
        canvas.tilt[:, left:right] += rng.normal(0, 0.006, 2).astype(np.float32)
        marks.groove(canvas, (left, 0, right, height), 0.5, 0.7)
        for u in (left + 4.0, right - 4.0):
            marks.rivets(canvas, np.array([u, 4.0]), np.array([u, height - 4.0]), 10.0, 1.4)
    for ring in rng.uniform(0.25, 0.8, int(rng.integers(1, 3))):
        v = int(ring * height)
        canvas.code[v : v + 1] = (canvas.code[v : v + 1] * 0.75).astype(np.uint8)
    for v in np.linspace(0.15, 0.95, int(rng.integers(3, 6))) * (height - 1):
        for u in 0.5 * (edges[:-1] + edges[1:])[:: int(rng.integers(1, 3))]:
            cv2.circle(canvas.code, (int(u), int(v)), 3, code(0.04 if base > 0.2 else 0.8), -1, cv2.LINE_AA)
    marks.stickers(canvas, 1e-5, rng)
    marks.smudges(canvas, 0.008, rng)


def _weld_rings(canvas: Canvas, base: float, rng: np.random.Generator) -> None:
    """Rings of welds or rivets that part the wall into courses, and seams between their plates."""
    height, width = canvas.shape
    courses = np.unique(np.rint(np.linspace(0, height, int(rng.integers(3, 6)))).astype(int))
    for top, bottom in pairwise(courses.tolist()):
        edges = np.rint(np.linspace(0, width, int(rng.integers(3, 7))) + rng.uniform(0, width / 8)).astype(
            int
        )
        for left, right in pairwise(edges.tolist()):
            marks.fill(canvas, (left, top, right, bottom), code(base * float(np.exp(rng.normal(0, 0.025)))))
            marks.groove(canvas, (left, top, right, bottom), 0.7, 0.8)
        marks.rivets(canvas, np.array([2.0, top + 4.0]), np.array([width - 2.0, top + 4.0]), 8.0, 1.5)
        marks.rivets(canvas, np.array([2.0, bottom - 4.0]), np.array([width - 2.0, bottom - 4.0]), 8.0, 1.5)


def _corrugation(canvas: Canvas, rng: np.random.Generator) -> None:
    """A band of ribs along the tank."""
    height, width = canvas.shape
    j = np.arange(width)[None]
    count = max(8, round(width / rng.uniform(9, 14)))
    top, bottom = sorted(rng.choice([0.0, 0.33, 0.66, 1.0], 2, replace=False))
    window = slice(int(top * height), int(bottom * height))
    canvas.height[window] += (1.3 * np.cos(2 * np.pi * j * count / width)).astype(np.float32)


def _livery(canvas: Canvas, base: float, rng: np.random.Generator) -> None:
    """Bands, chequers that show the roll angle, and lettering down the side."""
    height, width = canvas.shape
    ink = 0.04 if base > 0.2 else 0.72
    paint = canvas.layer_of(mat.PAINT_WHITE)
    style = rng.integers(4)
    if style == 0:
        band = int(rng.uniform(0.1, 0.2) * height)
        for k in range(8):
            top = int(rng.uniform(0.0, 0.03) * height) + (band if k % 2 else 0)
            marks.fill(canvas, (k * width // 8, top, (k + 1) * width // 8, top + band), code(ink), paint)
    elif style == 1:
        for top in rng.uniform(0.05, 0.9, int(rng.integers(1, 4))):
            wide = rng.uniform(0.015, 0.07)
            marks.fill(canvas, (0, int(top * height), width, int((top + wide) * height)), code(ink), paint)
    elif style == 2:
        for left in (0.0, 0.5):
            marks.fill(
                canvas,
                (int(left * width), 0, int((left + 0.25) * width), int(0.45 * height)),
                code(ink),
                paint,
            )
    name = str(rng.choice(NAMES))
    size = int(min(0.09 * width, 1.1 * height / len(name)))
    start = float(rng.random())
    for share in (start, (start + rng.uniform(0.4, 0.6)) % 1.0):
        canvas.taken.append((share * width, 0.5 * height, 0.2 * height))
        letters = marks.lettering(name, size)
        scale = min(1.0, 0.8 * height / letters.shape[1])
        h, w = letters.shape
        letters = marks.resized(letters, (max(1, round(scale * w)), max(1, round(scale * h))))
        plate = np.full(letters.shape, code(ink), np.uint8)
        marks.stamp(canvas, plate, np.array([share * width, 0.5 * height]), 90.0, letters, paint)
    _emblem(canvas, ink, rng)


def _emblem(canvas: Canvas, ink: float, rng: np.random.Generator) -> None:
    """Fields of stripes and a disc, large enough to tell the sides apart."""
    height, _ = canvas.shape
    paint = canvas.layer_of(mat.PAINT_WHITE)
    for _ in range(2):
        h = int(rng.uniform(0.1, 0.16) * height) + 6
        w = int(1.5 * h)
        plate = np.full((h, w), code(0.7), np.uint8)
        if rng.random() < 0.5:
            for k in range(0, 3, 2):
                plate[k * h // 3 : (k + 1) * h // 3] = code(float(rng.choice([0.05, 0.2, 0.35])))
        else:
            cv2.circle(plate, (w // 2, h // 2), int(0.35 * h), code(ink), -1, cv2.LINE_AA)
        at = canvas.free_place(0.6 * w, rng)
        if at is not None:
            marks.stamp(canvas, plate, at, 0.0, layer=paint)


def _doors(canvas: Canvas, rng: np.random.Generator) -> None:
    """Access doors and umbilical plates with screws around them."""
    for _ in range(int(rng.poisson(1.5e-5 * canvas.area))):
        w, h = rng.uniform((30, 24), (70, 60)).astype(int)
        at = canvas.free_place(0.6 * float(np.hypot(w, h)), rng)
        if at is None:
            continue
        left, top = int(at[0] - w // 2), int(at[1] - h // 2)
        corners = (left, top, left + int(w), top + int(h))
        window = canvas.code[max(top, 0) : top + h, max(left, 0) : left + w]
        window[...] = np.clip(window * float(rng.choice([0.75, 0.92, 1.05])), 0, 255)
        marks.groove(canvas, corners, 1.0, 0.6)
        for u in np.linspace(left + 4, left + w - 4, 4):
            for v in (top + 4.0, top + h - 4.0):
                marks.screw(canvas, np.array([u, v]), 1.6, rng)


def _scorch(canvas: Canvas, reach: float, rng: np.random.Generator) -> None:
    """Soot at the lower end, in streaks."""
    height, width = canvas.shape
    v = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    ragged = np.zeros((1, width), np.float32)
    for texels, strength in ((60, 0.25), (16, 0.2), (4, 0.15)):
        waves = rng.normal(0, strength, (1, max(4, width // texels))).astype(np.float32)
        ragged += np.asarray(cv2.resize(waves, (width, 1), interpolation=cv2.INTER_CUBIC), np.float32)
    amount = np.clip((v - 1.0 + reach * (1.0 + ragged)) / reach, 0, 1) ** 2
    canvas.code[...] = (canvas.code * (1.0 - 0.7 * amount)).astype(np.uint8)
