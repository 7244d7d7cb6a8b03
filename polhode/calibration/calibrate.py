"""The flow of a calibration: find the boards, leave out what spoils it, adjust each camera and then both."""

import logging
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import NamedTuple

import cv2
import numpy as np

from polhode.calibration.adjustment import Adjusted, CornerData, RigState, adjust
from polhode.calibration.boards import Board, dictionaries
from polhode.calibration.detection import Found, Kind, Missed, count_markers, find_board
from polhode.calibration.image_pairs import SIDES, ImagePairs
from polhode.calibration.lenses import Model
from polhode.calibration.pair_consensus import MIN_PAIRS, Pair, agree
from polhode.calibration.start_values import calibrated_alone
from polhode.files.images import Grey
from polhode.geometry.lie import Array, Bools
from polhode.pipeline.checkout.image_quality import edge_widths, noise_level
from polhode.records.rig_calibration import USUAL_BASELINES_M
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

MIN_VIEWS = 4
"""Of each camera: fewer leave its values open."""


class Rejection(NamedTuple):
    """An image that is left out."""

    file: str
    kind: Kind
    words: str

    @property
    def reason(self) -> str:
        """One line."""
        return f"{self.kind}: {self.words}"


@dataclass
class Views:
    """What was found in the images, by camera and pair."""

    board: Board
    pairs: ImagePairs
    found: tuple[dict[int, Found], dict[int, Found]] = field(default_factory=lambda: ({}, {}))
    missed: tuple[dict[int, Missed], dict[int, Missed]] = field(default_factory=lambda: ({}, {}))
    edge_px: tuple[dict[int, float], dict[int, float]] = field(default_factory=lambda: ({}, {}))
    sizes_px: tuple[dict[int, tuple[int, int]], dict[int, tuple[int, int]]] = field(
        default_factory=lambda: ({}, {})
    )

    @property
    def count(self) -> int:
        """Pairs."""
        return len(self.pairs.names[0])

    def reject(self, camera: int | None, pair: int, kind: Kind, words: str) -> None:
        """Leave out an image, or both of a pair (None)."""
        for each in (0, 1) if camera is None else (camera,):
            if self.found[each].pop(pair, None) is not None:
                self.missed[each][pair] = Missed(kind, words)

    def rejections(self) -> list[Rejection]:
        """All images that are left out, pair by pair."""
        return [
            Rejection(self.pairs.names[camera][pair] or "", missed.kind, missed.words)
            for pair in range(self.count)
            for camera in (0, 1)
            if (missed := self.missed[camera].get(pair)) is not None
        ]

    def size_px(self, camera: int) -> tuple[int, int]:
        """Width and height of a camera's images."""
        return Counter(self.sizes_px[camera].values()).most_common(1)[0][0]

    def data(self, camera: int) -> CornerData:
        """The corners of a camera's images."""
        own = sorted(self.found[camera].items())
        view = [np.full(len(found.ids), pair) for pair, found in own]
        return CornerData(
            np.concatenate(view).astype(np.int64),
            np.concatenate([self.board.points[found.ids] for _, found in own]),
            np.concatenate([found.uv_px for _, found in own]),
        )


@dataclass(frozen=True)
class CalibratedRig:
    """The result of a calibration."""

    views: Views
    adjusted: Adjusted
    """Both cameras together"""
    data: tuple[CornerData, CornerData]
    """The corners that it rests on"""
    alone_px: tuple[float, float]
    """Root mean square length of the residuals of each camera calibrated alone, of the same corners [px]"""
    left_out: int
    """Single corners that are left out"""

    @property
    def state(self) -> RigState:
        """Lenses and poses."""
        return self.adjusted.state

    @property
    def used(self) -> tuple[list[int], list[int]]:
        """Pairs whose left, and whose right image is used."""
        return sorted(self.views.found[0]), sorted(self.views.found[1])

    @property
    def doubt_of_size(self) -> str:
        """What speaks against the stated size of the squares; empty: nothing."""
        baseline_m, square_m = float(np.linalg.norm(self.state.X_10[:3, 3])), self.views.board.square_m
        if USUAL_BASELINES_M[0] <= baseline_m <= USUAL_BASELINES_M[1]:
            return ""
        return (
            f"with squares of {1e3 * square_m:g} mm the cameras are {1e3 * baseline_m:.3g} mm apart, which "
            "no rig has: give --square-mm in millimetres, as measured on the board"
        )


