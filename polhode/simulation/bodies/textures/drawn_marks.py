"""Marks of the drawn textures: lettering, stickers, relief, screws, rivets, scratches."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from polhode.simulation.bodies.textures.canvas import Canvas, Code, code
from polhode.simulation.surface.materials import BRUSHED_METAL, VINYL

Corners = tuple[int, int, int, int]
"""Left, top, right, bottom."""
WORDS = (
    "CAUTION", "VENT", "LIFT HERE", "HOT", "S/N", "PORT", "REV C", "NO STEP", "ARM", "FILL", "J4", "GND",
    "REMOVE BEFORE FLIGHT", "P/N", "HINGE", "AFT", "FWD", "UMB", "TEST", "OPEN", "LOX", "GN2", "28 V", "RCS",
)  # fmt: skip
STICKERS = ("label", "bars", "matrix", "hazard", "arrow", "roundel", "type plate")
SHARES = (0.34, 0.16, 0.12, 0.05, 0.05, 0.08, 0.2)
"""Share of each kind of sticker."""
_font = lru_cache(maxsize=64)(ImageFont.load_default)


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


def write(c: Canvas, text: str, height: int, centre: ArrayLike, reflectance: float) -> None:
    """Painted lettering, its middle at ``centre``."""
    letters = lettering(text, height)
    stamp(c, np.full(letters.shape, code(reflectance), np.uint8), centre, 0.0, letters)


def stickers(c: Canvas, per_texel: float, askew_deg: float = 3.0) -> None:
    """Labels of several kinds anywhere on the canvas, of a mean density."""
    rng, (height, width) = c.rng, c.shape
    for _ in range(c.count(per_texel)):
        size = np.array([1.0, rng.uniform(0.4, 0.8)]) * np.exp(rng.uniform(np.log(22), np.log(86)))
        w, h = np.minimum(size, 0.8 * np.array([width, height])).astype(int) + 4
        paper = float(rng.choice([0.06, 0.12, 0.3, 0.5, 0.68, 0.8]))
        ink = float(np.clip(paper + (0.55 if paper < 0.35 else -0.5) * rng.uniform(0.7, 1.1), 0.04, 0.85))
        kind = STICKERS[int(rng.choice(7, p=SHARES))]
        plate = _sticker(kind, int(h), int(w), code(paper), code(ink), rng)
        if rng.random() < 0.6:
            cv2.rectangle(plate, (0, 0), (plate.shape[1] - 1, plate.shape[0] - 1), code(ink), 1)
        turn = float(
            rng.choice([0.0, 90.0, 180.0, 270.0], p=[0.55, 0.2, 0.05, 0.2]) + rng.normal(0, askew_deg)
        )
        centre = free_place(c, 0.4 * float(np.hypot(*plate.shape)))
        if centre is not None:
            stamp(c, plate, centre, turn, layer=c.layer_of(VINYL), lift=0.25)


def free_place(c: Canvas, radius: float) -> NDArray[np.float64] | None:
    """A free position (2,) for a mark of a radius, now occupied; None if eight tries find none."""
    size = np.array(c.shape[::-1])
    for _ in range(8):
        at = c.rng.uniform(0.04 * size, 0.96 * size)
        if all((at[0] - u) ** 2 + (at[1] - v) ** 2 > (radius + r) ** 2 for u, v, r in c.taken):
            c.taken.append((float(at[0]), float(at[1]), radius))
            return np.asarray(at)
    return None


def _sticker(kind: str, h: int, w: int, paper: int, ink: int, rng: np.random.Generator) -> Code:
    """The plate of a sticker of about (h, w), in the codes of its paper and ink."""
    side = max(10, min(h, w))
    if kind in ("matrix", "roundel"):
        h = w = side
    plate = np.full((h, w), paper, np.uint8)
    match kind:
        case "label":
            lines = int(rng.integers(1, 4)) if h > 24 else 1
            for line in range(lines):
                text = f"{rng.choice(WORDS)} {rng.integers(1, 1000)}"
                letters = lettering(text, max(5, int(0.6 * h / lines)), bold=lines == 1)
                scale = min(1.0, 0.88 * w / letters.shape[1], 0.9 * h / lines / letters.shape[0])
                size = (max(2, int(scale * letters.shape[1])), max(2, int(scale * letters.shape[0])))
                top = int((line + 0.5) * h / lines - 0.5 * size[1])
                left = max(0, (w - size[0]) // 2 if lines == 1 else int(0.06 * w))
                _print(plate[max(top, 0) : top + size[1], left : left + size[0]], resized(letters, size), ink)
        case "bars":
            edges = np.cumsum(rng.integers(1, 5, w))
            for a, b in zip(edges[::2], edges[1::2], strict=False):
                if b < w - 2:
                    plate[max(1, h // 8) : max(3, int(0.7 * h)), a:b] = ink
        case "matrix":
            cells = (rng.random((10, 10)) < 0.5).astype(np.uint8)
            cells[:, 0], cells[-1, :] = 1, 1
            inner = cv2.resize(cells, (side - 4, side - 4), interpolation=cv2.INTER_NEAREST)
            plate[2:-2, 2:-2] = np.where(inner > 0, ink, paper)
        case "hazard":
            i, j = np.mgrid[: max(8, h // 2), :w]
            period = int(rng.integers(8, 16))
            plate = np.where((i + j) % period < period // 2, ink, paper).astype(np.uint8)
        case "arrow":
            tip = 0.9 if rng.random() < 0.5 else 0.1
            tail, neck = 1.0 - tip, (0.5 + 0.3 * (0.5 - tip)) * w + 0.2 * (tip - 0.5) * w
            cv2.line(plate, (int(tail * w), h // 2), (int(tip * w), h // 2), ink, max(2, h // 6), cv2.LINE_AA)
            points = np.array([[tip * w, 0.5 * h], [neck, 0.15 * h], [neck, 0.85 * h]])
            cv2.fillPoly(plate, [np.rint(points).astype(np.int32)], ink, cv2.LINE_AA)
        case "roundel":
            middle, radius = (side // 2, side // 2), int(0.42 * side)
            cv2.circle(plate, middle, radius, ink, -1, cv2.LINE_AA)
            pattern = rng.integers(3)
            if pattern == 0:
                cv2.circle(plate, middle, int(0.6 * radius), paper, -1, cv2.LINE_AA)
                cv2.circle(plate, middle, int(0.3 * radius), ink, -1, cv2.LINE_AA)
            elif pattern == 1:
                axes = (radius - 1, radius - 1)
                for start in (0, 180):
                    cv2.ellipse(plate, middle, axes, 0, start, start + 90, paper, -1, cv2.LINE_AA)
            else:
                cv2.line(plate, (side // 2, 2), (side // 2, side - 3), paper, 2)
                cv2.line(plate, (2, side // 2), (side - 3, side // 2), paper, 2)
        case "type plate":
            head = max(6, int(0.4 * h))
            plate[:head] = ink
            letters = lettering(str(rng.choice(WORDS)), max(4, int(0.5 * head)))
            size = (min(letters.shape[1], int(0.9 * w)), min(letters.shape[0], head))
            _print(plate[: size[1], 2 : 2 + size[0]], resized(letters, size), paper)
            for row in range(head + 3, h - 2, 4):
                plate[row, 3 : 3 + int(rng.uniform(0.4, 0.9) * w)] = (ink + paper) // 2
    return plate


def _print(window: Code, letters: NDArray[np.float32], ink: int) -> None:
    """Print letters into a part of a plate, which may be smaller."""
    share = letters[: window.shape[0], : window.shape[1]]
    window[...] = np.rint(window + share * (np.float32(ink) - window))


def stamp(
    c: Canvas,
    plate: Code,
    centre: ArrayLike,
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
    turned = cv2.warpAffine(np.ones((h, w), np.float32) if cover is None else cover, M, (size, size))
    laid = cv2.warpAffine(plate, M, (size, size), borderMode=cv2.BORDER_REPLICATE)
    rows = slice(max(top, 0), min(top + size, c.shape[0]))
    columns = slice(max(left, 0), min(left + size, c.shape[1]))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return
    inner = (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
    share, under = np.asarray(turned[inner], np.float32), c.code[rows, columns]
    c.code[rows, columns] = np.rint(under + share * (laid[inner].astype(np.float32) - under))
    if layer is not None:
        c.layer[rows, columns][share > 0.5] = layer
    if lift:
        c.relief[rows, columns] += np.float32(lift) * share


def fill(c: Canvas, corners: Corners, reflectance: float, layer: int | None = None) -> None:
    """Fill a rectangle."""
    left, top, right, bottom = corners
    window = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
    c.code[window] = code(reflectance)
    if layer is not None:
        c.layer[window] = layer


def border(c: Canvas, width: int, reflectance: float, layer: int) -> None:
    """Fill a border of a width in texels along the edges of the canvas."""
    h, w = c.shape
    for corners in ((0, 0, w, width), (0, h - width, w, h), (0, 0, width, h), (w - width, 0, w, h)):
        fill(c, corners, reflectance, layer)


def groove(c: Canvas, corners: Corners, depth: float, darker: float = 0.75) -> None:
    """A rectangular seam, one texel wide, dark and sunk."""
    left, top, right, bottom = corners
    left, right = max(left, 0), min(right, c.shape[1] - 1)
    top, bottom = max(top, 0), min(bottom, c.shape[0] - 1)
    if left >= right or top >= bottom:
        return
    rows, columns = slice(top, bottom + 1), slice(left, right + 1)
    edges = [(slice(v, v + 1), columns) for v in (top, bottom)] + [
        (rows, slice(u, u + 1)) for u in (left, right)
    ]
    for edge in edges:
        c.code[edge] = (c.code[edge] * darker).astype(np.uint8)
        c.relief[edge] -= np.float32(depth)


def dome(c: Canvas, centre: ArrayLike, radius: float, height: float) -> None:
    """A rivet's round head."""
    head = _head(radius, height)
    reach = len(head) // 2
    u, v = (round(float(x)) for x in np.asarray(centre))
    left, top = max(u - reach, 0), max(v - reach, 0)
    window = c.relief[top : v + reach + 1, left : u + reach + 1]
    if window.size > 0 and v + reach >= 0 and u + reach >= 0:
        i, j = top - v + reach, left - u + reach
        window += head[i : i + window.shape[0], j : j + window.shape[1]]


