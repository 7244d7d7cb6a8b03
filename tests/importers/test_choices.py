"""What the user chooses: parts, steps, cropped images, times, topics, poses."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.geometry.lie import exp_so3, make_pose
from polhode.importers.options import Crop
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import write_inspector, write_png
from tests.conftest import TIMESTAMPS_NS
from tests.importers.imports import imported, refused, require_same
from tests.importers.recordings import (
    BagContents,
    Original,
    original,
    write_folders,
    write_kalibr,
    write_opencv,
    write_ros1,
    write_ros2,
    write_side_by_side,
)

N = len(TIMESTAMPS_NS)
X_NB = make_pose(
    exp_so3(np.linspace([0.0, 0.0, 0.0], [0.3, 0.2, -0.4], N)),
    np.linspace([0.0, 0.0, 0.0], [1.0, 2.0, 3.0], N),
)
X_BC0 = make_pose(exp_so3([0.0, 0.0, 0.5]), [0.1, 0.0, 0.2])


def test_parts_and_steps_and_a_crop_which_moves_the_principal_point_and_cuts_the_masks(
    small_sequence: Path, tmp_path: Path
) -> None:
    imported([small_sequence], tmp_path / "part", start_s=0.5, end_s=2.5, every=2)
    assert list(original(tmp_path / "part").files[1]) == TIMESTAMPS_NS[[1, 3, 5]].tolist()
    mask = np.zeros((48, 64), dtype=np.bool_)
    mask[20:30, 30:40] = True
    for stamp in TIMESTAMPS_NS:
        write_png(small_sequence / "mav0" / "masks1" / f"{stamp}.png", mask)
    imported([small_sequence], tmp_path / "back", crop=Crop(10, 6, 40, 32))
    data, sequence = original(small_sequence), open_sequence(tmp_path / "back")
    assert (sequence.calibration.width_px, sequence.calibration.height_px) == (40, 32)
    np.testing.assert_array_equal(sequence.calibration.K1[:2, 2], [21.5, 17.5])
    pair = sequence.read_pair(2)
    third = int(TIMESTAMPS_NS[2])
    np.testing.assert_array_equal(pair.right, data.pixels(1, third)[6:38, 10:50])
    np.testing.assert_array_equal(pair.mask_right, mask[6:38, 10:50])


def write_named(data: Original, folder: Path, name_of: Callable[[int, int], str]) -> list[Path]:
    """The images of both cameras, by names that follow from number and time [ns]."""
    for camera, name in enumerate(("left", "right")):
        (folder / name).mkdir()
        for k, (stamp, path) in enumerate(data.files[camera].items()):
            shutil.copy(path, folder / name / f"{name_of(k, stamp)}.png")
    return [folder / "left", folder / "right"]


def test_times_are_those_of_names_of_numbers_and_a_rate_of_tables_and_of_a_video(
    small_sequence: Path, tmp_path: Path
) -> None:
    data = original(small_sequence)
    chain = {"calibration": (write_kalibr(data, tmp_path / "k.yaml"),)}
    both = write_named(data, tmp_path, lambda _, ns: f"{ns // 10**9}.{ns % 10**9 // 10**3:06d}")
    imported(both, tmp_path / "named", **chain)
    require_same(data, tmp_path / "named")
    imported(both, tmp_path / "listed", **chain, stamps=(small_sequence / "mav0" / "cam0" / "data.csv",))
    require_same(data, tmp_path / "listed")
    # numbers have a rate; the right camera lost one
    (tmp_path / "numbers").mkdir()
    both = write_named(data, tmp_path / "numbers", lambda k, _: f"img{k + 8}")
    (both[1] / "img10.png").unlink()
    done = imported(both, tmp_path / "numbered", **chain, rate_hz=4.0)
    assert "1 left and 0 right images have no partner" in done.warnings[0]
    stamps = [2 * 10**9 + 250_000_000 * k for k in (0, 1, 3, 4, 5)]
    assert list(original(tmp_path / "numbered").files[0]) == stamps
    # a video has its own times
    imported([write_side_by_side(data, tmp_path / "v.mkv")], tmp_path / "back", **chain)
    assert list(original(tmp_path / "back").files[0]) == [500_000_000 * k for k in range(N)]


def test_an_offset_of_the_clocks_is_removed_and_stated(small_sequence: Path, tmp_path: Path) -> None:
    data = original(small_sequence)
    chain = write_kalibr(data, tmp_path / "k.yaml")
    for later_ns, words in (
        (4_000, "4 us (8e-06 frames) after"),
        (-200_000_000, "0.2 s (0.4 frames) before"),
    ):
        folders = write_folders(data, tmp_path / f"images{later_ns}", later_ns)
        done = imported(folders, tmp_path / f"back{later_ns}", calibration=(chain,))
        assert done.warnings[0].startswith(f"the stamps of the right camera are {words}")
        require_same(data, tmp_path / f"back{later_ns}")
    record = json.loads((tmp_path / "back4000" / "import.json").read_text())
    assert record["offset_of_stamps_s"] == pytest.approx(4e-6) and record["pairs"] == N
    # a given offset pairs clocks far apart
    folders = write_folders(data, tmp_path / "images", 7_200_000_000_000)
    line = refused(folders, tmp_path / "back", calibration=(chain,))
    assert "no time in common" in line and "give --offset-s 7200" in line
    imported(folders, tmp_path / "back", calibration=(chain,), offset_s=7200.0)
    require_same(data, tmp_path / "back")


def test_a_baseline_that_looks_like_millimetres_is_doubted(small_sequence: Path, tmp_path: Path) -> None:
    data = original(small_sequence)
    folders = write_folders(data, tmp_path / "images")
    calibration = write_opencv(data, tmp_path / "c.yml", unit_m=1e-3)
    baseline_m = float(np.linalg.norm(data.X_01[:3, 3]))
    wrong = imported(folders, tmp_path / "wrong", calibration=(calibration,))
    assert wrong.warnings[0].endswith("give --unit mm: all lengths scale with it")
    assert wrong.understood["baseline"] == f"{1e3 * baseline_m:.4g} m"
    right = imported(folders, tmp_path / "right", calibration=(calibration,), unit_m=1e-3)
    assert right.understood["baseline"] == f"{baseline_m:.4g} m"
    assert not any("--unit" in line for line in right.warnings)


@pytest.mark.parametrize("form", ["odometry", "PoseStamped", "tf"])
def test_poses_of_the_inspector(form: str, small_sequence: Path, tmp_path: Path) -> None:
    name, options = {
        "odometry": ("odometry", {}),
        "PoseStamped": ("posestamped", {"poses": "/pose", "pose_of": "base_link"}),
        "tf": ("moving_tf", {"poses": "tf:map"}),
    }[form]
    poses: dict[str, Any] = {"X_BC0": X_BC0, name: X_NB}
    contents = BagContents(**poses)
    bag = write_ros2(original(small_sequence), tmp_path / "bag", contents)
    done = imported([bag], tmp_path / "back", **options)
    sequence = open_sequence(tmp_path / "back")
    assert sequence.inspector_moves and done.warnings == ()
    np.testing.assert_allclose(sequence.X_NC, X_NB @ X_BC0, atol=1e-12)
    np.testing.assert_allclose(sequence.sigma_camera_p_m, 1e-3 if form == "odometry" else 0.0)
    np.testing.assert_allclose(sequence.sigma_camera_theta_rad, 2e-3 if form == "odometry" else 0.0)


def test_poses_are_left_out_on_request_and_where_nothing_links_them(
    small_sequence: Path, tmp_path: Path
) -> None:
    data = original(small_sequence)
    bag = write_ros1(data, tmp_path / "a.bag", BagContents(odometry=X_NB, X_BC0=X_BC0))
    imported([bag], tmp_path / "without", poses="none")
    require_same(data, tmp_path / "without")
    unlinked = write_ros1(data, tmp_path / "b.bag", BagContents(odometry=X_NB))
    done = imported([unlinked], tmp_path / "unlinked")
    assert "poses of frame 'base_link', which tf_static does not link" in done.warnings[0]
    assert "give --pose-of left" in refused([unlinked], tmp_path / "asked", poses="/odom")
    imported([unlinked], tmp_path / "left", poses="/odom", pose_of="left")
    np.testing.assert_allclose(open_sequence(tmp_path / "left").X_NC, X_NB, atol=1e-12)
    stamped = write_ros1(data, tmp_path / "c.bag", BagContents(posestamped=X_NB))
    assert "poses of /pose are not used" in imported([stamped], tmp_path / "stamped").notes[1]


def test_poses_of_an_euroc_folder(small_sequence: Path, tmp_path: Path) -> None:
    write_inspector(small_sequence / "mav0", TIMESTAMPS_NS, X_NB, 0.01)
    imported([small_sequence], tmp_path / "ours")
    np.testing.assert_array_equal(open_sequence(tmp_path / "ours").X_NC, open_sequence(small_sequence).X_NC)
    (small_sequence / "mav0" / "inspector0").rename(small_sequence / "mav0" / "state_groundtruth_estimate0")
    done = imported([small_sequence], tmp_path / "theirs")
    assert "inspector poses: state_groundtruth_estimate0" in done.notes[0]
    np.testing.assert_allclose(open_sequence(tmp_path / "theirs").X_NC, X_NB, atol=1e-12)
    imported([small_sequence], tmp_path / "none", poses="none")
    assert not open_sequence(tmp_path / "none").inspector_moves


def test_the_command_prints_what_it_chose(
    small_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_ros1(original(small_sequence), tmp_path / "a.bag")
    out = tmp_path / "back"
    assert main(["import", str(bag), "-o", str(out), "--crop", "2,4,48,40", "--every", "2"]) == 0
    printed = capsys.readouterr().out
    assert "left /stereo/left/image_raw, right /stereo/right/image_raw" in printed
    assert f"3 stereo pairs, 2 s: {out}" in printed
    assert open_sequence(out).calibration.width_px == 48
