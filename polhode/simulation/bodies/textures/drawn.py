"""The first texture generator: stickers, lettering, seams, rivets (body.texture: drawn).

Flat sheets first, then the unrolled walls of tanks, rings, nozzles and reflectors.
"""

from itertools import pairwise

import cv2
import numpy as np

from polhode.simulation.bodies.textures import drawn_marks as marks
from polhode.simulation.bodies.textures.canvas import Canvas, code, drawing
from polhode.simulation.bodies.textures.drawn_marks import Corners
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

MIN_TILE, MAX_TILE = 34, 150
"""Sides of the plates of a panel."""


@drawing
def panel(c: Canvas, base: float, richness: float = 1.0) -> None:
    """An equipment panel of mean reflectance ``base``: plates of slightly different shade, seams, screws,
    doors, vents, labels; richness scales the number of labels."""
    height, width = c.shape
    c.ground(base)
    for tile in _split((0, 0, width, height), c.rng):
        _plate(c, tile, base)
    marks.stickers(c, richness * 1.4e-4)
    _edge(c)
    marks.smudges(c, 0.02)
    marks.scratches(c, 1.5e-4)


@drawing
def plain(c: Canvas, base: float) -> None:
    """A painted panel with nothing on it but a seam and a few scratches: hard to track, as real ones are."""
    c.ground(base)
    marks.smudges(c, 0.012)
    _edge(c)
    marks.scratches(c, 6e-5)


@drawing
def machined_plate(c: Canvas) -> None:
    """Bare metal: milled pockets, bolt rows, holes, a part number."""
    rng, (height, width) = c.rng, c.shape
    c.ground(0.09, mat.ANODISED if rng.random() < 0.4 else mat.BRUSHED_METAL)
    pitch = int(rng.integers(26, 60))
    for top in range(8, height - pitch, pitch):
        for left in range(8, width - pitch, pitch):
            if rng.random() < 0.75:
                pocket = slice(top + 4, top + pitch - 3), slice(left + 4, left + pitch - 3)
                c.relief[pocket] -= 0.9
                c.code[pocket] = (c.code[pocket] * rng.uniform(0.75, 0.95)).astype(np.uint8)
    c.relief[:] = cv2.GaussianBlur(c.relief, (5, 5), 1.0)
    _edge(c)
    for _ in range(c.count(1.2e-4)):
        at = c.anywhere().astype(int).tolist()
        c.disc(tuple(at), int(rng.integers(1, 5)), 0.01)
    marks.stickers(c, 2e-5)


def _split(tile: Corners, rng: np.random.Generator) -> list[Corners]:
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


