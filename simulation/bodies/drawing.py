"""Drawings for flat faces: stickers, labels, seams and screws on paint; solar cells.

Each face gets its own drawing, so parallel faces never look alike.
"""

from collections.abc import Callable

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Ints
from simulation.bodies.part import Chart

Image = NDArray[np.uint8]
"""Reflectance times 255: OpenCV smooths edges and writes text on 8-bit images only."""
Draw = Callable[[int, int, float, np.random.Generator], Image]
"""(height, width in texels, texel [m], random generator) -> drawing (h, w)."""

WORDS = (
    "CAUTION",
    "VENT",
    "LIFT",
    "HOT",
    "S/N",
    "PORT",
    "REV C",
    "NO STEP",
    "ARM",
    "FILL",
    "J4",
    "GND",
    "RCS",
)


def chart_of_facet(
    mesh: trimesh.Trimesh, faces: Ints, texel_m: float, draw: Draw, rng: np.random.Generator
) -> tuple[Chart, Ints]:
    """Draw a picture on a plane facet of a mesh."""
    normal = np.asarray(mesh.face_normals[faces[0]])
    right, down = _in_plane_axes(normal)
    corners = mesh.triangles[faces].reshape(-1, 3)
    along = corners @ np.stack([right, down], axis=1)
    low, high = along.min(axis=0) - texel_m, along.max(axis=0) + texel_m
    width, height = (np.ceil((high - low) / texel_m).astype(int) + 1).tolist()
    origin = low[0] * right + low[1] * down + (corners[0] @ normal) * normal
    image = np.clip(draw(height, width, texel_m, rng) / np.float32(255), 0.01, 0.95).astype(np.float32)
    return Chart(origin, right, down, texel_m, image), faces


def _in_plane_axes(normal: Array) -> tuple[Array, Array]:
    reference = np.eye(3)[int(np.argmin(np.abs(normal)))]
    right = np.cross(reference, normal)
    right /= np.linalg.norm(right)
    # Down is such that the drawing reads the right way round from outside.
    return right, np.cross(right, normal)


def draw_equipment_panel(base: float, stickers_per_m2: float = 1300.0) -> Draw:
    """A painted panel with a seam, screws, and a random set of stickers and labels."""

    def draw(height: int, width: int, texel_m: float, rng: np.random.Generator) -> Image:
        image = _sheet(height, width, base)
        _seam_and_screws(image, texel_m, base, rng)
        area = height * width * texel_m**2
        for _ in range(int(rng.poisson(stickers_per_m2 * area))):
            _sticker(image, texel_m, rng)
        _scratches(image, texel_m, int(rng.poisson(900 * area)), rng)
        return cv2.GaussianBlur(image, (3, 3), 0.5).astype(np.uint8)

    return draw


def draw_plain(base: float) -> Draw:
    """A painted panel with nothing on it but a few scratches: hard to track, as real ones are."""

    def draw(height: int, width: int, texel_m: float, rng: np.random.Generator) -> Image:
        image = _sheet(height, width, base)
        _scratches(image, texel_m, int(rng.poisson(300 * height * width * texel_m**2)), rng)
        return image

    return draw


def draw_solar_cells(cell_m: float) -> Draw:
    """Dark cells in a bright grid, thin collector lines, one brightness per cell, some replaced."""

    def draw(height: int, width: int, texel_m: float, rng: np.random.Generator) -> Image:
        image = _sheet(height, width, 0.30)
        step = max(6, round(cell_m / texel_m))
        gap = max(1, round(0.0015 / texel_m))
        for top in range(gap, height, step):
            for left in range(gap, width, 2 * step):
                shade = rng.normal(0.07, 0.012) if rng.random() > 0.06 else rng.uniform(0.1, 0.2)
                image[top : top + step - gap, left : left + 2 * step - gap] = _grey(max(shade, 0.02))
                bus = top + int((step - gap) * rng.choice([0.33, 0.5, 0.66]))
                image[bus : bus + 1, left : left + 2 * step - gap] = _grey(0.22)
        for _ in range(int(rng.poisson(60 * height * width * texel_m**2))):
            _sticker(image, texel_m, rng)
        return image

    return draw


def _sheet(height: int, width: int, reflectance: float) -> Image:
    return np.full((height, width), _grey(reflectance), np.uint8)