_log = logging.getLogger(__name__)
LOOKED_AT = 6
"""Images in which other dictionaries are looked for"""


def calibrate(
    pairs: ImagePairs, board: Board, models: tuple[Model, Model], progress: Progress
) -> CalibratedRig:
    """Calibrate the rig from images of a board.

    Raises InputError: too few usable images, another board than stated, images of several sizes.
    """
    views = _find_views(pairs, board, progress)
    _require_board(views)
    _require_dictionary(views)
    _leave_out_blurred(views)
    if pairs.is_dense:
        _leave_out_repeated(views)
    with progress.stage("adjusting", 4) as advance:
        _require_enough(views)
        alone = _each_alone(views, models)
        advance()
        both = sorted(views.found[0].keys() & views.found[1].keys())
        pairs_seen = [Pair(k, views.found[0][k], views.found[1][k]) for k in both]
        sizes = (views.size_px(0), views.size_px(1))
        consensus = agree(pairs_seen, board, [each.state.lenses[0] for each in alone], sizes)
        # pairs that contradict the others are left out; right corners take the left ones' order
        for pair in consensus.agreeing:
            views.found[1][pair.index] = pair.right
        for index, camera, kind, words in consensus.spoiled:
            views.reject(camera, index, kind, words)
        _require_enough(views)
        if consensus.spoiled:
            alone = _each_alone(views, models)
        advance()
        # a board that only the right camera sees is placed by it
        X_CB, X_01 = alone[0].state.X_CB.copy(), np.linalg.inv(consensus.X_10)
        for k in set(range(views.count)) - views.found[0].keys():
            X_CB[k] = X_01 @ alone[1].state.X_CB[k]
        lenses = (alone[0].state.lenses[0], alone[1].state.lenses[0])
        state = _without_outliers(views, RigState(lenses, X_CB, consensus.X_10))
        _require_enough(views)
        advance()
        result = _adjust_finally(views, state)
        advance()
    if result.doubt_of_size:
        _log.warning(result.doubt_of_size)
    return result


def _each_alone(views: Views, models: tuple[Model, Model]) -> list[Adjusted]:
    """Each camera by itself."""
    return [calibrated_alone(views.data(c), models[c], views.size_px(c), views.count) for c in (0, 1)]


def _find_views(pairs: ImagePairs, board: Board, progress: Progress) -> Views:
    """Look for the board in all images. Raises InputError if the images of a camera have no usual size."""
    views = Views(board, pairs)
    total = sum(name is not None for side in pairs.names for name in side)
    with progress.stage("finding boards", total) as advance:
        for each in pairs.images():
            if each.pixels is None:
                views.missed[each.camera][each.pair] = Missed("unreadable", each.fault)
            else:
                views.sizes_px[each.camera][each.pair] = (each.pixels.shape[1], each.pixels.shape[0])
                found = find_board(each.pixels, board)
                side = views.found if isinstance(found, Found) else views.missed
                side[each.camera][each.pair] = found  # type: ignore[assignment]
                seen = found.uv_px if isinstance(found, Found) else None
                views.edge_px[each.camera][each.pair] = _edge_px(each.pixels, seen)
            advance()
    for camera in (0, 1):
        sizes = Counter(views.sizes_px[camera].values())
        if not sizes:
            raise InputError(f"none of the {SIDES[camera]} images can be read: {_first_reasons(views)}")
        usual, count = sizes.most_common(1)[0]
        if count < 0.6 * sizes.total():
            said = ", ".join(f"{number} of {w}x{h}" for (w, h), number in sizes.most_common(3))
            raise InputError(
                f"the {SIDES[camera]} images have several sizes ({said} px): give those of one camera, as it "
                "records them"
            )
        for pair, size in views.sizes_px[camera].items():
            if size != usual:
                said = f"{size[0]}x{size[1]} px, where the camera's other images have {usual[0]}x{usual[1]}"
                views.found[camera].pop(pair, None)
                views.missed[camera][pair] = Missed("other size", said)
    return views


