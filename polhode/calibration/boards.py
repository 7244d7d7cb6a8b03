"""Calibration boards: what is on them, and where their corners are.

A chessboard is stated by its inner corners, a ChArUco board by its squares, a grid of AprilTags by its tags,
columns x rows. The frame of a board lies in its plane z = 0.
"""

import math
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np

from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

Pattern = Literal["chessboard", "charuco", "aprilgrid"]
PATTERNS: tuple[Pattern, ...] = ("chessboard", "charuco", "aprilgrid")
APRILTAGS = "APRILTAG_36h11"
MIN_SIDE, MAX_SIDE = 2, 60
"""Corners, squares or tags along a side."""
MAX_SQUARE_M = 10.0


@dataclass(frozen=True)
class Board:
    """A flat board, N corners."""

    pattern: Pattern
    columns: int
    """Inner corners of a chessboard, squares of a ChArUco board, tags of a grid"""
    rows: int
    square_m: float
    """Side of a square, or of a tag (its black part)"""
    marker_m: float = 0.0
    """Side of the markers of a ChArUco board"""
    spacing: float = 0.3
    """Gap between the tags of a grid, over their side"""
    dictionary: str = APRILTAGS
    """Of the markers, as OpenCV calls it, without DICT_"""

    @property
    def words(self) -> str:
        """As messages call it."""
        unit = {"chessboard": "inner corners", "charuco": "squares", "aprilgrid": "tags"}[self.pattern]
        return f"{self.columns}x{self.rows} {unit}"

    @cached_property
    def points(self) -> Array:
        """(N, 3) corners on the board [m], by their number.

        Kalibr numbers tags from the left below, along the rows; the corners of each from its left below,
        against the clock.
        """
        if self.pattern == "aprilgrid":
            tag = np.arange(self.columns * self.rows)
            origin = (1.0 + self.spacing) * np.stack([tag % self.columns, tag // self.columns], axis=1)
            corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
            flat = (origin[:, None] + corner).reshape(-1, 2)
        else:
            first = int(self.pattern == "charuco")
            j, i = np.mgrid[: self.rows - first, : self.columns - first]
            flat = np.column_stack([i.ravel(), j.ravel()]) + float(first)
        return self.square_m * np.column_stack([flat, np.zeros(len(flat))])

    @property
    def free_m(self) -> float:
        """Radius around a corner within which only its own four squares are seen."""
        if self.pattern == "aprilgrid":
            # Kalibr's tags have a black border of a fifth of their side, between squares as wide as the gaps
            return 0.9 * self.square_m * min(self.spacing, 0.2)
        if self.pattern == "charuco":
            # to the corner of the nearest marker
            return 0.9 * (self.square_m - self.marker_m) / math.sqrt(2.0)
        return 0.5 * self.square_m

    def opencv_dictionary(self) -> Any:
        """The dictionary of the markers."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))

    def opencv_charuco(self, legacy: bool = False) -> Any:
        """OpenCV's board; ``legacy``: with the other colour first, as before version 4.6."""
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), self.square_m, self.marker_m, self.opencv_dictionary()
        )
        board.setLegacyPattern(legacy)
        return board


def dictionaries() -> list[str]:
    """Names of OpenCV's dictionaries without DICT_, of those that begin alike the smaller one first.

    OpenCV spells some in two ways.
    """
    names = sorted(each.removeprefix("DICT_") for each in dir(cv2.aruco) if each.startswith("DICT_"))
    once = {name.lower(): name for name in names}.values()
    return sorted(once, key=lambda name: [int(part) for part in re.findall(r"\d+", name)[::-1]] or [0])


def make_board(
    pattern: str,
    size: str,
    square_m: float,
    marker_m: float | None = None,
    spacing: float = 0.3,
    dictionary: str | None = None,
) -> Board:
    """The board that the words of a command line describe. Raises InputError."""
    kind = next((each for each in PATTERNS if each == pattern), None)
    if kind is None:
        raise InputError(f"--pattern {pattern[:40]}: choose one of {', '.join(PATTERNS)}")
    found = re.fullmatch(r"(\d{1,3})[xX](\d{1,3})", size)
    if not found:
        raise InputError(f"--board {size[:40]}: give columns x rows, such as 9x6")
    columns, rows = (int(number) for number in found.groups())
    least = 1 if kind == "aprilgrid" else 3
    if not (max(least, 2) <= max(columns, rows) <= MAX_SIDE and min(columns, rows) >= least):
        raise InputError(f"--board {size}: sides must have {least} to {MAX_SIDE} (docs/calibrate.md)")
    if not 0.0 < square_m <= MAX_SQUARE_M:
        raise InputError(f"--square-mm {1e3 * square_m:g}: give a length above 0, up to {MAX_SQUARE_M:g} m")
    if kind == "charuco":
        marker_m = 0.75 * square_m if marker_m is None else marker_m
        if not 0.2 * square_m < marker_m < square_m:
            raise InputError(
                f"--marker-mm {1e3 * marker_m:g}: markers are smaller than their squares of "
                f"{1e3 * square_m:g} mm, and at least a fifth"
            )
    elif marker_m is not None:
        raise InputError(f"--marker-mm: a {kind} has no markers inside its squares; leave it out")
    if kind == "aprilgrid" and not 0.05 <= spacing <= 2.0:
        raise InputError(f"--spacing {spacing:g}: give the gap between tags over their side, 0.05 to 2")
    wanted = dictionary or (APRILTAGS if kind == "aprilgrid" else "5X5_100")
    known = dictionaries()
    named = next((each for each in known if each.lower() == wanted.lower().removeprefix("dict_")), None)
    if named is None:
        raise InputError(f"--dictionary {wanted[:40]}: not known; choose one of {', '.join(known)}")
    return Board(kind, columns, rows, square_m, marker_m or 0.0, spacing, named)