def _plate(c: Canvas, tile: Corners, base: float) -> None:
    """One plate of a panel with what is mounted on it: a door, a vent, connectors, tape, paint or rivets."""
    rng, (left, top, right, bottom) = c.rng, tile
    shade = base * float(np.exp(rng.normal(0, 0.07)))
    marks.fill(c, tile, shade)
    marks.groove(c, tile, 0.6)
    if min(right - left, bottom - top) < 20:
        return
    kind = rng.random()
    if kind < 0.22:
        door = (left + 6, top + 6, right - 6, bottom - 6)
        marks.fill(c, door, shade * float(rng.choice([0.8, 1.0, 1.15])))
        marks.groove(c, door, 1.0, 0.6)
        columns = np.linspace(left + 11, right - 11, max(2, (right - left) // 24))
        marks.screws(c, columns, (top + 11, bottom - 11), 1.6)
        size = int(min(0.2 * (bottom - top), 0.12 * (right - left)))
        if size >= 5:
            number = f"{rng.choice(list('ABCDEFGHJKL'))}{rng.integers(10, 99)}"
            middle = (0.5 * (left + right), 0.5 * (top + bottom))
            marks.write(c, number, size, middle, 0.06 if shade > 0.2 else 0.6)
    elif kind < 0.34:
        if rng.random() < 0.5:
            for v in range(top + 8, bottom - 8, 6):
                marks.fill(c, (left + 8, v, right - 8, v + 3), 0.25 * shade)
                c.relief[v : v + 3, left + 8 : right - 8] -= 1.2
        else:
            for v in range(top + 10, bottom - 8, 7):
                for u in range(left + 10, right - 8, 7):
                    c.disc((u, v), 2, 0.25 * shade)
    elif kind < 0.44:
        marks.fill(c, (left + 5, top + 5, right - 5, bottom - 5), 0.05, c.layer_of(mat.PAINT_BLACK))
        metal, radius = c.layer_of(mat.BRUSHED_METAL), int(rng.integers(4, 8))
        for v in range(top + radius + 8, bottom - radius - 6, 2 * radius + 5):
            for u in range(left + radius + 8, right - radius - 6, 2 * radius + 5):
                c.disc((u, v), radius, 0.3, metal)
                c.disc((u, v), radius - 2, 0.02, 0)
                c.disc((u, v), 1, 0.4)
    elif kind < 0.52:
        layer, across = c.layer_of(mat.TAPE), rng.random() < 0.5
        for _ in range(int(rng.integers(1, 3))):
            wide = int(rng.integers(5, 12))
            if across:
                v = int(rng.integers(top + 2, max(top + 3, bottom - wide)))
                strip = (left + 3, v, right - 3, v + wide)
            else:
                u = int(rng.integers(left + 2, max(left + 3, right - wide)))
                strip = (u, top + 3, u + wide, bottom - 3)
            marks.fill(c, strip, 0.1, layer)
            c.relief[strip[1] : strip[3], strip[0] : strip[2]] += 0.4
    elif kind < 0.58:
        marks.fill(c, (left + 1, top + 1, right, bottom), float(rng.choice([0.05, 0.1, 0.6, 0.75])))
    elif kind < 0.75:
        for v in (top + 5, bottom - 5):
            marks.rivets(c, (left + 5.0, v), (right - 5.0, v), 9.0, 1.7)


def _edge(c: Canvas) -> None:
    """A row of screws along the edges of a sheet, where there is room."""
    height, width = c.shape
    if min(height, width) >= 60:
        inset, pitch = 7.0, float(c.rng.uniform(32, 56))
        columns = np.linspace(inset, width - inset, max(2, int(width / pitch)))
        rows = np.linspace(inset, height - inset, max(2, int(height / pitch)))[1:-1]
        marks.screws(c, columns, (inset, height - inset), 2.0)
        for v in rows:
            marks.screws(c, (inset, width - inset), [v], 2.0)


@drawing
def cells(c: Canvas, cell: int = 60) -> None:
    """Strings of cells, ``cell`` texels long, with cut corners, on a substrate with wires and hold-downs."""
    rng, (height, width) = c.rng, c.shape
    c.ground(float(rng.choice([0.09, 0.16, 0.5])), mat.PAINT_WHITE)
    glass, metal = c.layer_of(mat.SOLAR_CELL), c.layer_of(mat.BRUSHED_METAL)
    margin = max(3, cell // 14)
    long, short = cell, max(6, int(cell * rng.choice([0.5, 0.55, 0.98])))
    if rng.random() < 0.5:
        long, short = short, long
    gap = max(1, cell // 40)
    columns, rows = (max(1, round((n - 2 * margin) / side)) for n, side in ((width, long), (height, short)))
    lefts = np.linspace(margin, width - margin, columns + 1).astype(int)
    tops = np.linspace(margin, height - margin, rows + 1).astype(int)
    cut = int(0.13 * min(long, short)) if rng.random() < 0.8 else 0
    tone = float(rng.uniform(0.025, 0.05))
    string = int(rng.integers(3, 7))
    for row in range(rows):
        for column in range(columns):
            # A wider gap parts the strings.
            wide = gap + (2 * gap if (column + 1) % string == 0 and column + 1 < columns else 0)
            corners = (lefts[column], tops[row], lefts[column + 1] - wide, tops[row + 1] - gap)
            if corners[2] - corners[0] > 3 and corners[3] - corners[1] > 3:
                _cell(c, corners, cut, tone, glass, metal)
    if min(height, width) >= 80:
        for v in (0.25, 0.75):
            for u in (0.3, 0.7):
                at, radius = (int(u * width), int(v * height)), int(rng.integers(7, 11))
                c.disc(at, radius, 0.35, metal)
                c.disc(at, max(2, radius // 2), 0.03)
        marks.border(c, max(2, min(height, width) // 90), 0.25, metal)
    marks.stickers(c, 1.2e-5)


def _cell(c: Canvas, corners: Corners, cut: int, tone: float, glass: int, metal: int) -> None:
    """One cell: dark glass with its own tilt and tone, bright tabs on one side; some replaced or cracked."""
    rng, (left, top, right, bottom) = c.rng, corners
    outline = np.array([
        (left + cut, top), (right - cut, top), (right, top + cut), (right, bottom - cut),
        (right - cut, bottom), (left + cut, bottom), (left, bottom - cut), (left, top + cut),
    ])  # fmt: skip
    own = tone * float(np.exp(rng.normal(0, 0.16)))
    if rng.random() < 0.03:
        own *= 2.2
    cv2.fillPoly(c.code, [outline], code(own))
    cv2.fillPoly(c.layer, [outline], glass)
    # Each glints at its own moment.
    c.tilt[top:bottom, left:right] = rng.normal(0, 0.012, 2)
    for share in (0.2, 0.5, 0.8):
        u = left + int(share * (right - left))
        marks.fill(c, (u - 1, bottom - 1, u + 2, bottom + 2), 0.3, metal)
    if bottom - top > 20:
        c.code[(top + bottom) // 2, left + 2 : right - 2] = code(own + 0.03)
    if rng.random() < 0.02:
        a, b = rng.uniform((left, top), (right, bottom), (2, 2)).astype(int).tolist()
        cv2.line(c.code, tuple(a), tuple(b), code(0.12), 1, cv2.LINE_AA)


@drawing
def radiator(c: Canvas) -> None:
    """A heat radiator: small mirror tiles, each a little askew, or white paint over heat pipes."""
    rng, (height, width) = c.rng, c.shape
    if rng.random() < 0.55:
        c.ground(0.35)
        layer, tile = c.layer_of(mat.MIRROR), int(rng.integers(20, 34))
        for top in range(4, height - 4, tile + 1):
            for left in range(4, width - 4, tile + 1):
                window = (slice(top, min(top + tile, height - 4)), slice(left, min(left + tile, width - 4)))
                c.code[window] = code(float(rng.uniform(0.02, 0.05)))
                c.layer[window] = layer
                c.tilt[window] = rng.normal(0, 0.008, 2)
    else:
        c.ground(0.76, mat.PAINT_WHITE)
        marks.smudges(c, 0.02)
        pitch = int(rng.integers(40, 80))
        for v in range(pitch // 2, height, pitch):
            c.relief += (2.5 * np.exp(-(((np.arange(height)[:, None] - v) / 7.0) ** 2))).astype(np.float32)
            for side in (-11, 11):
                marks.rivets(c, (6.0, v + side), (width - 6.0, v + side), 14.0, 1.6)
        marks.stickers(c, 4e-5)
    if min(height, width) > 60:
        for row in (9.0, height - 9.0):
            marks.screws(c, (9.0, width - 9.0), [row], 3.0)


@drawing
def blanket(c: Canvas, foil: Material) -> None:
    """A blanket of a foil: sheets that overlap, quilting, sharp folds, under tape, buttons and labels."""
    rng, (height, width) = c.rng, c.shape
    c.ground(foil.albedo, foil)
    tape = c.layer_of(mat.TAPE)
    # Seams of tape where the sheets overlap, none quite straight.
    for along, across in ((width, height), (height, width)):
        for place in np.arange(rng.uniform(60, 160), across, rng.uniform(110, 220)):
            wide = int(rng.integers(7, 13))
            start, end = (place + rng.normal(0, 4, 2)).tolist()
            line = np.array([[0, start], [along, end], [along, end + wide], [0, start + wide]])
            points = [np.rint(line if along == width else line[:, ::-1]).astype(np.int32)]
            cover = np.zeros(c.shape, np.uint8)
            cv2.fillPoly(cover, points, 1)
            on = cover > 0
            c.code[on] = code(float(rng.uniform(0.08, 0.16)))
            c.layer[on] = tape
            c.relief[on] += 0.6
    # Pillows between rows of stitches.
    pitch = rng.uniform(48, 90)
    i, j = np.mgrid[:height, :width].astype(np.float32)
    turn = rng.normal(0, 0.06)
    u = (np.cos(turn) * j + np.sin(turn) * i) / pitch + rng.random()
    v = (np.cos(turn) * i - np.sin(turn) * j) / pitch + rng.random()
    pillow = np.sqrt(np.abs(np.sin(np.pi * u) * np.sin(np.pi * v)))
    c.relief += (rng.uniform(2.0, 5.0) * pillow).astype(np.float32)
    _pull_lines(c)
    # Stand-offs that hold the blanket, in a loose grid.
    pitch, layer = float(rng.uniform(70, 120)), c.layer_of(mat.VINYL)
    for v in np.arange(0.3 * pitch, height - 8, pitch):
        for u in np.arange(0.3 * pitch, width - 8, pitch):
            at = tuple(np.rint(np.array([u, v]) + rng.normal(0, 3, 2)).astype(int).tolist())
            c.disc(at, 4, float(rng.choice([0.03, 0.7])), layer)
            cv2.circle(c.code, at, 1, code(0.1), -1)
    marks.stickers(c, 2.2e-5, askew_deg=8.0)
    marks.border(c, max(3, min(height, width) // 60), 0.12, tape)


def _pull_lines(c: Canvas) -> None:
    """Sharp folds that run out from where the blanket is held."""
    rng = c.rng
    for _ in range(c.count(1.5e-4)):
        start, angle = c.anywhere(), rng.uniform(0, 2 * np.pi)
        end = start + rng.uniform(20, 90) * np.array([np.cos(angle), np.sin(angle)])
        a, b = (tuple(np.rint(p).astype(int).tolist()) for p in (start, end))
        low = np.maximum(np.minimum(a, b) - 6, 0)
        high = np.minimum(np.maximum(a, b) + 7, c.shape[::-1])
        if (high > low).all():
            ridge = np.zeros((high - low)[::-1], np.float32)
            cv2.line(ridge, tuple(np.subtract(a, low).tolist()), tuple(np.subtract(b, low).tolist()), 1.0, 3)
            height = float(rng.choice([-1, 1]) * rng.uniform(0.6, 1.6))
            c.relief[low[1] : high[1], low[0] : high[0]] += height * cv2.blur(ridge, (3, 3))


@drawing
def tank_wall(c: Canvas, base: float) -> None:
    """The unrolled wall of a tank, its aft end below: weld rings, stiffeners, black fields, large lettering
    down the side, a scorched end."""
    rng, (height, width) = c.rng, c.shape
    c.ground(base)
    # Rings of welds or rivets part the wall into courses, seams part their plates.
    courses = np.unique(np.rint(np.linspace(0, height, int(rng.integers(3, 6)))).astype(int))
    for top, bottom in pairwise(courses.tolist()):
        edges = np.linspace(0, width, int(rng.integers(3, 7))) + rng.uniform(0, width / 8)
        for left, right in pairwise(np.rint(edges).astype(int).tolist()):
            marks.fill(c, (left, top, right, bottom), base * float(np.exp(rng.normal(0, 0.025))))
            marks.groove(c, (left, top, right, bottom), 0.7, 0.8)
        for v in (top + 4.0, bottom - 4.0):
            marks.rivets(c, (2.0, v), (width - 2.0, v), 8.0, 1.5)
    if rng.random() < 0.45:
        count = max(8, round(width / rng.uniform(9, 14)))
        low, high = sorted(rng.choice([0.0, 0.33, 0.66, 1.0], 2, replace=False))
        ribs = (1.3 * np.cos(2 * np.pi * np.arange(width)[None] * count / width)).astype(np.float32)
        c.relief[int(low * height) : int(high * height)] += ribs
    _livery(c, 0.04 if base > 0.2 else 0.72)
    _doors(c)
    marks.stickers(c, 2.5e-5)
    marks.smudges(c, 0.05, streak=5)
    # Soot at the lower end, in streaks.
    reach = float(rng.uniform(0.1, 0.3))
    ragged = np.zeros((1, width), np.float32)
    for texels, strength in ((60, 0.25), (16, 0.2), (4, 0.15)):
        waves = rng.normal(0, strength, (1, max(4, width // texels))).astype(np.float32)
        ragged += np.asarray(cv2.resize(waves, (width, 1), interpolation=cv2.INTER_CUBIC), np.float32)
    down = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    amount = np.clip((down - 1.0 + reach * (1.0 + ragged)) / reach, 0, 1) ** 2
    c.code[...] = (c.code * (1.0 - 0.7 * amount)).astype(np.uint8)
    marks.scratches(c, 6e-5)


def _livery(c: Canvas, ink: float) -> None:
    """Bands, chequers that show the roll angle, lettering down the side, emblems."""
    rng, (height, width) = c.rng, c.shape
    paint = c.layer_of(mat.PAINT_WHITE)
    style = rng.integers(4)
    if style == 0:
        band = int(rng.uniform(0.1, 0.2) * height)
        for k in range(8):
            top = int(rng.uniform(0.0, 0.03) * height) + (band if k % 2 else 0)
            marks.fill(c, (k * width // 8, top, (k + 1) * width // 8, top + band), ink, paint)
    elif style == 1:
        for top in rng.uniform(0.05, 0.9, int(rng.integers(1, 4))):
            wide = rng.uniform(0.015, 0.07)
            marks.fill(c, (0, int(top * height), width, int((top + wide) * height)), ink, paint)
    elif style == 2:
        for left in (0.0, 0.5):
            field = (int(left * width), 0, int((left + 0.25) * width), int(0.45 * height))
            marks.fill(c, field, ink, paint)
    names = (
        "STAGE 2",
        "UPPER STAGE",
        "POLHODE",
        "BLOCK 7",
        "K-3M",
        "L-14",
        "NORD",
        "ALTAIR",
        "HERPOL",
        "TS-38",
    )
    name = str(rng.choice(names))
    size = int(min(0.09 * width, 1.1 * height / len(name)))
    start = float(rng.random())
    for share in (start, (start + rng.uniform(0.4, 0.6)) % 1.0):
        c.taken.append((share * width, 0.5 * height, 0.2 * height))
        letters = marks.lettering(name, size)
        scale = min(1.0, 0.8 * height / letters.shape[1])
        h, w = letters.shape
        letters = marks.resized(letters, (max(1, round(scale * w)), max(1, round(scale * h))))
        plate = np.full(letters.shape, code(ink), np.uint8)
        marks.stamp(c, plate, (share * width, 0.5 * height), 90.0, letters, paint)
    # Fields of stripes or a disc, large enough to tell the sides apart.
    for _ in range(2):
        h = int(rng.uniform(0.1, 0.16) * height) + 6
        w = int(1.5 * h)
        plate = np.full((h, w), code(0.7), np.uint8)
        if rng.random() < 0.5:
            for k in range(0, 3, 2):
                plate[k * h // 3 : (k + 1) * h // 3] = code(float(rng.choice([0.05, 0.2, 0.35])))
        else:
            cv2.circle(plate, (w // 2, h // 2), int(0.35 * h), code(ink), -1, cv2.LINE_AA)
        at = marks.free_place(c, 0.6 * w)
        if at is not None:
            marks.stamp(c, plate, at, 0.0, layer=paint)


def _doors(c: Canvas) -> None:
    """Access doors and umbilical plates with screws around them."""
    for _ in range(c.count(1.5e-5)):
        w, h = c.rng.uniform((30, 24), (70, 60)).astype(int).tolist()
        at = marks.free_place(c, 0.6 * float(np.hypot(w, h)))
        if at is not None:
            left, top = int(at[0] - w // 2), int(at[1] - h // 2)
            window = c.code[max(top, 0) : top + h, max(left, 0) : left + w]
            window[...] = np.clip(window * float(c.rng.choice([0.75, 0.92, 1.05])), 0, 255)
            marks.groove(c, (left, top, left + w, top + h), 1.0, 0.6)
            marks.screws(c, np.linspace(left + 4, left + w - 4, 4), (top + 4.0, top + h - 4.0), 1.6)


@drawing
def ring_wall(c: Canvas, base: float) -> None:
    """The unrolled wall of an interstage or adapter: stringers, rivets at both rims, holes, labels."""
    rng, (height, width) = c.rng, c.shape
    c.ground(base)
    count = max(4, round(width / float(rng.uniform(16, 30))))
    ridge = np.clip(np.cos(2 * np.pi * np.arange(width)[None] * count / width) * 3.0 - 1.6, 0, 1)
    c.relief += (1.6 * ridge).astype(np.float32)
    for v in (3.0, 7.0, height - 4.0, height - 8.0):
        marks.rivets(c, (3.0, v), (width - 3.0, v), 7.0, 1.5)
    for u in np.arange(40, width - 40, rng.uniform(90, 200)):
        kind = rng.random()
        at = (int(u), int(rng.uniform(0.35, 0.65) * height))
        if kind < 0.4:
            c.disc(at, max(2, height // 7), 0.02)
        elif kind < 0.7:
            marks.write(c, str(rng.integers(1, 32)), max(6, height // 4), at, 0.05 if base > 0.2 else 0.7)
    marks.stickers(c, 4e-5)
    marks.smudges(c, 0.06, streak=3)


@drawing
def nozzle_wall(c: Canvas) -> None:
    """The unrolled wall of a nozzle: fine tubes, stiffening bands, colours of heat."""
    rng, (height, width) = c.rng, c.shape
    v = np.linspace(0, 1, height)[:, None]
    heat = 0.10 + 0.10 * np.sin(7.0 * v + rng.uniform(0, 3)) * (1 - v) + 0.06 * v
    c.code[:] = np.clip(255 * np.sqrt(np.clip(heat, 0.03, 1)), 0, 255).astype(np.uint8)
    count = width // int(rng.integers(5, 9))
    c.relief += (0.8 * np.abs(np.sin(np.pi * np.arange(width)[None] * count / width))).astype(np.float32)
    metal = c.layer_of(mat.BRUSHED_METAL)
    for place in np.linspace(0.12, 0.97, int(rng.integers(3, 7))):
        top = int(place * (height - 5))
        marks.fill(c, (0, top, width, top + 4), 0.12, metal)
        c.relief[top : top + 4] += 2.0
    marks.smudges(c, 0.12, streak=4)


@drawing
def reflector(c: Canvas, base: float, gores: int) -> None:
    """The unrolled face of a dish: gores with seams and rivets, targets for photogrammetry, slight dirt."""
    rng, (height, width) = c.rng, c.shape
    c.ground(base)
    edges = np.linspace(0, width, gores + 1).astype(int)
    for left, right in pairwise(edges.tolist()):
        marks.fill(c, (left, 0, right, height), base * float(np.exp(rng.normal(0, 0.035))))
        c.tilt[:, left:right] += rng.normal(0, 0.006, 2).astype(np.float32)
        marks.groove(c, (left, 0, right, height), 0.5, 0.7)
        for u in (left + 4.0, right - 4.0):
            marks.rivets(c, (u, 4.0), (u, height - 4.0), 10.0, 1.4)
    for ring in rng.uniform(0.25, 0.8, int(rng.integers(1, 3))):
        v = int(ring * height)
        c.code[v : v + 1] = (c.code[v : v + 1] * 0.75).astype(np.uint8)
    for v in np.linspace(0.15, 0.95, int(rng.integers(3, 6))) * (height - 1):
        for u in 0.5 * (edges[:-1] + edges[1:])[:: int(rng.integers(1, 3))]:
            c.disc((int(u), int(v)), 3, 0.04 if base > 0.2 else 0.8)
    marks.stickers(c, 1e-5)
    marks.smudges(c, 0.008)
