"""Rendered boards: the rig is found, and each spoiled image is left out by its reason."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from polhode.calibration.boards import Board, make_board
from polhode.calibration.calibrate import CalibratedRig, calibrate
from polhode.calibration.detection import Found
from polhode.calibration.image_pairs import opened_pairs, pairs_of_files
from polhode.calibration.lenses import project
from polhode.calibration.pair_consensus import Pair, agree
from polhode.calibration.result import result_of
from polhode.cli.main import main
from polhode.files.images import Grey
from polhode.geometry.lie import Array, inverse_pose, log_so3, make_pose, transform_points
from polhode.importers.calibrations.read_rig import read_rig
from polhode.importers.options import ImportOptions
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_sensor
from polhode.records.rig_calibration import read_calibration
from polhode.runtime.progress import Silent
from tests.calibration.rendered_rigs import SIZE, Scene, board_pose, make_scene, write_images
from tests.importers.recordings import BagContents, original, write_ros2, write_side_by_side

Capture = pytest.CaptureFixture[str]
VIEWS = 10
BOARD = make_board("chessboard", "7x5", 0.03)


def calibrated(folder: Path, board: Board = BOARD) -> CalibratedRig:
    pairs = pairs_of_files([str(folder / "left")], [str(folder / "right")])
    return calibrate(pairs, board, ("brown5", "brown5"), Silent())


def sigmas_off(rig: CalibratedRig, scene: Scene) -> Array:
    """Errors of lenses and pose in standard deviations."""
    truth, found = scene.truth, rig.state
    values = [a.values - b.values for a, b in zip(found.lenses, truth.lenses, strict=True)]
    turn = log_so3(truth.X_10[:3, :3].T @ found.X_10[:3, :3])
    off = np.concatenate([*values, turn, found.X_10[:3, 3] - truth.X_10[:3, 3]])
    return np.asarray(off / np.sqrt(np.diag(rig.adjusted.covariance)))


def pairs_of(scene: Scene) -> list[tuple[Grey, Grey]]:
    return [(scene.image(0, X, 2 * k), scene.image(1, X, 2 * k + 1)) for k, X in enumerate(scene.truth.X_CB)]


def waved(image: Grey, rows: float) -> Grey:
    """The same, shaken while its rows were read: 1.5 px to and fro, a radian in so many rows."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    return np.asarray(cv2.remap(image, u + 1.5 * np.sin(v / rows), v, cv2.INTER_LINEAR), dtype=np.uint8)


def both(folder: Path) -> list[str]:
    return ["--left", str(folder / "left"), "--right", str(folder / "right")]