@lru_cache(maxsize=64)
def _head(radius: float, height: float) -> NDArray[np.float32]:
    """Relief of a round head in the middle of a square."""
    reach = int(np.ceil(radius)) + 1
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(height * np.sqrt(np.clip(1.0 - (i * i + j * j) / radius**2, 0.0, None)), np.float32)


def screws(c: Canvas, columns: ArrayLike, rows: ArrayLike, radius: float) -> None:
    """Bare metal screw heads with dark slots, at all columns (n,) of all rows (m,)."""
    layer, rng, r = c.layer_of(BRUSHED_METAL), c.rng, max(1, round(radius))
    for centre in ((u, v) for u in np.asarray(columns) for v in np.asarray(rows)):
        at = (round(float(centre[0])), round(float(centre[1])))
        cv2.circle(c.layer, at, r, layer, -1)
        cv2.circle(c.code, at, r + 1, int(rng.integers(30, 60)), 1, cv2.LINE_AA)
        cv2.circle(c.code, at, r, int(rng.integers(70, 130)), -1, cv2.LINE_AA)
        dome(c, centre, radius + 0.5, 0.5 * radius)
        angle = rng.uniform(0, np.pi)
        reach = np.array([np.cos(angle), np.sin(angle)]) * 0.7 * radius
        a, b = (tuple(np.rint(centre + side * reach).astype(int).tolist()) for side in (-1, 1))
        cv2.line(c.code, a, b, 30, 1, cv2.LINE_AA)


