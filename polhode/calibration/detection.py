"""The corners of a board in one image, or the reason why it shows none.

OpenCV finds the board; each corner is then refined in a window that follows the size of its squares, so that
no other corner is in it: to tenths of a pixel by ``cornerSubPix``, then by corner_fit.py.
What the detector found is not believed at once: corners beyond the board's own mean another board.
"""

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from polhode.calibration.board_map import BoardMap, fitted_map, misfit
from polhode.calibration.boards import Board
from polhode.calibration.corner_fit import fit_corners
from polhode.files.images import Grey
from polhode.geometry.lie import Array, Bools, Ints

Kind = Literal[
    "unreadable",
    "other size",
    "no partner",
    "not found",
    "cut off",
    "covered",
    "blurred",
    "mirrored",
    "swapped",
    "other board",
    "moved",
    "outlier",
    "repeated",
]
"""Why an image is left out."""
WINDOW_SHARE = 0.6
"""Half of cornerSubPix's window over the radius around the corner in which nothing else is."""
FIT_SHARE = 0.9
"""Radius of the fitted disc over the same radius."""
MIN_WINDOW_PX, MAX_WINDOW_PX = 2, 25
MIN_CORNERS = 8
MAX_ASTRAY_PX = 0.5
"""From where its neighbours expect a corner, before it is looked for again."""
MAX_MISFIT = 0.35
"""Of a square: markers further from where the board has them mean another board."""
_RING = 16


@dataclass(frozen=True)
class Found:
    """Corners of the board in an image, n of them."""

    ids: Ints
    """(n,) numbers of the corners on the board"""
    uv_px: Array
    """(n, 2)"""


@dataclass(frozen=True)
class Missed:
    """Why an image shows no board that can be used."""

    kind: Kind
    words: str
    seen: tuple[int, int] | None = None
    """Columns and rows of the board that is seen instead, whole"""


def find_board(image: Grey, board: Board) -> Found | Missed:
    """Find the board in an image (H, W)."""
    if board.pattern == "chessboard":
        return _find_chessboard(image, board)
    found = _find_markers(image, board)
    if isinstance(found, Missed) and found.kind in ("not found", "cut off"):
        flipped = _find_markers(np.ascontiguousarray(image[:, ::-1]), board)
        if isinstance(flipped, Found):
            return Missed("mirrored", "the board is seen in the mirrored image only")
    return found


def refine_corners(image: Grey, uv_px: Array, free_px: Array, share: float = WINDOW_SHARE) -> Array:
    """Corners (n, 2), each refined within a share of the radius ``free_px`` (n,) in which nothing else is.

    NaN: lost.
    """
    windows = np.clip(np.round(share * free_px), MIN_WINDOW_PX, MAX_WINDOW_PX).astype(int)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    out = uv_px.copy()
    for window in np.unique(windows).tolist():
        part = windows == window
        start = np.ascontiguousarray(uv_px[part, None], dtype=np.float32)
        moved = cv2.cornerSubPix(image, start, (window, window), (-1, -1), criteria)
        out[part] = np.asarray(moved, dtype=np.float64).reshape(-1, 2)
    # one that runs out of its window has found something else
    astray = np.linalg.norm(out - uv_px, axis=1) > np.maximum(windows, 3)
    out[astray] = np.nan
    return out


def _reduce_image(image: Grey) -> tuple[Grey, float]:
    """The image as it is searched, and how much smaller it is."""
    # Boards are searched in images reduced to this; corners are refined in the full one
    factor = max(1.0, np.sqrt(image.size / 1_300_000))
    if factor == 1.0:
        return image, 1.0
    height, width = image.shape
    size = (round(width / factor), round(height / factor))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), width / size[0]


def _size(image: Grey) -> tuple[int, int]:
    """Width and height."""
    return image.shape[1], image.shape[0]


def _at_full_size(uv_px: Array, factor: float) -> Array:
    """Pixels of the full image; the centre of the first pixel is 0."""
    return (uv_px + 0.5) * factor - 0.5


# --- chessboards ---


