"""A dataset written in each format and imported back is the same, bit by bit."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.importers.calibrations.read_rig import read_rig
from polhode.records.dataset import open_sequence
from tests.importers.imports import imported, require_same
from tests.importers.recordings import (
    BagContents,
    Original,
    original,
    write_camera_info,
    write_folders,
    write_kalibr,
    write_opencv,
    write_ros1,
    write_ros2,
    write_side_by_side,
    write_video,
)

Written = tuple[Sequence[Path], dict[str, Any]]


Write = Callable[[Original, Path], Written]


def with_calibration(write: Callable[[Original, Path], Sequence[Path]]) -> Write:
    """Folders of images, and a calibration in some format."""
    return lambda data, area: (write_folders(data, area / "images"), {"calibration": write(data, area)})


def ros1(contents: BagContents, compression: str = "") -> Write:
    return lambda data, area: ([write_ros1(data, area / "a.bag", contents, compression)], {})


def ros2(contents: BagContents, storage: str) -> Write:
    return lambda data, area: ([write_ros2(data, area / "bag", contents, storage)], {})


def single_file(data: Original, area: Path) -> Written:
    bag = write_ros2(data, area / "bag", storage="MCAP")
    return [next(bag.glob("*.mcap"))], {}


def with_stamps(write: Callable[[Original, Path], list[Path]]) -> Write:
    """Videos, their calibration and their times."""
    return lambda data, area: (
        write(data, area),
        {
            "calibration": (write_kalibr(data, area / "camchain.yaml"),),
            "stamps": (data.folder / "mav0" / "cam0" / "data.csv",),
        },
    )


def two_videos(data: Original, area: Path) -> list[Path]:
    return [
        write_video((data.pixels(camera, stamp) for stamp in data.files[camera]), area / f"{camera}.mkv")
        for camera in (0, 1)
    ]


FORMATS: dict[str, Write] = {
    "Kalibr and folders": with_calibration(lambda data, area: (write_kalibr(data, area / "k.yaml"),)),
    "OpenCV, YAML": with_calibration(lambda data, area: (write_opencv(data, area / "stereo.yml"),)),
    "OpenCV, JSON": with_calibration(lambda data, area: (write_opencv(data, area / "stereo.json"),)),
    "ROS camera_info": with_calibration(write_camera_info),
    "a rig of ours": with_calibration(lambda data, _: (data.folder,)),
    "ROS 1": ros1(BagContents()),
    "ROS 1, bz2, without tf": ros1(BagContents(tf=False), "BZ2"),
    "ROS 1, compressed images": ros1(BagContents(compressed=True), "LZ4"),
    "ROS 2, sqlite3": ros2(BagContents(), "SQLITE3"),
    "ROS 2, MCAP": ros2(BagContents(), "MCAP"),
    "ROS 2, compressed images": ros2(BagContents(compressed=True), "MCAP"),
    "ROS 2, a single file": single_file,
    "side-by-side video": with_stamps(lambda data, area: [write_side_by_side(data, area / "both.mkv")]),
    "two videos": with_stamps(two_videos),
    "EuRoC": lambda data, _: ([data.folder], {}),
}


@pytest.mark.parametrize("name", FORMATS)
def test_a_dataset_comes_back_bit_by_bit(name: str, small_sequence: Path, tmp_path: Path) -> None:
    data = original(small_sequence)
    area = tmp_path / "area"
    area.mkdir()
    sources, options = FORMATS[name](data, area)
    done = imported(sources, tmp_path / "back", **options)
    assert done.pairs == 6 and done.warnings == ()
    require_same(data, tmp_path / "back")


def turned(data: Original) -> Original:
    """The same images with a rig whose cameras converge."""
    X_BC1 = make_pose(exp_so3([0.01, -0.13, 0.02]), [0.091, 0.0012, -0.003])
    return replace(data, calibration=replace(data.calibration, X_BC0=np.eye(4), X_BC1=X_BC1))


def test_a_converging_rig_comes_back_to_rounding(small_sequence: Path, tmp_path: Path) -> None:
    """Formats that state the inverse pose, another unit, or a product round in the last digits."""
    data = turned(original(small_sequence))
    for paths, unit_m, atol in (
        ([write_kalibr(data, tmp_path / "k.yaml")], 1.0, 3e-16),
        ([write_opencv(data, tmp_path / "o.yml")], 1.0, 3e-16),
        ([write_opencv(data, tmp_path / "mm.yml", 1e-3)], 1e-3, 3e-16),
        (write_camera_info(data, tmp_path), 1.0, 2e-15),
    ):
        rig = read_rig(paths).in_metres(unit_m)
        np.testing.assert_array_equal(rig.left.X_BC, np.eye(4))
        np.testing.assert_allclose(rig.right.X_BC, data.calibration.X_BC1, rtol=0.0, atol=atol)
        assert rig.right.intrinsics == (50.0, 51.0, 31.5, 23.5)
        assert rig.right.distortion == (-0.1, 0.01, 0.0, 0.0)


def test_an_imu_is_the_body(small_sequence: Path, tmp_path: Path) -> None:
    data = original(small_sequence)
    path = write_kalibr(data, tmp_path / "k.yaml")
    X_BC0 = make_pose(exp_so3([0.3, -0.2, 0.9]), [0.1, 0.2, -0.3])

    text = path.read_text().replace("cam0:\n", f"cam0:\n  T_cam_imu: {inverse_pose(X_BC0).tolist()}\n")
    path.write_text(text)
    rig = read_rig([path])
    np.testing.assert_allclose(rig.left.X_BC, X_BC0, atol=1e-15)
    np.testing.assert_allclose(rig.right.X_BC, X_BC0 @ data.X_01, atol=1e-15)


def test_fisheyes_of_two_resolutions_are_imported(small_sequence: Path, tmp_path: Path) -> None:
    data = original(small_sequence)
    left, right = write_folders(data, tmp_path / "images")
    for path in right.iterdir():
        Image.open(path).resize((32, 24)).save(path)
    chain = write_kalibr(data, tmp_path / "k.yaml")
    text = chain.read_text().replace("radtan", "equidistant")
    first, second = text.split("cam1:")
    chain.write_text(f"{first}cam1:{second.replace('- 64', '- 32').replace('- 48', '- 24')}")
    imported([left, right], tmp_path / "back", calibration=(chain,))
    calibration = open_sequence(tmp_path / "back").calibration
    assert calibration.fisheye0 and calibration.fisheye1
    assert (calibration.size_px(0), calibration.size_px(1)) == ((64, 48), (32, 24))