def rivets(
    c: Canvas, start: tuple[float, float], end: tuple[float, float], pitch: float, radius: float
) -> None:
    """A straight row of rivets."""
    count = max(2, int(np.linalg.norm(np.subtract(end, start)) / pitch))
    height, width = c.shape
    for at in np.linspace(start, end, count):
        if radius < at[0] < width - radius and radius < at[1] < height - radius:
            dome(c, at, radius, 0.45 * radius)
            v, u = int(at[1]), int(at[0])
            c.code[v, u] = min(255, int(c.code[v, u] * 1.06))


def scratches(c: Canvas, per_texel: float) -> None:
    """Thin bright and dark lines in any direction."""
    for _ in range(c.count(per_texel)):
        start = c.anywhere()
        end = start + c.rng.normal(0, 14.0, 2)
        a, b = (tuple(p.astype(int).tolist()) for p in (start, end))
        u, v = (int(np.clip(x, 0, n - 1)) for x, n in zip(a, c.shape[::-1], strict=True))
        cv2.line(c.code, a, b, min(int(c.code[v, u] * c.rng.uniform(0.82, 1.15)), 255), 1, cv2.LINE_AA)


def smudges(c: Canvas, strength: float, streak: int = 1) -> None:
    """Soft dirt over the whole sheet, drawn out ``streak`` times along the columns."""
    height, width = c.shape
    broad, fine = (
        np.asarray(cv2.resize(waves, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
        for waves in [
            c.rng.normal(0, 1, (max(3, height // (size * streak)), max(3, width // size))).astype(np.float32)
            for size in (40, 12)
        ]
    )
    c.code[...] = np.clip(c.code * (1.0 + strength * (broad + 0.5 * fine)), 0, 255)
