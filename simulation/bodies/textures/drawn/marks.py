"""Single marks of the first generator: stamps, relief, screws, scratches."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.simulation.bodies.textures.canvas import Canvas, Code
from polhode.simulation.surface.materials import BRUSHED_METAL


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


def scratches(canvas: Canvas, count: int, rng: np.random.Generator, length: float = 14.0) -> None:
    """Thin bright and dark lines in any direction."""
    height, width = canvas.shape
    for _ in range(count):
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
