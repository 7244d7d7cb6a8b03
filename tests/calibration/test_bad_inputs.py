"""Recordings and boards that cannot be calibrated: one line that names them, exit code 2, nothing written."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polhode.calibration.boards import Board, make_board
from polhode.cli.main import main
from tests.calibration.rendered_rigs import Scene, make_scene, write_images
from tests.importers.recordings import BagContents, Original, original, write_ros2, write_side_by_side

UPWARD = np.diag([1.0, -1.0, -1.0])


def refused(words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a calibration that is refused and leaves nothing."""
    out = folder / "out" / "rig"
    capsys.readouterr()
    assert main(["calibrate", *words, "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and not out.parent.exists()
    return error


@pytest.mark.parametrize(
    ("record", "said"),
    [
        (
            lambda data, area: write_ros2(data, area / "bag", BagContents(cameras=(), tf=False)),
            "an empty bag, without a single message; record it again",
        ),
        (
            lambda data, area: write_side_by_side(data, area / "v.mkv"),
            "0 of 6 left images can be used, at least 4 are needed: left image 0 (not found: ",
        ),
    ],
)
def test_a_recording_that_cannot_be_used_is_one_line(
    record: Callable[[Original, Path], Path],
    said: str,
    small_sequence: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = record(original(small_sequence), tmp_path)
    assert said in refused([str(source), "--board", "7x5", "--square-mm", "30"], tmp_path, capsys)


def written(board: Board, folder: Path) -> list[str]:
    scene: Scene = make_scene(board, 4, 4, UPWARD if board.pattern == "aprilgrid" else None)
    poses = enumerate(scene.truth.X_CB)
    write_images(folder, [(scene.image(0, X, 2 * k), scene.image(1, X, 2 * k + 1)) for k, X in poses])
    return ["--left", str(folder / "left"), "--right", str(folder / "right"), "--pattern", board.pattern]


@pytest.mark.parametrize(
    ("pattern", "true", "square_mm", "wrong"),
    [
        ("chessboard", "7x5", 30.0, ("6x5", "8x5", "7x4", "7x6")),
        ("charuco", "8x6", 30.0, ("7x6", "9x6", "8x5")),
        ("aprilgrid", "4x3", 50.0, ("3x3", "5x3", "4x2")),
    ],
)
def test_a_board_whose_size_is_wrong_by_one_is_one_line(
    pattern: str,
    true: str,
    square_mm: float,
    wrong: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = written(make_board(pattern, true, 1e-3 * square_mm), tmp_path / "images")
    for size in wrong:
        error = refused([*words, "--board", size, "--square-mm", f"{square_mm:g}"], tmp_path, capsys)
        if pattern == "chessboard":
            assert error == (
                f"polhode: error: --board {size}: the images show a chessboard of {true} inner corners; "
                f"give --board {true}\n"
            )
        else:
            assert f"--board {size}: " in error and "images show another board" in error, error
