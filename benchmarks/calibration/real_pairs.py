"""Pairs of real images of a chessboard, calibrated by us and by OpenCV.

    python -m benchmarks.calibration.real_pairs FOLDER [FOLDER ...] [--board 9x6] [--square-mm 25]

A folder has pairs of images (left*.png, right*.png), such as the pairs left01 to right14 of OpenCV's samples.
OpenCV calibrates as its sample stereo_calib does: findChessboardCorners, cornerSubPix in windows of 23 px,
calibrateCamera, stereoCalibrate; five coefficients; of the pairs that we use, with its corners and with ours.
Residuals [px, rms] are those of each one's own corners.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tyro.conf import Positional

from benchmarks.command import command
from benchmarks.presentation import print_table
from polhode.calibration.boards import Board, make_board
from polhode.calibration.calibrate import CalibratedRig, calibrate
from polhode.calibration.image_pairs import ImagePairs, pairs_of_files
from polhode.calibration.result import result_of
from polhode.lie import Array
from polhode.progress import Silent

Corners = dict[int, tuple[Any, Array, Array]]
"""By pair: numbers of corners that both images show, (N,), and where, left and right (N, 2)"""


def main(folders: Positional[tuple[Path, ...]], board: str = "9x6", square_mm: float = 25.0) -> None:
    """Print a table for each folder."""
    for folder in folders:
        print(f"\n{folder.name}\n")
        head = "calibration | pairs | left alone | right alone | together | baseline [mm]"
        print_table(head, rows(folder, make_board("chessboard", board, 1e-3 * square_mm)))


def rows(folder: Path, board: Board) -> list[list[object]]:
    """Ours, and OpenCV's of our pairs with its corners and with ours."""
    pairs = pairs_of_files([str(folder / "left*")], [str(folder / "right*")])
    rig = calibrate(pairs, board, ("brown5", "brown5"), Silent())
    for each in rig.views.rejections():
        print(f"left out by us: {each.file}: {each.reason}")
    result, ours = result_of(rig), our_corners(rig)
    theirs = {k: corners for k, corners in opencv_corners(pairs, board).items() if k in ours}
    baseline = result.parameters["rig"]["baseline"]
    residuals = (f"{value:.3f}" for value in (result.rms_px.cam0, result.rms_px.cam1, result.rms_px.stereo))
    length = f"{1e3 * baseline.value:.2f} ± {1e3 * baseline.sigma:.2f}"
    size_px = rig.views.size_px(0)
    return [
        ["polhode", result.pairs, *residuals, length],
        ["OpenCV", *opencv_row(theirs, board, size_px)],
        ["OpenCV with our corners", *opencv_row(ours, board, size_px)],
    ]


def opencv_corners(pairs: ImagePairs, board: Board) -> Corners:
    """As OpenCV's sample finds them."""
    seen: dict[int, dict[int, Array]] = {}
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    for each in pairs.images():
        assert each.pixels is not None
        ok, corners = cv2.findChessboardCorners(each.pixels, (board.columns, board.rows), flags=flags)
        if ok:
            corners = cv2.cornerSubPix(each.pixels, corners, (11, 11), (-1, -1), (3, 30, 0.01))
            seen.setdefault(each.pair, {})[each.camera] = corners.reshape(-1, 2)
    every = np.arange(len(board.points))
    return {pair: (every, own[0], own[1]) for pair, own in seen.items() if len(own) == 2}


def our_corners(rig: CalibratedRig) -> Corners:
    """Of the pairs that are used."""
    out: Corners = {}
    for pair in sorted(rig.views.found[0].keys() & rig.views.found[1].keys()):
        left, right = (side[pair] for side in rig.views.found)
        ids, a, b = np.intersect1d(left.ids, right.ids, return_indices=True)
        out[pair] = (ids, left.uv_px[a], right.uv_px[b])
    return out


def opencv_row(corners: Corners, board: Board, size_px: tuple[int, int]) -> list[object]:
    """OpenCV's calibration of some corners; both cameras have images of one size."""
    points = [board.points[ids].astype(np.float32) for ids, _, _ in corners.values()]
    sides = [[pair[c].astype(np.float32)[:, None] for pair in corners.values()] for c in (1, 2)]
    alone = [cv2.calibrateCamera(points, side, size_px, None, None) for side in sides]
    intrinsics = [each for one in alone for each in one[1:3]]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    found = cv2.stereoCalibrate(
        points, *sides, *intrinsics, size_px, flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=criteria
    )
    residuals = (f"{value:.3f}" for value in (alone[0][0], alone[1][0], found[0]))
    return [len(corners), *residuals, f"{1e3 * np.linalg.norm(found[6]):.2f}"]


if __name__ == "__main__":
    command(main)
