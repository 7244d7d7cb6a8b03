"""Lettering and stickers of the first generator."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from polhode.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code
from polhode.simulation.bodies.textures.drawn.marks import stamp
from polhode.simulation.surface.materials import VINYL

WORDS = (
    "CAUTION", "VENT", "LIFT HERE", "HOT", "S/N", "PORT", "REV C", "NO STEP", "ARM", "FILL", "J4", "GND",
    "REMOVE BEFORE FLIGHT", "P/N", "HINGE", "AFT", "FWD", "UMB", "TEST", "OPEN", "LOX", "GN2", "28 V", "RCS",
)  # fmt: skip
PAPERS = (0.06, 0.12, 0.3, 0.5, 0.68, 0.8)
"""Reflectances of stickers."""


@lru_cache(maxsize=64)
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def lettering(text: str, height: int, bold: bool = True) -> NDArray[np.float32]:
    """Opacity (h, w) in [0, 1] of a line of text whose capitals are about ``height`` texels tall."""
    size = max(6, round(1.3 * height))
    stroke = max(1, size // 22) if bold else 0
    left, top, right, bottom = _font(size).getbbox(text, stroke_width=stroke)
    sheet = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
    at = (1 - left, 1 - top)
    ImageDraw.Draw(sheet).text(at, text, fill=255, font=_font(size), stroke_width=stroke)
    return np.asarray(sheet, dtype=np.float32) / np.float32(255)


def resized(letters: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """The letters at another width and height."""
    return np.asarray(cv2.resize(letters, size, interpolation=cv2.INTER_AREA), np.float32)


def write(
    canvas: Canvas, text: str, height: int, centre: Array, reflectance: float, turn_deg: float = 0.0
) -> None:
    """Painted lettering, its middle at ``centre``."""
    letters = lettering(text, height)
    stamp(canvas, np.full(letters.shape, code(reflectance), np.uint8), centre, turn_deg, letters)


def random_text(rng: np.random.Generator) -> str:
    """A word of the kind that is found on hardware, with a number."""
    return f"{rng.choice(WORDS)} {rng.integers(1, 1000)}"


def sticker(canvas: Canvas, rng: np.random.Generator, askew_deg: float = 3.0) -> None:
    """One label anywhere on the canvas: text, bars, matrix code, hazard stripes, arrow, roundel or target."""
    height, width = canvas.shape
    size = np.array([1.0, rng.uniform(0.4, 0.8)]) * np.exp(rng.uniform(np.log(22), np.log(86)))
    w, h = np.minimum(size, 0.8 * np.array([width, height])).astype(int) + 4
    paper = float(rng.choice(PAPERS))
    ink = float(np.clip(paper + (0.55 if paper < 0.35 else -0.5) * rng.uniform(0.7, 1.1), 0.04, 0.85))
    kind = int(rng.choice(7, p=[0.34, 0.16, 0.12, 0.05, 0.05, 0.08, 0.2]))
    drawer = (_label, _bars, _matrix, _hazard, _arrow, _roundel, _two_tone)[kind]
    plate = drawer(int(h), int(w), code(paper), code(ink), rng)
    if rng.random() < 0.6:
        cv2.rectangle(plate, (0, 0), (plate.shape[1] - 1, plate.shape[0] - 1), code(ink), 1)
    turn = float(rng.choice([0.0, 90.0, 180.0, 270.0], p=[0.55, 0.2, 0.05, 0.2]) + rng.normal(0, askew_deg))
    centre = canvas.free_place(0.4 * float(np.hypot(*plate.shape)), rng)
    if centre is None:
        return
    stamp(canvas, plate, centre, turn, layer=canvas.layer_of(VINYL), lift=0.25)


def _label(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """One to three lines of text."""
    plate = np.full((h, w), paper, np.uint8)
    lines = int(rng.integers(1, 4)) if h > 24 else 1
    for line in range(lines):
        letters = lettering(random_text(rng), max(5, int(0.6 * h / lines)), bold=lines == 1)
        scale = min(1.0, 0.88 * w / letters.shape[1], 0.9 * h / lines / letters.shape[0])
        size = (max(2, int(scale * letters.shape[1])), max(2, int(scale * letters.shape[0])))
        letters = resized(letters, size)
        top = int((line + 0.5) * h / lines - 0.5 * size[1])
        left = max(0, (w - size[0]) // 2 if lines == 1 else int(0.06 * w))
        window = plate[max(top, 0) : top + size[1], left : left + size[0]]
        share = letters[: window.shape[0], : window.shape[1]]
        window[...] = np.rint(window + share * (np.float32(ink) - window))
    return plate


def _bars(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """A bar code with its number below."""
    plate = np.full((h, w), paper, np.uint8)
    edges = np.cumsum(rng.integers(1, 5, w))
    for a, b in zip(edges[::2], edges[1::2], strict=False):
        if b < w - 2:
            plate[max(1, h // 8) : max(3, int(0.7 * h)), a:b] = ink
    return plate


def _matrix(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """A square matrix code."""
    side = max(10, min(h, w))
    cells = (rng.random((10, 10)) < 0.5).astype(np.uint8)
    cells[:, 0], cells[-1, :] = 1, 1
    inner = cv2.resize(cells, (side - 4, side - 4), interpolation=cv2.INTER_NEAREST)
    plate = np.full((side, side), paper, np.uint8)
    plate[2:-2, 2:-2] = np.where(inner > 0, ink, paper)
    return plate


def _hazard(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """Slanted stripes."""
    h = max(8, h // 2)
    i, j = np.mgrid[:h, :w]
    period = int(rng.integers(8, 16))
    return np.where((i + j) % period < period // 2, ink, paper).astype(np.uint8)


def _arrow(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    plate = np.full((h, w), paper, np.uint8)
    tip = 0.9 if rng.random() < 0.5 else 0.1
    tail, neck = 1.0 - tip, 0.5 + 0.3 * (0.5 - tip)
    cv2.line(plate, (int(tail * w), h // 2), (int(tip * w), h // 2), ink, max(2, h // 6), cv2.LINE_AA)
    points = np.array([[tip * w, 0.5 * h], [neck * w + 0.2 * (tip - 0.5) * w, 0.15 * h],
                       [neck * w + 0.2 * (tip - 0.5) * w, 0.85 * h]])  # fmt: skip
    cv2.fillPoly(plate, [np.rint(points).astype(np.int32)], ink, cv2.LINE_AA)
    return plate


def _roundel(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """Rings, quarters or a cross: the marks that cameras aim at."""
    side = max(10, min(h, w))
    plate = np.full((side, side), paper, np.uint8)
    middle, radius = (side // 2, side // 2), int(0.42 * side)
    cv2.circle(plate, middle, radius, ink, -1, cv2.LINE_AA)
    kind = rng.integers(3)
    if kind == 0:
        cv2.circle(plate, middle, int(0.6 * radius), paper, -1, cv2.LINE_AA)
        cv2.circle(plate, middle, int(0.3 * radius), ink, -1, cv2.LINE_AA)
    elif kind == 1:
        for start in (0, 180):
            cv2.ellipse(plate, middle, (radius - 1, radius - 1), 0, start, start + 90, paper, -1, cv2.LINE_AA)
    else:
        cv2.line(plate, (side // 2, 2), (side // 2, side - 3), paper, 2)
        cv2.line(plate, (2, side // 2), (side - 3, side // 2), paper, 2)
    return plate


def _two_tone(h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """A type plate: a dark head with a word, lines of small print below."""
    plate = np.full((h, w), paper, np.uint8)
    head = max(6, int(0.4 * h))
    plate[:head] = ink
    letters = lettering(str(rng.choice(WORDS)), max(4, int(0.5 * head)))
    size = (min(letters.shape[1], int(0.9 * w)), min(letters.shape[0], head))
    letters = resized(letters, size)
    window = plate[: size[1], 2 : 2 + size[0]]
    letters = letters[: window.shape[0], : window.shape[1]]
    window[...] = np.rint(window + letters * (np.float32(paper) - window))
    for row in range(head + 3, h - 2, 4):
        plate[row, 3 : 3 + int(rng.uniform(0.4, 0.9) * w)] = (ink + paper) // 2
    return plate