def _edge_px(image: Grey, uv_px: Array | None) -> float:
    """Width of the edges on the board, or in the whole image; NaN: too few."""
    inside: Bools = np.ones(image.shape, dtype=np.bool_)
    if uv_px is not None:
        hull = cv2.convexHull(np.round(uv_px).astype(np.int32)[:, None])
        inside = cv2.fillConvexPoly(np.zeros(image.shape, np.uint8), hull, 1) > 0
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    return edge_widths(image[box], inside[box], noise_level(image[box], inside[box]))[0]


def _require_board(views: Views) -> None:
    """Raise InputError if the images show another board than stated."""
    found = sum(map(len, views.found))
    missed = [each for side in views.missed for each in side.values()]
    other = [each for each in missed if each.kind == "other board" or each.seen is not None]
    if len(other) <= 0.5 * (found + len(other)) or len(other) < 2:
        return
    board = views.board
    seen = Counter(each.seen for each in other if each.seen is not None).most_common(1)
    if seen and seen[0][1] >= 0.5 * len(other):
        columns, rows = seen[0][0] or (0, 0)
        size = f"{max(columns, rows)}x{min(columns, rows)}"
        raise InputError(
            f"--board {board.columns}x{board.rows}: the images show a chessboard of {size} inner corners; "
            f"give --board {size}"
        )
    raise InputError(
        f"--board {board.columns}x{board.rows}: {len(other)} images show another board ({other[0].words}); "
        "count its sides again"
    )


def _require_dictionary(views: Views) -> None:
    """Raise InputError if hardly an image shows the board, and most markers are of another dictionary."""
    board = views.board
    if board.pattern == "chessboard" or sum(map(len, views.found)) > 0.2 * sum(map(len, views.missed)):
        return
    images = [each.pixels for each in islice(views.pairs.images(), LOOKED_AT) if each.pixels is not None]
    counts = {
        name: sum(count_markers(image, replace(board, dictionary=name)) for image in images)
        for name in dictionaries()
    }
    best = max(counts, key=lambda name: counts[name])
    if counts[best] > max(2 * counts[board.dictionary], 2 * len(images)):
        raise InputError(
            f"the images show markers of {best}, not of {board.dictionary}: give --dictionary {best}"
        )


def _leave_out_blurred(views: Views) -> None:
    """Name what is blurred: images whose edges are far wider than those of the camera's usual image."""
    for camera in (0, 1):
        widths = views.edge_px[camera]
        known = [widths[pair] for pair in views.found[camera] if np.isfinite(widths[pair])]
        if not known:
            continue
        usual = float(np.median(known))
        for pair, width in widths.items():
            # edges below 1.2 px are sharp, whatever the others are
            if not width > max(2.0 * usual, 1.2):
                continue
            words = f"edges are {width:.1f} px wide, and {usual:.1f} px in the usual image"
            if pair in views.found[camera]:
                views.reject(camera, pair, "blurred", words)
            elif views.missed[camera][pair].kind == "not found":
                views.missed[camera][pair] = Missed("blurred", words)


def _leave_out_repeated(views: Views) -> None:
    """Of a recording, keep one image of each place of the board: equal ones would only count twice."""

    def is_same(one: Found, two: Found) -> bool:
        _, a, b = np.intersect1d(one.ids, two.ids, return_indices=True)
        if len(a) < 0.8 * min(len(one.ids), len(two.ids)):
            return False
        apart_px = np.median(np.linalg.norm(one.uv_px[a] - two.uv_px[b], axis=1))
        return bool(apart_px <= 0.004 * max(views.size_px(0)))

    kept: list[list[Found]] = []
    for pair in range(views.count):
        seen = [views.found[camera][pair] for camera in (0, 1) if pair in views.found[camera]]
        if any(len(seen) == len(other) and all(map(is_same, seen, other)) for other in kept if seen):
            views.reject(None, pair, "repeated", "the board is where an earlier image shows it")
        elif seen:
            kept.append(seen)


def _require_enough(views: Views) -> None:
    """Raise InputError, with the first reasons, if too few images are left."""
    for camera in (0, 1):
        count = len(views.found[camera])
        if count < MIN_VIEWS:
            raise InputError(
                f"{count} of {len(views.sizes_px[camera])} {SIDES[camera]} images can be used, at least "
                f"{MIN_VIEWS} are needed: {_first_reasons(views)}"
            )
    both = len(views.found[0].keys() & views.found[1].keys())
    if both < MIN_PAIRS:
        raise InputError(
            f"{both} pairs show the board in both images, at least {MIN_PAIRS} are needed: "
            f"{_first_reasons(views)}"
        )


