"""Foil blankets of the first generator: overlapping sheets, tape along the seams, quilting, buttons."""

import cv2
import numpy as np

from polhode.simulation.bodies.textures.canvas import Canvas, Draw, code
from polhode.simulation.bodies.textures.drawn.labels import sticker
from polhode.simulation.bodies.textures.drawn.marks import fill
from polhode.simulation.surface.materials import TAPE, VINYL, Material


def blanket(foil: Material) -> Draw:
    """Foil in sheets, under tape, buttons and labels."""

    def draw(canvas: Canvas, rng: np.random.Generator) -> None:
        height, width = canvas.shape
        canvas.code[:] = code(foil.albedo)
        canvas.layer[:] = canvas.layer_of(foil)
        _sheets(canvas, rng)
        _quilting(canvas, rng)
        _pull_lines(canvas, rng)
        _buttons(canvas, rng)
        for _ in range(int(rng.poisson(2.2e-5 * canvas.area))):
            sticker(canvas, rng, askew_deg=8.0)
        edge = max(3, min(height, width) // 60)
        tape = canvas.layer_of(TAPE)
        for corners in ((0, 0, width, edge), (0, height - edge, width, height), (0, 0, edge, height),
                        (width - edge, 0, width, height)):  # fmt: skip
            fill(canvas, corners, code(0.12), tape)

    return draw


def _sheets(canvas: Canvas, rng: np.random.Generator) -> None:
    """Seams of tape where the sheets overlap, none quite straight."""
    height, width = canvas.shape
    tape = canvas.layer_of(TAPE)
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
    layer = canvas.layer_of(VINYL)
    for v in np.arange(0.3 * pitch, height - 8, pitch):
        for u in np.arange(0.3 * pitch, width - 8, pitch):
            at = tuple(np.rint(np.array([u, v]) + rng.normal(0, 3, 2)).astype(int).tolist())
            cv2.circle(canvas.layer, at, 4, layer, -1)
            cv2.circle(canvas.code, at, 4, code(float(rng.choice([0.03, 0.7]))), -1, cv2.LINE_AA)
            cv2.circle(canvas.code, at, 1, code(0.1), -1)