def refused(words: list[str], folder: Path, capsys: Capture) -> str:
    """The one line of a calibration that is refused and leaves nothing."""
    out = folder / "out" / "rig"
    capsys.readouterr()
    assert main(["calibrate", *words, "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and not out.parent.exists()
    return error


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path, CalibratedRig]:
    scene = make_scene(BOARD, VIEWS, 3)
    folder = tmp_path_factory.mktemp("boards")
    write_images(folder, pairs_of(scene))
    return scene, folder, calibrated(folder)


def test_the_rig_is_found_within_its_standard_deviations(clean: tuple[Scene, Path, CalibratedRig]) -> None:
    scene, _, rig = clean
    assert rig.views.rejections() == [] and len(rig.used[0]) == len(rig.used[1]) == VIEWS
    assert np.abs(sigmas_off(rig, scene)).max() < 4.0
    result = result_of(rig)
    assert result.rms_px.stereo < 0.1 and result.epipolar_rms_px < 0.1
    baseline = result.parameters["rig"]["baseline"]
    assert abs(baseline.value - np.linalg.norm(scene.truth.X_10[:3, 3])) < 4.0 * baseline.sigma
    names, matrix = result.covariance.names, np.array(result.covariance.matrix)
    assert names[0] == "cam0.fu" and names[-1] == "cam1_from_cam0.t_z"
    for name, variance in zip(names, np.diag(matrix), strict=True):
        group, _, own = name.partition(".")
        assert result.parameters[group][own].sigma == pytest.approx(np.sqrt(variance))


def test_spoiled_images_are_left_out_by_their_reason_and_the_result_stays(
    clean: tuple[Scene, Path, CalibratedRig], tmp_path: Path
) -> None:
    scene, _, rig = clean
    rng = np.random.default_rng(8)
    images = pairs_of(scene)
    poses = [board_pose(BOARD, rng) for _ in range(10)]
    good = [(scene.image(0, X, 50 + k), scene.image(1, X, 70 + k)) for k, X in enumerate(poses)]
    # its first column is beyond the left border
    far = make_pose(np.eye(3), np.array([-0.165, 0.0, 0.42]) - BOARD.points.mean(axis=0))
    larger, larger_squares = make_board("chessboard", "8x6", 0.026), make_board("chessboard", "7x5", 0.033)
    moved = poses[5].copy()
    moved[:3, 3] += [0.012, 0.009, 0.0]
    cases: dict[str, tuple[tuple[object, object], tuple[str, str]]] = {
        "cut off": ((scene.image(0, far, 90), good[0][1]), ("cut off", "")),
        "blurred": ((good[1][0], scene.image(1, poses[1], 91, blur_px=3.0)), ("", "blurred")),
        "mirrored": ((np.ascontiguousarray(good[2][0][:, ::-1]), good[2][1]), ("mirrored", "")),
        "swapped": ((good[3][1], good[3][0]), ("swapped", "swapped")),
        "other board": ((scene.image(0, poses[4], 92, larger), good[4][1]), ("other board", "")),
        "moved": ((good[5][0], scene.image(1, moved, 93)), ("moved", "moved")),
        "no board": ((np.full(SIZE[::-1], 120, np.uint8), good[6][1]), ("not found", "")),
        "other size": ((good[7][0][:200], good[7][1]), ("other size", "")),
        "shaken": ((good[9][0], waved(good[9][1], 9.0)), ("", "outlier")),
        "outlier": ((waved(good[8][0], 25.0), good[8][1]), ("outlier", "")),
        "other squares": (
            (scene.image(0, poses[8], 94, larger_squares), scene.image(1, poses[8], 95, larger_squares)),
            ("other board", "other board"),
        ),
    }
    for pair, _ in cases.values():
        images.append(pair)  # type: ignore[arg-type]
    write_images(tmp_path, images)
    found = calibrated(tmp_path)
    said = {
        (Path(each.file).parent.name, Path(each.file).stem): each.kind for each in found.views.rejections()
    }
    expected = {
        (side, f"{VIEWS + k:02d}"): kind
        for k, (_, kinds) in enumerate(cases.values(), start=1)
        for side, kind in zip(("left", "right"), kinds, strict=True)
        if kind
    }
    assert said == expected
    assert np.abs(sigmas_off(found, scene)).max() < 4.0
    np.testing.assert_allclose(found.state.lenses[0].values[:4], rig.state.lenses[0].values[:4], atol=0.5)


MARKERS = (
    ("charuco", "8x6", 0.03, ("9x6", "8x5"), ("4X4_50", "5X5_50")),
    ("aprilgrid", "4x3", 0.05, ("5x3", "4x2"), ("APRILTAG_16h5", "APRILTAG_36h11")),
)


def test_squares_in_metres_are_doubted(
    clean: tuple[Scene, Path, CalibratedRig], tmp_path: Path, capsys: Capture
) -> None:
    """The rig of 0.03 m squares, said to be 0.03 mm."""
    _, folder, rig = clean
    assert rig.doubt_of_size == ""
    words = ["calibrate", *both(folder), "-o", str(tmp_path / "rig"), "--board", "7x5", "--square-mm", "0.03"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "with squares of 0.03 mm the cameras are 0.06" in said.out + said.err
    assert "give --square-mm in millimetres, as measured on the board" in said.out + said.err


@pytest.mark.parametrize(("pattern", "size", "square_m", "wrong", "dictionaries"), MARKERS)
def test_boards_with_markers_are_found_and_one_whose_size_is_wrong_by_one_is_one_line(
    pattern: str,
    size: str,
    square_m: float,
    wrong: tuple[str, ...],
    dictionaries: tuple[str, str],
    tmp_path: Path,
    capsys: Capture,
) -> None:
    board = make_board(pattern, size, square_m)
    facing = np.diag([1.0, -1.0, -1.0]) if pattern == "aprilgrid" else None
    scene = make_scene(board, 6, 4, facing)
    images = pairs_of(scene)
    mirrored = np.ascontiguousarray(images[5][0][:, ::-1])
    write_images(tmp_path, [*images[:5], (mirrored, images[5][1])])
    rig = calibrated(tmp_path, board)
    assert [(Path(each.file).stem, each.kind) for each in rig.views.rejections()] == [("06", "mirrored")]
    assert np.abs(sigmas_off(rig, scene)).max() < 4.5
    write_images(tmp_path / "few", images[:3])
    few = [*both(tmp_path / "few"), "--pattern", pattern, "--square-mm", f"{1e3 * square_m:g}"]
    given, right = dictionaries
    error = refused([*few, "--board", size, "--dictionary", given], tmp_path, capsys)
    assert f"the images show markers of {right}, not of {given}: give --dictionary {right}" in error
    for each in wrong:
        error = refused([*few, "--board", each], tmp_path, capsys)
        assert f"--board {each}: " in error and "images show another board" in error, error


def test_the_command_writes_every_format_and_each_reads_back_the_same(
    clean: tuple[Scene, Path, CalibratedRig], tmp_path: Path, capsys: Capture
) -> None:
    _, folder, _ = clean
    out = tmp_path / "rig"
    words = ["calibrate", "--left", str(folder / "left" / "*.png"), "--right", str(folder / "right")]
    assert main([*words, "--board", "7x5", "--square-mm", "30", "-o", str(out)]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"Calibration: {out / 'report.html'}")
    content = json.loads((out / "calibration.json").read_text())
    assert content["rejected"] == [] and len(content["used"]) == 2 * VIEWS
    assert set(content["rms_px"]) == {"cam0", "cam1", "stereo"}
    rig = read_rig([out])
    prior, found = read_calibration(out).prior, content["parameters"]
    assert prior is not None and rig.prior is not None and rig.prior.names == prior.names
    sigma = dict(zip(prior.names, prior.sigma.tolist(), strict=True))
    assert sigma["cam0.fu"] == pytest.approx(found["cam0"]["fu"]["sigma"])
    # the length of the baseline, by the same covariance in other parameters
    p = rig.right.X_BC[:3, 3] - rig.left.X_BC[:3, 3]
    at, along = [prior.names.index(f"cam1.p_{axis}") for axis in "xyz"], p / np.linalg.norm(p)
    assert np.sqrt(along @ prior.covariance[np.ix_(at, at)] @ along) == pytest.approx(
        found["rig"]["baseline"]["sigma"]
    )
    for names in (["camchain.yaml"], ["opencv.yaml"], ["camera_info_left.yaml", "camera_info_right.yaml"]):
        back = read_rig([out / name for name in names])
        for camera, own in zip(back.cameras, rig.cameras, strict=True):
            for name in ("intrinsics", "model", "size_px", "distortion"):
                assert getattr(camera, name) == getattr(own, name)
            # camera_info states the pose in two parts, which rounds
            atol = 1e-15 if len(names) == 1 else 1e-12
            np.testing.assert_allclose(camera.X_BC, own.X_BC, rtol=0, atol=atol)
    page = (out / "report.html").read_text()
    assert "Epipolar error over the right image" in page and "Coverage of the left image" in page


def test_bad_inputs_are_one_line(
    clean: tuple[Scene, Path, CalibratedRig], small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "empty").mkdir()
    for side in ("left", "right"):
        for k in range(4):
            write_png(tmp_path / side / f"{k}.png", rng.integers(0, 256, (120, 160), dtype=np.uint8))
    data = original(small_sequence)
    bag = write_ros2(data, tmp_path / "bag", BagContents(cameras=(), tf=False))
    video = write_side_by_side(data, tmp_path / "v.mkv")
    for name in (f"{side}/{k:02d}.png" for side in ("left", "right") for k in (1, 2, 3)):
        (tmp_path / "few" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(clean[1] / name, tmp_path / "few" / name)
    left, right = str(tmp_path / "left"), str(tmp_path / "right")
    board, square = ["--board", "7x5"], ["--square-mm", "30"]
    for words, said in (
        (["--left", str(tmp_path / "empty"), "--right", right, *board, *square], "no images there"),
        (["--left", left, *board, *square], "only one camera's images were given: .* --right is missing"),
        (["--left", left, "--right", left, *board, *square], "is an image of --left and of --right"),
        ([left, *board, *square], "a single folder that is no EuRoC sequence"),
        ([*board, *square], "images of a board are missing"),
        ([*both(tmp_path), *board, *square], "0 of 4 left images can be used"),
        ([*both(tmp_path), *board, *square, "--model", "pinhole"], "--model pinhole: choose one of brown5"),
        ([*both(tmp_path), *board, "--square-mm", "0"], "--square-mm 0: give a number above 0"),
        ([*both(tmp_path), *square, "--board", "9"], "--board 9: give columns x rows"),
        ([*both(tmp_path), *board, *square, "--pattern", "dots"], "--pattern dots: choose one of chessboard"),
        ([str(bag), *board, *square], "an empty bag, without a single message; record it again"),
        ([str(video), *board, *square], "0 of 6 left images can be used, .* left image 0 .not found: "),
        *(
            ([*both(tmp_path / "few"), "--board", size, *square], "inner corners; give --board 7x5$")
            for size in ("6x5", "8x5", "7x4", "7x6")
        ),
    ):
        error = refused(words, tmp_path, capsys)
        assert re.search(said, error), error


def test_images_are_paired_by_their_numbers(tmp_path: Path) -> None:
    for name in ("left/img1.png", "left/img2.png", "left/img10.png", "right/r_2.png", "right/r_10.png"):
        write_png(tmp_path / name, np.zeros((20, 20), np.uint8))
    pairs = pairs_of_files([str(tmp_path / "left")], [str(tmp_path / "right")])
    stems = [tuple(None if each is None else Path(each).stem for each in side) for side in pairs.names]
    assert stems == [("img1", "img2", "img10"), (None, "r_2", "r_10")]


def test_half_a_turn_of_a_chessboard_does_not_matter() -> None:
    """Corners are counted from either end; over boards at several attitudes only one order agrees."""
    scene = make_scene(BOARD, 6, 5)
    truth = scene.truth
    ids = np.arange(len(BOARD.points))
    pairs = []
    for k, X_0B in enumerate(truth.X_CB):
        uv = [
            project(lens, transform_points(X, BOARD.points))
            for lens, X in zip(truth.lenses, (X_0B, truth.X_10 @ X_0B), strict=True)
        ]
        pairs.append(Pair(k, Found(ids, uv[0]), Found(ids[::-1] if k % 2 else ids, uv[1])))
    found = agree(pairs, BOARD, truth.lenses, (SIZE, SIZE))
    assert found.spoiled == ()
    np.testing.assert_allclose(found.X_10, truth.X_10, atol=1e-6)
    for pair in found.agreeing:
        np.testing.assert_array_equal(pair.right.ids, ids)


def test_a_recording_is_calibrated_and_a_board_that_rests_counts_once(
    clean: tuple[Scene, Path, CalibratedRig], tmp_path: Path
) -> None:
    _, folder, rig = clean
    stamps = [k * 10**8 for k in range(VIEWS + 2)]
    order = [*range(VIEWS), 0, 3]
    for index, side in enumerate(("left", "right")):
        camera, lens = tmp_path / "mav0" / f"cam{index}", rig.state.lenses[index]
        X_BC = np.eye(4) if index == 0 else inverse_pose(rig.state.X_10)
        write_sensor(camera, lens.K, lens.coefficients, X_BC, SIZE, rate_hz=10.0)
        write_camera_csv(camera, stamps)
        for stamp, k in zip(stamps, order, strict=True):
            image_path(camera, stamp).parent.mkdir(exist_ok=True)
            shutil.copy(folder / side / f"{k + 1:02d}.png", image_path(camera, stamp))
    with opened_pairs([tmp_path], [], [], ImportOptions(poses="none"), Silent()) as pairs:
        found = calibrate(pairs, BOARD, ("brown5", "brown5"), Silent())
    assert [(each.file, each.kind) for each in found.views.rejections()] == [
        (f"{side} image {k}", "repeated") for k in (VIEWS, VIEWS + 1) for side in ("left", "right")
    ]
    np.testing.assert_array_equal(found.state.lenses[0].values, rig.state.lenses[0].values)
