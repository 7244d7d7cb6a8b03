"""Which pairs of images agree on where the right camera is, and what is wrong with those that do not.

Each pair proposes a pose of the right camera; the proposal counts that predicts the corners of most pairs.
A chessboard looks the same after half a turn (a square one after a quarter), so each proposal and each
prediction is tried in all orders of the corners; over boards at different attitudes only the true one agrees.
A pair that does not agree is explained by what makes it agree: exchanged cameras, a mirrored image, squares
of another size; otherwise the board moved between its two images.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.calibration.adjustment import CornerData
from polhode.calibration.boards import Board
from polhode.calibration.detection import Found, Kind
from polhode.calibration.lenses import Lens, project
from polhode.calibration.start_values import board_poses
from polhode.geometry.lie import Array, Ints, inverse_pose, log_so3, transform_points
from polhode.runtime.errors import InputError

MIN_PAIRS = 3


@dataclass(frozen=True)
class Pair:
    """A pair in which both cameras see the board."""

    index: int
    left: Found
    right: Found


@dataclass(frozen=True)
class Consensus:
    """What the pairs say."""

    X_10: Array
    """(4, 4)"""
    agreeing: tuple[Pair, ...]
    """With the corners of the right image in the left one's order"""
    spoiled: tuple[tuple[int, int | None, Kind, str], ...]
    """Index of a pair, camera (None: both), and what is wrong"""


def orders(board: Board, mirrored: bool = False) -> list[Ints]:
    """Permutations (N,) of the corners under which a chessboard looks the same, or like its mirror image."""
    count = len(board.points)
    if board.pattern != "chessboard":
        return [] if mirrored else [np.arange(count)]
    grid = np.arange(count).reshape(board.rows, board.columns)
    if mirrored:
        grid = grid[:, ::-1]
    turns = range(4) if board.rows == board.columns else (0, 2)
    return [np.rot90(grid, turn).ravel() for turn in turns]


def agree(
    pairs: Sequence[Pair], board: Board, lenses: Sequence[Lens], sizes_px: Sequence[tuple[int, int]]
) -> Consensus:
    """The consensus of all pairs. Raises InputError if most do not agree."""
    # a limit [px] of the distance from the prediction
    # of the larger side of the image: a prediction by the board's pose in the left camera alone, whose
    # distance has an error, may be off by so much
    judge = _Judge(board, lenses, max(4.0, 0.012 * max(sizes_px[1])))
    X_10 = judge.proposal(pairs)
    agreeing, spoiled = [], []
    for pair in pairs:
        error, order = judge.error(X_10, pair)
        if error <= judge.limit_px:
            agreeing.append(replace(pair, right=replace(pair.right, ids=order[pair.right.ids])))
        else:
            spoiled.append((pair.index, *judge.explained(X_10, pair, error, sizes_px)))
    least = max(MIN_PAIRS, 0.4 * len(pairs))
    if len(agreeing) < least:
        raise InputError(
            f"only {len(agreeing)} of {len(pairs)} pairs agree on where the right camera is: do the images "
            "of each pair show the board at the same moment, in the order of the pairs?"
        )
    return Consensus(X_10, tuple(agreeing), tuple(spoiled))


