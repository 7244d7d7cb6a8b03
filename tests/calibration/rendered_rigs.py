"""Folders of rendered images of a board, for the tests of this room; kept small."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.calibration.adjustment import RigState
from polhode.calibration.boards import Board
from polhode.calibration.lenses import Lens
from polhode.files.images import Grey
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.records.dataset_writer import write_png
from tests.calibration.board_images import BoardCamera, printed

SIZE = (320, 240)
X_10 = make_pose(exp_so3([0.01, -0.03, 0.02]), [-0.06, 0.001, -0.002])
LENSES = (
    Lens("brown5", np.array([300.0, 301.0, 162.0, 117.0, -0.2, 0.05, 0.0006, -0.0004, 0.0])),
    Lens("brown5", np.array([304.0, 304.5, 156.0, 121.0, -0.22, 0.06, -0.0003, 0.0005, 0.0])),
)
BLUR_PX, NOISE = 0.7, 1.0


@dataclass(frozen=True)
class Scene:
    """A rig and boards before it."""

    board: Board
    truth: RigState
    cameras: tuple[BoardCamera, BoardCamera]

    def image(
        self, camera: int, X_0B: Array, seed: int, board: Board | None = None, blur_px: float = BLUR_PX
    ) -> Grey:
        """What a camera sees of a board at a pose."""
        X_CB = X_0B if camera == 0 else self.truth.X_10 @ X_0B
        rng = np.random.default_rng(seed)
        return self.cameras[camera].picture(printed(board or self.board), X_CB, blur_px, NOISE, rng)


def board_pose(board: Board, rng: np.random.Generator, facing: Array | None = None) -> Array:
    """(4, 4) of a board that both cameras see whole."""
    middle = 0.5 * (board.points.min(axis=0) + board.points.max(axis=0))
    R = exp_so3(rng.uniform(-0.5, 0.5, 3)) @ (np.eye(3) if facing is None else facing)
    at = np.array([0.03, 0.0, 0.42]) + rng.uniform(-1.0, 1.0, 3) * [0.04, 0.04, 0.05]
    return make_pose(R, at - R @ middle)


def make_scene(board: Board, views: int, seed: int, facing: Array | None = None) -> Scene:
    """Boards at random poses."""
    rng = np.random.default_rng(seed)
    poses = np.array([board_pose(board, rng, facing) for _ in range(views)])
    truth = RigState(LENSES, poses, X_10)
    return Scene(board, truth, (BoardCamera(LENSES[0], SIZE), BoardCamera(LENSES[1], SIZE)))


def write_images(folder: Path, images: Sequence[tuple[Grey, Grey]]) -> None:
    """left/01.png, right/01.png, ..."""
    for number, pair in enumerate(images, start=1):
        for side, image in zip(("left", "right"), pair, strict=True):
            write_png(folder / side / f"{number:02d}.png", image)
