"""Unrolled walls of the first generator: tanks with their lettering, nozzles, reflectors."""

from itertools import pairwise

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.drawn.marks import (
    fill,
    groove,
    lettering,
    resized,
    rivets,
    scratches,
    screw,
    smudges,
    stamp,
    stickers,
    write,
)
from polhode.simulation.surface.materials import BRUSHED_METAL, PAINT_WHITE

NAMES = ("STAGE 2", "UPPER STAGE", "POLHODE", "BLOCK 7", "K-3M", "L-14", "NORD", "ALTAIR", "HERPOL", "TS-38")


def tank_wall(base: float) -> Draw:
    """A painted tank: weld rings, stiffeners, black fields, large lettering down the side, a scorched end."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        canvas.code[:] = code(base)
        _weld_rings(canvas, base, rng)
        if rng.random() < 0.45:
            _corrugation(canvas, rng)
        _livery(canvas, base, rng)
        _doors(canvas, rng)
        stickers(canvas, 2.5e-5, rng)
        smudges(canvas, 0.05, rng, streak=5)
        _scorch(canvas, float(rng.uniform(0.1, 0.3)), rng)
        scratches(canvas, 6e-5, rng)

    return draw


def ring_wall(base: float) -> Draw:
    """An interstage or adapter: stringers, rows of rivets at both rims, holes, labels."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        pitch = float(rng.uniform(16, 30))
        j = np.arange(width)[None]
        count = max(4, round(width / pitch))
        ridge = np.clip(np.cos(2 * np.pi * j * count / width) * 3.0 - 1.6, 0, 1)
        canvas.height += (1.6 * ridge).astype(np.float32) * np.ones((height, 1), np.float32)
        for v in (3.0, 7.0, height - 4.0, height - 8.0):
            rivets(canvas, np.array([3.0, v]), np.array([width - 3.0, v]), 7.0, 1.5)
        for u in np.arange(40, width - 40, rng.uniform(90, 200)):
            kind = rng.random()
            at = (int(u), int(rng.uniform(0.35, 0.65) * height))
            if kind < 0.4:
                cv2.circle(canvas.code, at, max(2, height // 7), code(0.02), -1, cv2.LINE_AA)
            elif kind < 0.7:
                write(
                    canvas,
                    str(rng.integers(1, 32)),
                    max(6, height // 4),
                    np.array(at),
                    0.05 if base > 0.2 else 0.7,
                )
        stickers(canvas, 4e-5, rng)
        smudges(canvas, 0.06, rng, streak=3)

    return draw


def nozzle_wall() -> Draw:
    """A nozzle's appearance: fine tubes, stiffening bands, colours of heat."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        v = np.linspace(0, 1, height)[:, None]
        heat = 0.10 + 0.10 * np.sin(7.0 * v + rng.uniform(0, 3)) * (1 - v) + 0.06 * v
        canvas.code[:] = np.clip(255 * np.sqrt(np.clip(heat, 0.03, 1)), 0, 255).astype(np.uint8)
        j = np.arange(width)[None]
        count = width // int(rng.integers(5, 9))
        canvas.height += (0.8 * np.abs(np.sin(np.pi * j * count / width))).astype(np.float32) * np.ones(
            (height, 1), np.float32
        )
        metal = canvas.layer_of(BRUSHED_METAL)
        for place in np.linspace(0.12, 0.97, int(rng.integers(3, 7))):
            top = int(place * (height - 5))
            fill(canvas, (0, top, width, top + 4), code(0.12), metal)
            canvas.height[top : top + 4] += 2.0
        smudges(canvas, 0.12, rng, streak=4)

    return draw


def reflector(base: float, gores: int) -> Draw:
    """A dish's surface: gores with seams and rivets, targets for photogrammetry, slight dirt."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(base)
        edges = np.linspace(0, width, gores + 1).astype(int)
        for left, right in pairwise(edges.tolist()):
            fill(canvas, (left, 0, right, height), code(base * float(np.exp(rng.normal(0, 0.035)))))
            canvas.tilt[:, left:right] += rng.normal(0, 0.006, 2).astype(np.float32)
            groove(canvas, (left, 0, right, height), 0.5, 0.7)
            for u in (left + 4.0, right - 4.0):
                rivets(canvas, np.array([u, 4.0]), np.array([u, height - 4.0]), 10.0, 1.4)
        for ring in rng.uniform(0.25, 0.8, int(rng.integers(1, 3))):
            v = int(ring * height)
            canvas.code[v : v + 1] = (canvas.code[v : v + 1] * 0.75).astype(np.uint8)
        for v in np.linspace(0.15, 0.95, int(rng.integers(3, 6))) * (height - 1):
            for u in 0.5 * (edges[:-1] + edges[1:])[:: int(rng.integers(1, 3))]:
                cv2.circle(
                    canvas.code, (int(u), int(v)), 3, code(0.04 if base > 0.2 else 0.8), -1, cv2.LINE_AA
                )
        stickers(canvas, 1e-5, rng)
        smudges(canvas, 0.008, rng)

    return draw


def _weld_rings(canvas: Canvas, base: float, rng: np.random.Generator) -> None:
    """Rings of welds or rivets that part the wall into courses, and seams between their plates."""
    height, width = canvas.shape
    courses = np.unique(np.rint(np.linspace(0, height, int(rng.integers(3, 6)))).astype(int))
    for top, bottom in pairwise(courses.tolist()):
        edges = np.rint(np.linspace(0, width, int(rng.integers(3, 7))) + rng.uniform(0, width / 8)).astype(
            int
        )
        for left, right in pairwise(edges.tolist()):
            fill(canvas, (left, top, right, bottom), code(base * float(np.exp(rng.normal(0, 0.025)))))
            groove(canvas, (left, top, right, bottom), 0.7, 0.8)
        rivets(canvas, np.array([2.0, top + 4.0]), np.array([width - 2.0, top + 4.0]), 8.0, 1.5)
        rivets(canvas, np.array([2.0, bottom - 4.0]), np.array([width - 2.0, bottom - 4.0]), 8.0, 1.5)


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
    paint = canvas.layer_of(PAINT_WHITE)
    style = rng.integers(4)
    if style == 0:
        band = int(rng.uniform(0.1, 0.2) * height)
        for k in range(8):
            top = int(rng.uniform(0.0, 0.03) * height) + (band if k % 2 else 0)
            fill(canvas, (k * width // 8, top, (k + 1) * width // 8, top + band), code(ink), paint)
    elif style == 1:
        for top in rng.uniform(0.05, 0.9, int(rng.integers(1, 4))):
            wide = rng.uniform(0.015, 0.07)
            fill(canvas, (0, int(top * height), width, int((top + wide) * height)), code(ink), paint)
    elif style == 2:
        for left in (0.0, 0.5):
            fill(
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
        letters = lettering(name, size)
        scale = min(1.0, 0.8 * height / letters.shape[1])
        h, w = letters.shape
        letters = resized(letters, (max(1, round(scale * w)), max(1, round(scale * h))))
        plate = np.full(letters.shape, code(ink), np.uint8)
        stamp(canvas, plate, np.array([share * width, 0.5 * height]), 90.0, letters, paint)
    _emblem(canvas, ink, rng)


def _emblem(canvas: Canvas, ink: float, rng: np.random.Generator) -> None:
    """Fields of stripes and a disc, large enough to tell the sides apart."""
    height, _ = canvas.shape
    paint = canvas.layer_of(PAINT_WHITE)
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
            stamp(canvas, plate, at, 0.0, layer=paint)


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
        groove(canvas, corners, 1.0, 0.6)
        for u in np.linspace(left + 4, left + w - 4, 4):
            for v in (top + 4.0, top + h - 4.0):
                screw(canvas, np.array([u, v]), 1.6, rng)


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
