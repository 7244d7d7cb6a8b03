"""Real pairs of a chessboard: residuals of polhode calibrate beside those of OpenCV's own calibration.

    python -m benchmarks.calibration.real_pairs data/chessboard_pairs
    python -m benchmarks.calibration.real_pairs FOLDER --board 9x6 --square-mm 30

A folder holds left*.jpg and right*.jpg (or .png), such as the pairs left01 to right14 of OpenCV's samples.
OpenCV calibrates as its sample stereo_calib does: findChessboardCorners, cornerSubPix in windows of 23 px,
calibrateCamera, stereoCalibrate; five coefficients. Residuals are those of each one's own corners. OpenCV
has a row for all pairs in which it finds the board, one for those that we use, and one for our corners.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tyro.conf import Positional

from benchmarks.command import command
from benchmarks.presentation import markdown_table
from polhode.calibration.adjustment import RigState
from polhode.calibration.boards import Board, make_board
from polhode.calibration.calibrate import CalibratedRig, calibrate
from polhode.calibration.epipolar import epipolar_px
from polhode.calibration.image_pairs import ImagePairs, pairs_of_files
from polhode.calibration.lenses import Lens
from polhode.calibration.result import result_of
from polhode.lie import Array, make_pose
from polhode.progress import Silent
from polhode.records import Ints

Corners = dict[int, tuple[Ints, NDArray[Any], NDArray[Any]]]
"""By pair: numbers of corners that both images show, (N,), and where, left and right (N, 2)"""


def opencv_corners(pairs: ImagePairs, board: Board) -> Corners:
    """As OpenCV's sample finds them."""
    seen: dict[int, dict[int, NDArray[Any]]] = {}
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


def opencv_row(
    name: str, corners: Corners, board: Board, sizes_px: tuple[tuple[int, int], tuple[int, int]]
) -> tuple[str, ...]:
    """OpenCV's calibration of some corners."""
    points = [board.points[ids].astype(np.float32) for ids, _, _ in corners.values()]
    sides = [[pair[c].astype(np.float32)[:, None] for pair in corners.values()] for c in (1, 2)]
    alone = [
        cv2.calibrateCamera(points, side, size, None, None)
        for side, size in zip(sides, sizes_px, strict=True)
    ]
    found = cv2.stereoCalibrate(
        points,
        sides[0],
        sides[1],
        *(each for one in alone for each in one[1:3]),
        sizes_px[0],
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9),
    )
    rms, K0, D0, K1, D1, R, T = found[:7]
    lenses = tuple(
        Lens("brown5", np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *np.ravel(D)[:5]]))
        for K, D in ((K0, D0), (K1, D1))
    )
    state = RigState(lenses, np.eye(4)[None], make_pose(R, np.ravel(T)))
    left, right = (np.concatenate([pair[c] for pair in corners.values()]).astype(np.float64) for c in (1, 2))
    return _row(
        name,
        len(corners),
        alone[0][0],
        alone[1][0],
        rms,
        epipolar_px(state, left, right),
        np.ravel(T).tolist(),
    )


def _row(
    name: str, pairs: int, left: float, right: float, both: float, epipolar: Array, t: Sequence[float]
) -> tuple[str, ...]:
    return (
        name,
        str(pairs),
        f"{left:.3f}",
        f"{right:.3f}",
        f"{both:.3f}",
        f"{np.sqrt(np.nanmean(epipolar**2)):.3f}",
        f"{1e3 * np.linalg.norm(t):.2f}",
    )


def rows(folder: Path, board: Board) -> list[tuple[str, ...]]:
    """Ours, and OpenCV's: of all its pairs, of ours, and of ours with our corners."""
    pairs = pairs_of_files([str(folder / "left*")], [str(folder / "right*")])
    rig = calibrate(pairs, board, ("brown5", "brown5"), Silent())
    for each in rig.views.rejections():
        print(f"left out by us: {each.file}: {each.reason}")
    result = result_of(rig)
    ours, theirs = our_corners(rig), opencv_corners(pairs, board)
    rms = result.rms_px
    own = ("polhode", str(result.pairs), *(f"{value:.3f}" for value in (rms.cam0, rms.cam1, rms.stereo)))
    baseline = result.parameters["rig"]["baseline"]
    sizes = (rig.views.size_px(0), rig.views.size_px(1))
    return [
        (*own, f"{result.epipolar_rms_px:.3f}", f"{1e3 * baseline.value:.2f} ± {1e3 * baseline.sigma:.2f}"),
        opencv_row("OpenCV, all pairs", theirs, board, sizes),
        opencv_row(
            "OpenCV, pairs that polhode uses",
            {k: own for k, own in theirs.items() if k in ours},
            board,
            sizes,
        ),
        opencv_row("OpenCV with our corners", ours, board, sizes),
    ]


def main(folders: Positional[tuple[Path, ...]], board: str = "9x6", square_mm: float = 25.0) -> None:
    """Print a table for each folder."""
    for folder in folders:
        print(f"\n{folder.name}, residuals and epipolar error in px, rms:\n")
        head = "calibration | pairs | left alone | right alone | together | epipolar | baseline [mm]"
        print(markdown_table(head, rows(folder, make_board("chessboard", board, 1e-3 * square_mm))))


if __name__ == "__main__":
    command(main)
