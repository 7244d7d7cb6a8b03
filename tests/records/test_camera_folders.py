"""Names of cameras other than cam0 and cam1."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from polhode.records.camera_folders import find_cameras, left_camera
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError


def rename(sequence: Path, left: str, right: str) -> Path:
    """Give the cameras of a sequence other names; returns mav0."""
    mav0 = sequence / "mav0"
    for old, new in (("cam0", left), ("cam1", right)):
        (mav0 / old).rename(mav0 / f"{new}.new")
    for name in (left, right):
        (mav0 / f"{name}.new").rename(mav0 / name)
    return mav0


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("cam0", "cam1"),
        ("cam2", "cam3"),
        ("cam3", "cam2"),
        ("cam9", "cam10"),
        ("left", "right"),
        ("camera_right_of_two", "a_left"),
        ("b", "a"),
    ],
)
def test_the_pair_is_found_by_its_names_or_by_its_poses(small_sequence: Path, left: str, right: str) -> None:
    """T_BS says which camera is on the left unless both names do, or they are cam0 and cam1."""
    mav0 = rename(small_sequence, left, right)
    expected = (right, left) if "right" in left else (left, right)
    assert find_cameras(mav0).names == expected
    assert left_camera(mav0) == mav0 / expected[0]
    sequence = open_sequence(small_sequence)
    assert sequence.left_file(0).parts[-3] == expected[0]
    sign = 1.0 if expected == (left, right) else -1.0
    X = np.linalg.inv(sequence.calibration.X_BC0) @ sequence.calibration.X_BC1
    np.testing.assert_allclose(X[:3, 3], [sign * 0.09, 0.0, 0.0])


def test_cameras_one_above_the_other_are_taken_in_the_order_of_their_names(small_sequence: Path) -> None:
    mav0 = rename(small_sequence, "cam7", "cam11")
    file = mav0 / "cam11" / "sensor.yaml"
    sensor = yaml.safe_load(file.read_text())
    sensor["T_BS"]["data"] = [1, 0, 0, 0, 0, 1, 0, -0.1, 0, 0, 1, 0, 0, 0, 0, 1]
    file.write_text(yaml.safe_dump(sensor))
    assert find_cameras(mav0).names == ("cam7", "cam11")


def test_three_cameras_without_the_usual_names_are_refused_by_name(small_sequence: Path) -> None:
    shutil.copytree(small_sequence / "mav0" / "cam0", small_sequence / "mav0" / "cam2")
    assert find_cameras(small_sequence / "mav0").names == ("cam0", "cam1")
    shutil.rmtree(small_sequence / "mav0" / "cam2")
    mav0 = rename(small_sequence, "cam2", "cam3")
    shutil.copytree(mav0 / "cam2", mav0 / "cam4")
    with pytest.raises(InputError, match=r"has 3 cameras, cam2, cam3, cam4: call the left one") as caught:
        open_sequence(small_sequence)
    assert "\n" not in str(caught.value)


def test_one_camera_is_not_a_pair(small_sequence: Path) -> None:
    mav0 = rename(small_sequence, "cam2", "cam3")
    shutil.rmtree(mav0 / "cam3")
    with pytest.raises(InputError, match=r"cam0 is missing: a sequence needs"):
        open_sequence(small_sequence)
    assert left_camera(mav0) == mav0 / "cam0"


def test_messages_and_masks_have_the_cameras_own_names(small_sequence: Path) -> None:
    mav0 = rename(small_sequence, "cam2", "cam3")
    first = sorted((mav0 / "cam3" / "data").iterdir())[0]
    first.unlink()
    sequence = open_sequence(small_sequence)
    assert sequence.dropped[0][1] == "cam3 image: file missing"
    assert find_cameras(mav0).masks(1) == mav0 / "masks3"
    (mav0 / "cam2").rename(mav0 / "left")
    (mav0 / "cam3").rename(mav0 / "right")
    assert find_cameras(mav0).masks(1) == mav0 / "masks1"