def _find_chessboard(image: Grey, board: Board) -> Found | Missed:
    small, factor = _reduce_image(image)
    size = (board.columns, board.rows)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, corners = cv2.findChessboardCorners(small, size, flags=flags)
    if not ok:
        ok, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not ok:
        return _what_is_seen(small, board)
    rough = _at_full_size(np.asarray(corners, dtype=np.float64).reshape(-1, 2), factor)
    # the detector may take the outer corner of a square for the next one of a row
    expected, astray = _expected(image, board, rough)
    rough[astray] = expected[astray]
    grid = rough.reshape(board.rows, board.columns, 2)
    free_px = 0.5 * _grid_spacing(grid).ravel()
    uv = fit_corners(image, refine_corners(image, rough, free_px), FIT_SHARE * free_px)
    expected, astray = _expected(image, board, uv)
    good = ~astray
    # of a chessboard's corners, which the detector has found all
    if good.sum() < max(MIN_CORNERS, 0.8 * len(uv)):
        words = f"{int(astray.sum())} of {len(uv)} corners are not where the others expect them"
        return Missed("outlier", words)
    if beyond := _corners_beyond(image, np.where(astray[:, None], expected, uv).reshape(grid.shape)):
        return Missed("other board", f"the board goes on beyond its {board.words}, {beyond}")
    return Found(np.flatnonzero(good), uv[good])


def _expected(image: Grey, board: Board, uv_px: Array) -> tuple[Array, Bools]:
    """(N, 2) where all corners of a board expect each, and (N,) which of them are elsewhere, or NaN."""
    p_m = board.points[:, :2]
    known = fitted_map(p_m, uv_px, _size(image))
    expected = uv_px if known is None else known(p_m)
    off = np.linalg.norm(uv_px - expected, axis=1)
    limit_px = max(2.0 * MAX_ASTRAY_PX, 4.0 * float(np.nanmedian(off)))
    return expected, np.asarray(~(off <= limit_px))


def _grid_spacing(grid: Array) -> Array:
    """(rows, columns) least distance of each corner of a grid (rows, columns, 2) to its neighbours."""
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.inf)
    neighbours = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    return np.asarray(np.min([np.linalg.norm(each - grid, axis=2) for each in neighbours], axis=0))


def _sides(grid: Array) -> dict[str, Array]:
    """A grid (rows, columns, 2), by the words for what is beyond its first line, as lines from there."""
    turned = grid.transpose(1, 0, 2)
    return {
        "before the first row": grid,
        "after the last row": grid[::-1],
        "before the first column": turned,
        "after the last column": turned[::-1],
    }


def _corners_beyond(image: Grey, grid: Array) -> str:
    """Where the corners of a grid (rows, columns, 2) go on, in words; empty: nowhere."""
    usual = float(np.nanmedian(_saddle(image, grid.reshape(-1, 2), _grid_spacing(grid).ravel())))
    for words, side in _sides(grid).items():
        # extrapolated along each line of corners; the third difference is left out
        beyond = 3.0 * side[0] - 3.0 * side[1] + side[2] if len(side) > 2 else 2 * side[0] - side[1]
        response = _saddle(image, beyond, np.linalg.norm(side[0] - beyond, axis=1))
        seen = np.isfinite(response)
        if seen.sum() >= 3 and np.mean(response[seen] > 0.5 * usual) > 0.7:
            return words
    return ""


def _saddle(image: Grey, uv_px: Array, spacing_px: Array) -> Array:
    """(n,) how much the ring around a pixel looks like a corner of four squares; NaN: out of the image.

    Two cycles of brightness on the ring count, one cycle, as that of an edge or a single square's corner,
    against it (Bennett and Lasenby, "ChESS", CVIU 118, 2014).
    """
    angle = 2.0 * np.pi * np.arange(_RING) / _RING
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    at = uv_px[:, None] + 0.3 * spacing_px[:, None, None] * ring
    height, width = image.shape
    inside = ((at >= 0.0) & (at <= np.array([width - 1.0, height - 1.0]))).all(axis=(1, 2))
    values = cv2.remap(
        image.astype(np.float32),
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
    ).astype(np.float64)
    quarter = _RING // 4
    opposite = values + np.roll(values, -2 * quarter, axis=1)
    two = np.abs(opposite - np.roll(opposite, -quarter, axis=1)).sum(axis=1)
    one = np.abs(values - np.roll(values, -2 * quarter, axis=1)).sum(axis=1)
    return np.where(inside, two - one, np.nan)


