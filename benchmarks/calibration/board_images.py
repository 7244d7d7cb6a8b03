"""Images of a board as a known camera sees it: rays through the true lens onto the board's plane.

The rays of sub-pixels are interpolated between those of the pixels' centres: to 0.001 px for the lenses drawn
here. The brightness is the mean over each pixel, blurred by a Gaussian, with noise, in 8 bits.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.calibration.boards import Board
from polhode.calibration.epipolar import rays
from polhode.calibration.lenses import Lens, project
from polhode.images import Grey
from polhode.lie import Array, inverse_pose, transform_points

SQUARE_PX = 100
"""Pixels of a square, or of a tag, in the picture of the board."""
BLACK, WHITE, AROUND = 25.0, 215.0, 90.0
"""Grey levels of ink, paper and surroundings."""
SAMPLES = 12
"""Of a pixel, spread by the plastic number: evenly, and in no rows that an edge could follow."""
PLASTIC = 1.32471795724474602596
WIDEST_RAD = np.radians(80.0)


@dataclass(frozen=True)
class Picture:
    """The board as it is printed."""

    grey: NDArray[np.uint8]
    """(H, W)"""
    origin_px: tuple[float, float]
    """Where the board's frame begins in it"""
    px_per_m: float
    upward: bool
    """Whether the board's y axis points to the top of the picture"""


def printed(board: Board) -> Picture:
    """The picture of a board, with a margin of a square."""
    scale = SQUARE_PX / board.square_m
    if board.pattern == "chessboard":
        j, i = np.mgrid[: board.rows + 1, : board.columns + 1]
        cells = np.where((i + j) % 2 == 0, 0, 255).astype(np.uint8)
        grey = np.kron(cells, np.ones((SQUARE_PX, SQUARE_PX), np.uint8))
        return Picture(_with_margin(grey), (2.0 * SQUARE_PX, 2.0 * SQUARE_PX), scale, False)
    if board.pattern == "charuco":
        size = (board.columns * SQUARE_PX, board.rows * SQUARE_PX)
        grey = board.opencv_charuco().generateImage(size, marginSize=0, borderBits=1)
        return Picture(_with_margin(grey), (float(SQUARE_PX), float(SQUARE_PX)), scale, False)
    return _april_grid(board, scale)


