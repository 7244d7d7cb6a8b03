"""Marks of the drawn textures: lettering, stickers, relief, screws, rivets, scratches."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from polhode.geometry.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code, code
from polhode.simulation.surface.materials import BRUSHED_METAL, VINYL

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


def stickers(canvas: Canvas, per_texel: float, rng: np.random.Generator, askew_deg: float = 3.0) -> None:
    """Labels anywhere on the canvas, of a mean density."""
    for _ in range(int(rng.poisson(per_texel * canvas.area))):
        sticker(canvas, rng, askew_deg)


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


def stamp(
    canvas: Canvas,
    plate: Code,
    centre: Array,
    turn_deg: float = 0.0,
    cover: NDArray[np.float32] | None = None,
    layer: int | None = None,
    lift: float = 0.0,
) -> None:
    """Lay a plate (h, w) onto the canvas, turned, its middle at ``centre`` (column, row).

    cover (h, w) in [0, 1] is the plate's opacity; lift is its thickness in texels.
    """
    h, w = plate.shape
    reach = int(np.ceil(0.5 * np.hypot(h, w))) + 2
    left, top = (np.floor(centre).astype(int) - reach).tolist()
    size = 2 * reach + 1
    M = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), turn_deg, 1.0)
    M[:, 2] += np.asarray(centre) - (left, top) - np.array([(w - 1) / 2, (h - 1) / 2])
    opaque = np.ones((h, w), np.float32) if cover is None else cover
    turned = cv2.warpAffine(opaque, M, (size, size))
    laid = cv2.warpAffine(plate, M, (size, size), borderMode=cv2.BORDER_REPLICATE)
    height, width = canvas.shape
    rows = slice(max(top, 0), min(top + size, height))
    columns = slice(max(left, 0), min(left + size, width))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return
    inner = (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
    share, under = np.asarray(turned[inner], np.float32), canvas.code[rows, columns]
    canvas.code[rows, columns] = np.rint(under + share * (laid[inner].astype(np.float32) - under))
    if layer is not None:
        canvas.layer[rows, columns][share > 0.5] = layer
    if lift:
        canvas.height[rows, columns] += np.float32(lift) * share


def fill(canvas: Canvas, corners: tuple[int, int, int, int], value: int, layer: int | None = None) -> None:
    """Fill the rectangle (left, top, right, bottom)."""
    left, top, right, bottom = corners
    canvas.code[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = value
    if layer is not None:
        canvas.layer[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = layer


def border(canvas: Canvas, width: int, value: int, layer: int) -> None:
    """Fill a border of a width in texels along the edges of the canvas."""
    h, w = canvas.shape
    for corners in ((0, 0, w, width), (0, h - width, w, h), (0, 0, width, h), (w - width, 0, w, h)):
        fill(canvas, corners, value, layer)


def groove(canvas: Canvas, corners: tuple[int, int, int, int], depth: float, darker: float = 0.75) -> None:
    """A rectangular seam, one texel wide, dark and sunk."""
    left, top, right, bottom = corners
    height, width = canvas.shape
    left, right = max(left, 0), min(right, width - 1)
    top, bottom = max(top, 0), min(bottom, height - 1)
    if left >= right or top >= bottom:
        return
    for part in (
        (slice(top, top + 1), slice(left, right + 1)),
        (slice(bottom, bottom + 1), slice(left, right + 1)),
        (slice(top, bottom + 1), slice(left, left + 1)),
        (slice(top, bottom + 1), slice(right, right + 1)),
    ):
        canvas.code[part] = (canvas.code[part] * darker).astype(np.uint8)
        canvas.height[part] -= np.float32(depth)


def dome(canvas: Canvas, centre: Array, radius: float, height: float) -> None:
    """A rivet's round head."""
    head = _head(radius, height)
    reach = len(head) // 2
    u, v = round(float(centre[0])), round(float(centre[1]))
    left, top = max(u - reach, 0), max(v - reach, 0)
    window = canvas.height[top : v + reach + 1, left : u + reach + 1]
    if window.size > 0 and v + reach >= 0 and u + reach >= 0:
        i, j = top - v + reach, left - u + reach
        window += head[i : i + window.shape[0], j : j + window.shape[1]]


@lru_cache(maxsize=64)
def _head(radius: float, height: float) -> NDArray[np.float32]:
    """Relief of a round head in the middle of a square."""
    reach = int(np.ceil(radius)) + 1
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(height * np.sqrt(np.clip(1.0 - (i * i + j * j) / radius**2, 0.0, None)), np.float32)


def screw(canvas: Canvas, centre: Array, radius: float, rng: np.random.Generator) -> None:
    """A bare metal screw head with a dark slot."""
    at = (round(float(centre[0])), round(float(centre[1])))
    layer = canvas.layer_of(BRUSHED_METAL)
    r = max(1, round(radius))
    cv2.circle(canvas.layer, at, r, layer, -1)
    cv2.circle(canvas.code, at, r + 1, int(rng.integers(30, 60)), 1, cv2.LINE_AA)
    cv2.circle(canvas.code, at, r, int(rng.integers(70, 130)), -1, cv2.LINE_AA)
    dome(canvas, centre, radius + 0.5, 0.5 * radius)
    angle = rng.uniform(0, np.pi)
    reach = np.array([np.cos(angle), np.sin(angle)]) * 0.7 * radius
    a, b = (tuple(np.rint(centre + side * reach).astype(int).tolist()) for side in (-1, 1))
    cv2.line(canvas.code, a, b, 30, 1, cv2.LINE_AA)


def rivets(canvas: Canvas, start: Array, end: Array, pitch: float, radius: float) -> None:
    """A straight row of rivets."""
    count = max(2, int(np.linalg.norm(np.subtract(end, start)) / pitch))
    height, width = canvas.shape
    for at in np.linspace(start, end, count):
        if radius < at[0] < width - radius and radius < at[1] < height - radius:
            dome(canvas, at, radius, 0.45 * radius)
            v, u = int(at[1]), int(at[0])
            canvas.code[v, u] = min(255, int(canvas.code[v, u] * 1.06))


def scratches(canvas: Canvas, per_texel: float, rng: np.random.Generator, length: float = 14.0) -> None:
    """Thin bright and dark lines in any direction."""
    height, width = canvas.shape
    for _ in range(int(rng.poisson(per_texel * canvas.area))):
        start = rng.uniform((0, 0), (width, height))
        end = start + rng.normal(0, length, 2)
        a, b = (tuple(p.astype(int).tolist()) for p in (start, end))
        u, v = (int(np.clip(x, 0, n - 1)) for x, n in zip(a, (width, height), strict=True))
        cv2.line(
            canvas.code, a, b, min(int(canvas.code[v, u] * rng.uniform(0.82, 1.15)), 255), 1, cv2.LINE_AA
        )


def smudges(canvas: Canvas, strength: float, rng: np.random.Generator, streak: int = 1) -> None:
    """Soft dirt over the whole sheet, drawn out ``streak`` times along the columns."""
    height, width = canvas.shape
    coarse = rng.normal(0, 1, (max(3, height // (40 * streak)), max(3, width // 40))).astype(np.float32)
    fine = rng.normal(0, 1, (max(3, height // (12 * streak)), max(3, width // 12))).astype(np.float32)
    broad = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
    dirt = broad + 0.5 * np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_CUBIC))
    canvas.code[...] = np.clip(canvas.code * (1.0 + strength * dirt), 0, 255)