def _grey(reflectance: float) -> int:
    return int(np.clip(round(255 * reflectance), 0, 255))


def _seam_and_screws(image: Image, texel_m: float, base: float, rng: np.random.Generator) -> None:
    height, width = image.shape
    inset = round(0.006 / texel_m)
    if min(height, width) < 4 * inset:
        return
    cv2.rectangle(image, (inset, inset), (width - inset, height - inset), _grey(base * 0.6), 1, cv2.LINE_AA)
    radius = max(1, round(0.0016 / texel_m))
    for u in np.linspace(2 * inset, width - 2 * inset, int(rng.integers(2, 5))):
        for v in (2 * inset, height - 2 * inset):
            if rng.random() < 0.8:
                cv2.circle(
                    image, (round(u), round(v)), radius, _grey(base * rng.uniform(0.4, 1.6)), -1, cv2.LINE_AA
                )


def _sticker(image: Image, texel_m: float, rng: np.random.Generator) -> None:
    """One label: a plate of its own shade with text, bars, a symbol or a torn patchwork on it."""
    height, width = image.shape
    w, h = (rng.uniform((0.012, 0.008), (0.042, 0.026)) / texel_m).astype(int) + 3
    paper = float(rng.choice([0.08, 0.2, 0.45, 0.6, 0.75]))
    ink = _grey(float(np.clip(paper + rng.choice([-1, 1]) * rng.uniform(0.2, 0.5), 0.05, 0.85)))
    plate = _sheet(h, w, paper)
    kind = rng.integers(5)
    if kind == 0:
        _text(plate, ink, rng)
    elif kind == 1:
        edges = np.cumsum(rng.integers(1, 5, w))
        for a, b in zip(edges[::2], edges[1::2], strict=False):
            plate[h // 6 : -max(1, h // 6), a:b] = ink
    elif kind == 2:
        centre = (int(rng.integers(w)), int(rng.integers(h)))
        cv2.circle(plate, centre, int(rng.integers(2, max(3, h // 2) + 1)), ink, -1, cv2.LINE_AA)
    elif kind == 3:
        for _ in range(int(rng.integers(2, 6))):
            points = (rng.random((int(rng.integers(3, 6)), 2)) * (w, h)).astype(np.int32)
            cv2.fillPoly(plate, [points], int(rng.choice([ink, (ink + _grey(paper)) // 2])), cv2.LINE_AA)
    else:
        plate[h // 2 :] = ink
        _text(plate[: h // 2], ink, rng)
    turn = rng.choice([0.0, 90.0]) + rng.normal(0, 6.0)
    centre_uv = rng.uniform((0, 0), (width, height))
    _paste(image, plate, centre_uv, float(turn))


def _text(plate: Image, ink: int, rng: np.random.Generator) -> None:
    word = f"{rng.choice(WORDS)} {rng.integers(100)}"
    h, w = plate.shape
    (text_w, text_h), _ = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)
    scale = min(0.9 * w / text_w, 0.7 * h / text_h)
    at = (int(0.05 * w), int(0.5 * (h + scale * text_h)))
    cv2.putText(plate, word, at, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, max(1, round(2 * scale)), cv2.LINE_AA)


def _paste(image: Image, plate: Image, centre_uv: Array, turn_deg: float) -> None:
    """Lay a plate onto the image, turned, about a centre."""
    h, w = plate.shape
    M = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), turn_deg, 1.0)
    M[:, 2] += centre_uv - np.array([(w - 1) / 2, (h - 1) / 2])
    size = (image.shape[1], image.shape[0])
    cover = cv2.warpAffine(np.ones((h, w), np.float32), M, size)
    laid = cv2.warpAffine(plate, M, size, borderMode=cv2.BORDER_REPLICATE)
    image[...] = np.rint(image * (1 - cover) + laid * cover)


def _scratches(image: Image, texel_m: float, count: int, rng: np.random.Generator) -> None:
    height, width = image.shape
    for _ in range(count):
        start = rng.uniform((0, 0), (width, height))
        end = start + rng.normal(0, 0.006 / texel_m, 2)
        a, b = (tuple(p.astype(int).tolist()) for p in (start, end))
        cv2.line(image, a, b, min(int(image.mean() * rng.uniform(0.7, 1.3)), 255), 1, cv2.LINE_AA)