class _Judge:
    """Predicts the corners of right images from left ones."""

    def __init__(self, board: Board, lenses: Sequence[Lens], limit_px: float) -> None:
        self.board, self.lenses, self.limit_px = board, lenses, limit_px
        self.orders = orders(board)
        self._poses: dict[tuple[int, int], tuple[Found, Array]] = {}

    def pose(self, camera: int, found: Found) -> Array:
        """(4, 4) of the board in a camera, by one image alone."""
        key = (camera, id(found))
        if key not in self._poses:
            # with the corners themselves: the identity of an object that is gone may be given again
            data = CornerData(np.zeros(len(found.ids), np.int64), self.board.points[found.ids], found.uv_px)
            self._poses[key] = (found, board_poses(self.lenses[camera], data, 1)[0][0])
        return self._poses[key][1]

    def error(self, X_10: Array, pair: Pair, scale: float = 1.0) -> tuple[float, Ints]:
        """Median distance [px] of the right corners from their prediction; the order where it is least."""
        X_0B = self.pose(0, pair.left).copy()
        X_0B[:3, 3] *= scale
        X_1B = X_10 @ X_0B
        best, least = self.orders[0], np.inf
        for order in self.orders:
            p = scale * self.board.points[order[pair.right.ids]]
            off = np.linalg.norm(
                project(self.lenses[1], transform_points(X_1B, p)) - pair.right.uv_px, axis=1
            )
            error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
            if error < least:
                best, least = order, error
        return least, best

    def proposal(self, pairs: Sequence[Pair]) -> Array:
        """The pose of the right camera that predicts most pairs; of equal ones the least turned."""
        some = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), 40)).astype(int))
        best, most = np.eye(4), (-1.0, 0.0)
        for k in some.tolist():
            X_1B, X_B0 = self.pose(1, pairs[k].right), inverse_pose(self.pose(0, pairs[k].left))
            for order in self.orders:
                X_10 = X_1B @ inverse_pose(self._turn(order)) @ X_B0
                off = np.array([self.error(X_10, pair)[0] for pair in pairs])
                near = np.minimum(off / self.limit_px, 1.0)
                angle = float(np.linalg.norm(log_so3(X_10[:3, :3])))
                score = (float((off <= self.limit_px).sum()), -float(near.mean()) - 0.02 * angle)
                if score > most:
                    best, most = X_10, score
        return best

    def _turn(self, order: Ints) -> Array:
        """(4, 4) motion of the board that takes each corner to the one of that number."""
        p, q = self.board.points, self.board.points[order]
        U, _, Vt = np.linalg.svd((p - p.mean(axis=0)).T @ (q - q.mean(axis=0)))
        R = (U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt).T
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, q.mean(axis=0) - R @ p.mean(axis=0)
        return X

    def explained(
        self, X_10: Array, pair: Pair, error: float, sizes_px: Sequence[tuple[int, int]]
    ) -> tuple[int | None, Kind, str]:
        """The camera at fault (None: both), and what is wrong with a pair."""
        swapped = self.error(X_10, Pair(pair.index, pair.right, pair.left))[0]
        trials: list[tuple[float, int | None, Kind, str]] = [
            (swapped, None, "swapped", "left and right are exchanged: as the other camera's they fit")
        ]
        if self.board.pattern == "chessboard":
            # where the corners are in the mirror images, numbered as on the board itself
            ids, at = orders(self.board, mirrored=True)[0], [size[0] - 1.0 for size in sizes_px]
            left, right = (
                Found(ids[found.ids], np.array([middle, 0.0]) + found.uv_px * np.array([-1.0, 1.0]))
                for found, middle in zip((pair.left, pair.right), at, strict=True)
            )
            said = "its mirror image fits the other pairs"
            for camera, trial in (
                (0, Pair(pair.index, left, pair.right)),
                (1, Pair(pair.index, pair.left, right)),
                (None, Pair(pair.index, left, right)),
            ):
                trials.append((self.error(X_10, trial)[0], camera, "mirrored", said))
        scale = self._scale(X_10, pair)
        if scale is not None:
            size = f"its squares are {scale:.3g} times as large as those of the other images"
            trials.append((self.error(X_10, pair, scale=scale)[0], None, "other board", size))
        best = min(trials, key=lambda trial: trial[0])
        if best[0] <= self.limit_px:
            return best[1], best[2], best[3]
        return (
            None,
            "moved",
            f"the two images do not show the board at the same place, by {error:.0f} px: it moved between "
            "them, or they are no pair",
        )

    def _scale(self, X_10: Array, pair: Pair) -> float | None:
        """How many times larger the squares of this pair are, if that alone is wrong."""
        X_1B, X_B0 = self.pose(1, pair.right), inverse_pose(self.pose(0, pair.left))
        for order in self.orders:
            own = X_1B @ inverse_pose(self._turn(order)) @ X_B0
            if np.linalg.norm(log_so3(own[:3, :3].T @ X_10[:3, :3])) < np.radians(3.0):
                scale = float(np.linalg.norm(X_10[:3, 3])) / max(float(np.linalg.norm(own[:3, 3])), 1e-9)
                if max(scale, 1.0 / scale) > 1.03:
                    return scale
        return None