def _with_margin(grey: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(np.pad(grey, SQUARE_PX, constant_values=255), dtype=np.uint8)


def _april_grid(board: Board, scale: float) -> Picture:
    """Kalibr's grid: tags with a border of two bits, and black squares at the tags' corners."""
    gap = round(board.spacing * SQUARE_PX)
    step = SQUARE_PX + gap
    height, width = board.rows * step + gap, board.columns * step + gap
    grey = np.full((height, width), 255, np.uint8)
    for row in range(board.rows + 1):
        for column in range(board.columns + 1):
            top, left = row * step, column * step
            grey[top : top + gap, left : left + gap] = 0
    dictionary = board.opencv_dictionary()
    for tag in range(board.columns * board.rows):
        # the first tag is on the left below
        top = (board.rows - 1 - tag // board.columns) * step + gap
        left = (tag % board.columns) * step + gap
        picture = cv2.aruco.generateImageMarker(dictionary, tag, SQUARE_PX, borderBits=2)
        grey[top : top + SQUARE_PX, left : left + SQUARE_PX] = picture
    bottom = SQUARE_PX + height - gap
    return Picture(_with_margin(grey), (float(SQUARE_PX + gap), float(bottom)), scale, True)


class BoardCamera:
    """A camera that takes pictures of boards; its rays are found once."""

    def __init__(self, lens: Lens, size_px: tuple[int, int]) -> None:
        self.lens, self.size_px = lens, size_px
        width, height = size_px
        # one pixel more on each side: sub-pixels lie between centres
        v, u = np.mgrid[-1 : height + 1, -1 : width + 1].astype(np.float64)
        found = rays(lens, np.column_stack([u.ravel(), v.ravel()]))
        far = ~(found[:, 2] > np.cos(WIDEST_RAD))
        found[far] = np.nan
        flat = found[:, :2] / found[:, 2:]
        self._flat = flat.reshape(height + 2, width + 2, 2)

    def picture(
        self, board: Picture, X_CB: Array, blur_px: float, noise: float, rng: np.random.Generator
    ) -> Grey:
        """An image (H, W) of a board at a pose (4, 4): Gaussian blur [px], noise [grey levels]."""
        width, height = self.size_px
        grey: Array = np.full((height, width), AROUND)
        box = self._box(board, X_CB)
        total = np.zeros(grey[box].shape)
        X_BC = inverse_pose(X_CB)
        spread = (np.arange(SAMPLES)[:, None] * PLASTIC ** -np.array([1.0, 2.0])) % 1.0
        for du, dv in (spread - spread.mean(axis=0)).tolist():
            total += self._sampled(board, X_BC, du, dv, box)
        grey[box] = total / SAMPLES
        if blur_px > 0.0:
            grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), blur_px), dtype=np.float64)
        grey = grey + noise * rng.standard_normal(grey.shape)
        return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)

    def _box(self, board: Picture, X_CB: Array) -> tuple[slice, slice]:
        """Rows and columns of the image in which the board is."""
        rows, columns = board.grey.shape
        share = np.linspace(0.0, 1.0, 30)
        low, high = np.zeros(30), np.ones(30)
        around = np.concatenate(
            [np.column_stack(side) for side in ((share, low), (share, high), (low, share), (high, share))]
        )
        p = (around * [columns, rows] - board.origin_px) / board.px_per_m
        if board.upward:
            p[:, 1] *= -1.0
        uv = project(self.lens, transform_points(X_CB, np.column_stack([p, np.zeros(len(p))])))
        width, height = self.size_px
        if not np.isfinite(uv).all():
            return slice(0, height), slice(0, width)
        first = np.maximum(np.floor(uv.min(axis=0)).astype(int) - 3, 0)
        last = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 4, [width, height])
        last = np.maximum(last, first + 1)
        return slice(first[1], last[1]), slice(first[0], last[0])

    def _sampled(self, board: Picture, X_BC: Array, du: float, dv: float, box: tuple[slice, slice]) -> Array:
        """Grey levels where the rays of sub-pixels in a part of the image meet the board's plane."""
        rows_of, columns_of = box
        flat = self._flat[rows_of.start : rows_of.stop + 2, columns_of.start : columns_of.stop + 2]
        xy = _between(flat, du, dv)
        direction = xy[..., 0, None] * X_BC[:3, 0] + xy[..., 1, None] * X_BC[:3, 1] + X_BC[:3, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -X_BC[2, 3] / direction[..., 2]
            x = X_BC[0, 3] + distance * direction[..., 0]
            y = X_BC[1, 3] + distance * direction[..., 1]
        u = board.origin_px[0] + board.px_per_m * x
        v = board.origin_px[1] + (-1.0 if board.upward else 1.0) * board.px_per_m * y
        rows, columns = board.grey.shape
        on = (distance > 0.0) & (u >= 0.0) & (v >= 0.0) & (u < columns) & (v < rows)
        out: Array = np.full(on.shape, AROUND)
        ink = board.grey[v[on].astype(np.int64), u[on].astype(np.int64)]
        out[on] = BLACK + (WHITE - BLACK) / 255.0 * ink
        return out


def _between(flat: Array, du: float, dv: float) -> Array:
    """(H, W, 2) rays at z = 1 of pixels moved by a part of a pixel; ``flat`` (H + 2, W + 2, 2): unmoved."""
    a, b = abs(du), abs(dv)
    across = flat[:, 2:] if du > 0.0 else flat[:, :-2]
    rows = (1.0 - a) * flat[:, 1:-1] + a * across
    down = rows[2:] if dv > 0.0 else rows[:-2]
    return np.asarray((1.0 - b) * rows[1:-1] + b * down)