def _first_reasons(views: Views) -> str:
    said = [f"{each.file} ({each.reason})" for each in views.rejections()]
    return "; ".join(said[:2]) + (f"; {len(said) - 2} more" if len(said) > 2 else "") or "no images"


def view_rms(residuals: Array, data: CornerData, count: int) -> Array:
    """(V,) root mean square length of the residuals of each view [px]; NaN: no corners."""
    corners = np.bincount(data.view, minlength=count)
    squares = np.bincount(data.view, np.nan_to_num((residuals**2).sum(axis=1), nan=1e6), count)
    return np.where(corners > 0, np.sqrt(squares / np.maximum(corners, 1)), np.nan)


def _without_outliers(views: Views, state: RigState) -> RigState:
    """Adjust robustly, leaving out view by view what stays far from the common solution."""
    for _ in range(6):
        data = (views.data(0), views.data(1))
        result = adjust(data, state, np.ones(state.shared, np.bool_), robust=True)
        state = result.state
        worst: list[tuple[float, int, int, float, float]] = []
        for camera in (0, 1):
            rms = view_rms(result.residuals[camera], data[camera], views.count)
            usual = float(np.nanmedian(rms))
            # views within 0.3 px are weighted by their own noise instead
            limit = max(3.5 * usual, 0.3)
            worst += [
                (rms[pair] / limit, camera, pair, float(rms[pair]), usual)
                for pair in views.found[camera]
                if rms[pair] > limit
            ]
        if not worst:
            break
        # what is worst spoils others, first of all its partner: those nearly as bad go with it, the rest is
        # looked at again
        worst.sort(reverse=True)
        seen: set[int] = set()
        for share, camera, pair, off, usual in worst:
            if share <= 0.5 * worst[0][0] or pair in seen:
                continue
            seen.add(pair)
            if pair in views.found[1 - camera]:
                # the place of the board is a compromise of both: at fault is the image that no place fits
                alone = [_alone_rms(data[c], state, c, pair) for c in (0, 1)]
                camera, off = int(np.argmax(alone)), max(off, *alone)
            words = f"corners are {off:.2f} px off the common solution, {usual:.2f} px in the usual image"
            views.reject(camera, pair, "outlier", words)
        _require_enough(views)
    return state


def _alone_rms(data: CornerData, state: RigState, camera: int, pair: int) -> float:
    """Root mean square length of the residuals of one image, its board placed by itself [px]."""
    own = data.kept(data.view == pair)
    poses = state.X_CB if camera == 0 else state.X_10 @ state.X_CB
    single = RigState((state.lenses[camera],), poses[pair : pair + 1], np.eye(4))
    here = CornerData(np.zeros_like(own.view), own.p_B, own.uv_px)
    fixed = np.zeros(single.shared, dtype=np.bool_)
    return rms_px(adjust((here,), single, fixed, robust=False).residuals[0])


def _adjust_finally(views: Views, state: RigState) -> CalibratedRig:
    """Least squares of what is left, single wrong corners left out."""
    data = [views.data(0), views.data(1)]
    result = adjust(data, state, np.ones(state.shared, np.bool_), robust=True)
    left_out = 0
    for camera in (0, 1):
        off = np.linalg.norm(result.residuals[camera], axis=1)
        # standard deviations of the corner's view
        good = off <= 6.0 * result.sigma_px[camera][data[camera].view]
        left_out += int((~good).sum())
        data[camera] = data[camera].kept(good)
    result = adjust(data, result.state, np.ones(state.shared, np.bool_), robust=False)
    alone = []
    for camera in (0, 1):
        poses = result.state.X_CB if camera == 0 else result.state.X_10 @ result.state.X_CB
        own = RigState((result.state.lenses[camera],), poses, np.eye(4))
        single = adjust((data[camera],), own, np.ones(own.shared, np.bool_), robust=False, by_view=False)
        alone.append(rms_px(single.residuals[0]))
    return CalibratedRig(views, result, (data[0], data[1]), (alone[0], alone[1]), left_out)


def rms_px(residuals: Array) -> float:
    """Root mean square length of residuals (n, 2), as OpenCV states it."""
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))
