"""Images of a board as a known camera sees it: rays through the true lens onto the board's plane.

The optics blur before the pixels add up the light: a picture four times as fine is blurred by a Gaussian and
then averaged over each pixel, with noise, in 8 bits. Blurred pixels instead would have edges that wander with
where they lie between the pixels. Where the rays of sub-pixels meet the board is interpolated to the second
order between those of the pixels' centres.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.calibration.boards import Board
from polhode.calibration.lenses import Lens, project, rays
from polhode.files.images import Grey
from polhode.geometry.lie import Array, inverse_pose, transform_points

SQUARE_PX = 100
"""Pixels of a square, or of a tag, in the picture of the board."""
BLACK, WHITE, AROUND = 25.0, 215.0, 90.0
"""Grey levels of ink, paper and surroundings."""
FINE = 4
"""Sub-pixels along a pixel."""
MARGIN_PX = 5
"""Around the board, which its blur reaches."""
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
        uv = self._on_picture(board, inverse_pose(X_CB), box)
        grey[box] = _light(board, uv, blur_px)
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
        first = np.maximum(np.floor(uv.min(axis=0)).astype(int) - MARGIN_PX, 0)
        last = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + MARGIN_PX + 1, [width, height])
        last = np.maximum(last, first + 1)
        return slice(first[1], last[1]), slice(first[0], last[0])

    def _on_picture(self, board: Picture, X_BC: Array, box: tuple[slice, slice]) -> Array:
        """(2, H + 2, W + 2) pixels of the board's picture that the rays of a part of the image meet, with one
        pixel more on each side; NaN: none."""
        rows, columns = box
        flat = self._flat[rows.start : rows.stop + 2, columns.start : columns.stop + 2]
        direction = flat[..., 0, None] * X_BC[:3, 0] + flat[..., 1, None] * X_BC[:3, 1] + X_BC[:3, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -X_BC[2, 3] / direction[..., 2]
        distance[~(distance > 0.0)] = np.nan
        x = X_BC[0, 3] + distance * direction[..., 0]
        y = X_BC[1, 3] + distance * direction[..., 1]
        down = -1.0 if board.upward else 1.0
        return np.stack(
            [board.origin_px[0] + board.px_per_m * x, board.origin_px[1] + down * board.px_per_m * y]
        )


def _sub_pixels(uv: Array) -> NDArray[np.float32]:
    """(2, H FINE, W FINE) values at sub-pixels, from (2, H + 2, W + 2) at centres of pixels by differences of
    the second order."""
    height, width = uv.shape[1] - 2, uv.shape[2] - 2
    inner = (np.arange(FINE) + 0.5) / FINE - 0.5
    dv, du = (each.ravel() for each in np.meshgrid(inner, inner, indexing="ij"))
    weight = np.zeros((len(du), 3, 3))
    weight[:, 1, 1] = 1.0 - du**2 - dv**2
    weight[:, 1, 0], weight[:, 1, 2] = 0.5 * (du**2 - du), 0.5 * (du**2 + du)
    weight[:, 0, 1], weight[:, 2, 1] = 0.5 * (dv**2 - dv), 0.5 * (dv**2 + dv)
    twist = 0.25 * du * dv
    weight[:, 0, 0] = weight[:, 2, 2] = twist
    weight[:, 0, 2] = weight[:, 2, 0] = -twist
    out = np.empty((2, height, FINE, width, FINE), np.float32)
    for each, place in zip(uv.astype(np.float32), out, strict=True):
        near = np.stack([each[j : j + height, i : i + width].ravel() for j in range(3) for i in range(3)])
        fine = weight.reshape(-1, 9).astype(np.float32) @ near
        place[:] = fine.reshape(FINE, FINE, height, width).transpose(2, 0, 3, 1)
    return out.reshape(2, height * FINE, width * FINE)


def _light(board: Picture, uv: Array, blur_px: float) -> Array:
    """Grey levels (H, W) of pixels whose centres are at (2, H + 2, W + 2) on the board's picture."""
    height, width = uv.shape[1] - 2, uv.shape[2] - 2
    # ink as the mean over about as much as a sub-pixel sees of it
    usual = float(np.nanmedian(np.abs(np.diff(uv, axis=2)).max(axis=0))) / FINE
    step = next(each for each in (10, 5, 2, 1) if each <= max(1.5 * usual, 1.0))
    rows, columns = board.grey.shape
    ink: NDArray[Any] = BLACK + (WHITE - BLACK) / 255.0 * board.grey.astype(np.float32)
    ink = cv2.resize(ink, (columns // step, rows // step), interpolation=cv2.INTER_AREA)
    # what is nowhere on the board is far beside it
    at = _sub_pixels(np.nan_to_num(uv / step - 0.5, nan=-1e6))
    light: NDArray[Any] = cv2.remap(
        ink, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=AROUND
    )
    if blur_px > 0.0:
        light = cv2.GaussianBlur(light, (0, 0), FINE * blur_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float64)