def _what_is_seen(small: Grey, board: Board) -> Missed:
    """Why a chessboard was not found: the largest grid of corners that is seen."""
    ok, corners, meta = cv2.findChessboardCornersSBWithMeta(
        small, (3, 3), cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not ok:
        return Missed("not found", f"no chessboard of {board.words} is seen")
    rows, columns = meta.shape[:2]
    seen, stated = sorted((columns, rows)), sorted((board.columns, board.rows))
    if seen == stated:
        return Missed("not found", f"the chessboard of {board.words} is seen, but not clearly")
    if seen[0] > stated[0] or seen[1] > stated[1]:
        words = f"a chessboard of {columns}x{rows} inner corners is seen"
        return Missed("other board", words, (columns, rows))
    high = np.array([small.shape[1] - 1.0, small.shape[0] - 1.0])
    for side in _sides(np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2)).values():
        # the next line of corners, and half a square of margin
        beyond = side[0] + 1.5 * (side[0] - side[1])
        if ((beyond < 0.0) | (beyond > high)).any():
            return Missed("cut off", f"only {columns}x{rows} of {board.words} are in the image")
    words = f"only {columns}x{rows} of {board.words} are seen"
    if columns * rows < 0.4 * board.columns * board.rows:
        return Missed("not found", words)
    return Missed("covered", f"{words}, with a margin around", (columns, rows))


# --- boards with markers ---


def _find_markers(image: Grey, board: Board) -> Found | Missed:
    return _find_charuco(image, board) if board.pattern == "charuco" else _find_grid(image, board)


def _find_charuco(image: Grey, board: Board) -> Found | Missed:
    best: tuple[Array, Ints, list[Array], Ints, Any] | None = None
    for legacy in (False, True) if board.rows % 2 == 0 else (False,):
        theirs = board.opencv_charuco(legacy)
        found = cv2.aruco.CharucoDetector(theirs).detectBoard(image)
        corners, ids, markers, marker_ids = (() if each is None else each for each in found)
        if best is None or len(ids) > len(best[1]):
            uv = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
            seen = [np.asarray(each, float).reshape(4, 2) for each in markers] if len(marker_ids) else []
            numbers = (np.asarray(each, dtype=np.int64).ravel() for each in (ids, marker_ids))
            best = (uv, next(numbers), seen, next(numbers), theirs)
    assert best is not None
    uv, ids, seen, known, theirs = best
    if wrong := _foreign_markers(board, known):
        return Missed("other board", wrong)
    # corners of the markers that are seen, on OpenCV's board and in the image
    places = {
        int(i): np.asarray(p, dtype=np.float64)[:, :2]
        for i, p in zip(theirs.getIds().ravel(), theirs.getObjPoints(), strict=True)
    }
    both = [(places[int(i)], corner) for i, corner in zip(known, seen, strict=True) if int(i) in places]
    p_m, uv_px = (np.concatenate([np.empty((0, 2)), *(pair[k] for pair in both)]) for k in (0, 1))
    if len(known) >= 4 and (off := misfit(p_m, uv_px, board.square_m, _size(image))) > MAX_MISFIT:
        return Missed("other board", _misplaced(board, off))
    if len(ids) < MIN_CORNERS:
        return _too_few(len(ids), len(known), seen, image, board)
    return _finished(image, board, ids, uv, fitted_map(p_m, uv_px, _size(image)))


def _foreign_markers(board: Board, known: Ints) -> str:
    """What is said of markers that the board does not have; empty: there are none."""
    count = (board.columns * board.rows) // 2 if board.pattern == "charuco" else board.columns * board.rows
    foreign = known[known >= count]
    if len(foreign) < 2:
        return ""
    return f"marker {int(foreign.max())} is seen, and a board of {board.words} has 0 to {count - 1}"


def _misplaced(board: Board, off: float) -> str:
    return f"the markers lie {off:.1f} squares from where a board of {board.words} has them"


def _too_few(count: int, markers: int, seen: list[Array], image: Grey, board: Board) -> Missed:
    if not markers:
        return Missed("not found", f"no marker of the board of {board.words} is seen")
    points = np.concatenate(seen)
    middle = points.reshape(-1, 4, 2).mean(axis=1)
    side = float(np.median([np.linalg.norm(each[0] - each[1]) for each in seen]))
    high = np.array([image.shape[1] - 1.0, image.shape[0] - 1.0])
    near = ((middle < 2.0 * side) | (middle > high - 2.0 * side)).any()
    kind: Kind = "cut off" if near else "not found"
    return Missed(
        kind, f"only {count} corners and {markers} markers are seen; {MIN_CORNERS} corners are needed"
    )


def _finished(
    image: Grey, board: Board, ids: Ints, rough: Array, seen: BoardMap | None = None
) -> Found | Missed:
    """Corners refined in windows by their local scale; those of which that fails are left out.

    ``seen``: the map of the markers, where they tell more than the corners.
    """
    p_m = board.points[ids, :2]
    size, step_m = _size(image), 0.25 * board.square_m
    first = fitted_map(p_m, rough, size) if seen is None else seen
    if first is None:
        return Missed("not found", f"only {len(ids)} corners are seen; {MIN_CORNERS} are needed")
    free_px = first.scale(p_m, step_m) * board.free_m
    # a detector's corner of a tag may be pixels off: a wide window first
    near = refine_corners(image, rough, free_px, 0.85) if seen is None else rough
    uv = refine_corners(image, np.where(np.isfinite(near), near, rough), free_px)
    # a detector's corner may be where a tag touches its neighbour: once more, from where the others expect it
    known = (seen if seen is not None else fitted_map(p_m, uv, size)) or first
    expected = known(p_m)
    off = np.linalg.norm(uv - expected, axis=1)
    astray = ~(off <= np.maximum(MAX_ASTRAY_PX, 3.0 * np.nanmedian(off)))
    uv[astray] = refine_corners(image, expected[astray], free_px[astray])
    height, width = image.shape
    inside = ((expected > 3.0) & (expected < np.array([width - 4.0, height - 4.0]))).all(axis=1)
    uv = fit_corners(image, uv, FIT_SHARE * free_px)
    near_enough = np.linalg.norm(uv - expected, axis=1) <= np.maximum(3.0 * MAX_ASTRAY_PX, 0.2 * free_px)
    good: Bools = inside & near_enough & (_saddle(image, uv, free_px) > 0.0)
    if good.sum() < MIN_CORNERS:
        return Missed("cut off", f"only {int(good.sum())} corners are well inside the image")
    order = np.argsort(ids[good], kind="stable")
    return Found(ids[good][order], uv[good][order])


def _find_grid(image: Grey, board: Board) -> Found | Missed:
    """A grid of AprilTags; which way the tags are turned on it, and which row is first, the image shows."""
    small, factor = _reduce_image(image)
    tags, known = max((_tags(small, board, bits) for bits in (2, 1)), key=lambda each: len(each[1]))
    if wrong := _foreign_markers(board, known):
        return Missed("other board", wrong)
    inside = known < board.columns * board.rows
    tags, known = [tag for tag, good in zip(tags, inside, strict=True) if good], known[inside]
    if len(known) < 2:
        return _too_few(4 * len(known), len(known), tags, small, board)
    corners = _at_full_size(np.stack(tags), factor)
    best, least = np.empty(0, np.int64), np.inf
    size, uv_px = _size(image), corners.reshape(-1, 2)
    row, column = known // board.columns, known % board.columns
    for turn in range(4):
        for place in (row, board.rows - 1 - row):
            # OpenCV lists the corners of each tag clockwise from the left above
            clockwise = np.roll(np.array([3, 2, 1, 0]), turn)
            ids = (4 * (place * board.columns + column)[:, None] + clockwise).ravel()
            off = misfit(board.points[ids, :2], uv_px, board.square_m, size, bent=False)
            if off < 0.9 * least:
                best, least = ids, off
    if len(best) and least > MAX_MISFIT:
        least = misfit(board.points[best, :2], uv_px, board.square_m, size)
    if not len(best) or least > MAX_MISFIT:
        return Missed("other board", _misplaced(board, least).replace("squares", "tags"))
    return _finished(image, board, best, uv_px)


def count_markers(image: Grey, board: Board) -> int:
    """How many markers of the board's dictionary an image shows, whichever their border."""
    return max(len(_tags(image, board, border_bits)[1]) for border_bits in (1, 2))


def _tags(image: Grey, board: Board, border_bits: int) -> tuple[list[Array], Ints]:
    """Corners (4, 2) of each tag and their numbers; Kalibr's tags have a border of two bits, others one."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_bits
    parameters.minMarkerPerimeterRate = 0.012
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    detector = cv2.aruco.ArucoDetector(board.opencv_dictionary(), parameters)
    found: dict[int, Array] = {}
    for width in (1, 3, 5):
        # Kalibr's squares touch the tags' corners: where outlines run together, black is made thinner
        loose = image if width == 1 else cv2.dilate(image, np.ones((width, width), np.uint8))
        corners, ids, _ = detector.detectMarkers(loose)
        for each, tag in zip(corners, [] if ids is None else np.ravel(ids).tolist(), strict=False):
            found.setdefault(int(tag), np.asarray(each, dtype=np.float64).reshape(4, 2))
        if len(found) >= board.columns * board.rows or (width == 1 and not found and border_bits == 1):
            break
    return list(found.values()), np.array(list(found), dtype=np.int64)
