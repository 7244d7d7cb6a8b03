"""Each bad input is one line that names it and what to do, and nothing is half-written."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.cli.main import main
from polhode.importers.options import Crop
from polhode.optional_parts import missing_message
from tests.conftest import TIMESTAMPS_NS
from tests.importers.imports import refused
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

Bad = Callable[[Original, Path], tuple[list[Path], dict[str, Any]]]


def edited(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def bag1(contents: BagContents, **options: Any) -> Bad:
    return lambda data, area: ([write_ros1(data, area / "a.bag", contents)], options)


def empty_bag(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    return [write_ros2(data, area / "bag", BagContents(cameras=(), tf=False))], {}


def no_bytes(suffix: str) -> Bad:
    def write(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
        (area / f"a{suffix}").touch()
        return [area / f"a{suffix}"], {"calibration": (write_kalibr(data, area / "k.yaml"),)}

    return write


def cut(write: Callable[[Original, Path], Path], share: float = 0.6) -> Bad:
    def made(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
        bag = write(data, area / "whole")
        file = (
            next(each for each in bag.iterdir() if each.suffix in (".db3", ".mcap")) if bag.is_dir() else bag
        )
        file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
        return [bag], {"calibration": (write_kalibr(data, area / "k.yaml"),)}

    return made


def with_folders(change: Callable[[Original, Path, tuple[Path, Path]], dict[str, Any]]) -> Bad:
    """Two folders and a camchain, of which one thing is wrong."""

    def made(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
        folders = write_folders(data, area / "images")
        options = {"calibration": (write_kalibr(data, area / "k.yaml"),)} | change(data, area, folders)
        return list(folders), options

    return made


def odd_video(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    images = (np.zeros((48, 65), dtype=np.uint8) for _ in range(4))
    return [write_video(images, area / "v.mkv")], {"calibration": (write_kalibr(data, area / "k.yaml"),)}


def one_smaller(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    Image.new("L", (32, 24)).save(folders[1] / f"{TIMESTAMPS_NS[4]}.png")
    return {}


def jittered(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    for k, path in enumerate(sorted(folders[1].iterdir())):
        path.rename(path.with_name(f"{int(path.stem) + 20_000_000 * (-1) ** k + 7_000_000 * k}.png"))
    return {}


def no_images(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    shutil.rmtree(folders[1])
    folders[1].mkdir()
    return {}


def named_otherwise(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    for folder in folders:
        for k, path in enumerate(sorted(folder.iterdir())):
            path.rename(path.with_name(f"frame{k}.png"))
    return {}


def too_many_times(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    (area / "t.txt").write_text("".join(f"{k}.5\n" for k in range(9)))
    return {"stamps": (area / "t.txt",)}


def all_unreadable(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    for path in folders[0].iterdir():
        path.write_bytes(b"no image")
    return {}


def chain_with(old: str, new: str) -> Bad:
    return with_folders(
        lambda data, area, _: {"calibration": (edited(write_kalibr(data, area / "k.yaml"), old, new),)}
    )


def calibration_is(name: str, text: str) -> Bad:
    def change(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
        (area / name).write_text(text)
        return {"calibration": (area / name,)}

    return with_folders(change)


def larger(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    wrong = replace(data, calibration=replace(data.calibration, width_px=128, height_px=96))
    return {"calibration": (write_kalibr(wrong, area / "k2.yaml"),)}


def nan_in_opencv(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    wrong = replace(data, calibration=replace(data.calibration, K0=np.full((3, 3), np.nan)))
    return {"calibration": (write_opencv(wrong, area / "c.yml"),)}


def without_t(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    return {"calibration": (edited(write_opencv(data, area / "c.yml"), "T:", "Tx:"),)}


def exchanged_infos(data: Original, area: Path, folders: tuple[Path, Path]) -> dict[str, Any]:
    return {"calibration": write_camera_info(data, area)[::-1]}


def tum(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    (area / "rgb.txt").touch()
    (area / "depth.txt").touch()
    return [area], {}


def twice(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    folders = write_folders(data, area / "images")
    return [folders[0], folders[0]], {}


def three(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    return [area, area, area], {}


def missing(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    return [area / "no.bag"], {}


def not_a_source(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    (area / "notes.txt").write_text("mine\n")
    return [area / "notes.txt"], {}


def without_calibration(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    return [write_side_by_side(data, area / "v.mkv")], {}


NAN = replace(BagContents(), tf=False)
BAD: dict[str, tuple[Bad, str]] = {
    "empty bag": (empty_bag, "an empty bag, without a single message; record it again"),
    "ROS 1 bag without a byte": (no_bytes(".bag"), "empty, damaged or cut off"),
    "ROS 2 file without a byte": (no_bytes(".mcap"), "empty, damaged or cut off"),
    "ROS 1 bag cut off": (
        cut(lambda data, path: write_ros1(data, path.with_suffix(".bag"))),
        "repair it (rosbag reindex)",
    ),
    "sqlite3 bag cut off": (cut(lambda data, path: write_ros2(data, path)), "repair it (ros2 bag reindex)"),
    "MCAP bag cut off": (
        cut(lambda data, path: write_ros2(data, path, storage="MCAP")),
        "repair it (ros2 bag reindex)",
    ),
    "no images": (bag1(BagContents(cameras=())), "none among /tf_static"),
    "one topic only": (
        bag1(BagContents(cameras=(0,))),
        "a stereo pair needs two topics with images; topics with images: /stereo/left/image_raw",
    ),
    "topic that is not there": (
        bag1(BagContents(), left_topic="/cam0"),
        "--left-topic /cam0 has no images; topics with images: /stereo/left/image_raw, "
        "/stereo/right/image_raw",
    ),
    "one topic twice": (
        bag1(BagContents(), left_topic="/stereo/left/image_raw", right_topic="/stereo/left/image_raw"),
        "are both /stereo/left/image_raw",
    ),
    "no camera_info": (
        bag1(BagContents(info=False)),
        "/stereo/left/camera_info is missing, the calibration of /stereo/left/image_raw; give --calibration",
    ),
    "no such poses": (
        bag1(BagContents(), poses="/odom"),
        "--poses /odom has no poses; topics with poses: none",
    ),
    "no such frame": (bag1(BagContents(), poses="tf:map"), "tf does not link map and the left camera"),
    "video of odd width": (odd_video, "65 px wide, which is odd"),
    "video without a byte": (no_bytes(".mp4"), "empty, damaged or cut off"),
    "video without calibration": (without_calibration, "no calibration in it; give --calibration"),
    "calibration of another size": (
        with_folders(larger),
        "calibrated for images of 128x96 px, but they have 64x48; give the calibration of these images",
    ),
    "camera_info in another order": (with_folders(exchanged_infos), "exchange left and right"),
    "NaN in a camchain": (chain_with("- 31.5", "- .nan"), "'intrinsics': contains NaN or infinity"),
    "NaN in OpenCV's file": (with_folders(nan_in_opencv), "key 'M1': contains NaN or infinity"),
    "camchain without the transform": (chain_with("T_cn_cnm1", "T_other"), "cam1 lacks T_cn_cnm1"),
    "camchain of one camera": (chain_with("cam1:", "camera1:"), "lacks cam1"),
    "unknown distortion": (chain_with("radtan", "fov"), "the distortion model 'fov' is not known"),
    "OpenCV's file without T": (with_folders(without_t), "lacks T, from the left to the right camera"),
    "OpenCV's T in metres, said to be in millimetres": (
        with_folders(
            lambda data, area, _: {"calibration": (write_opencv(data, area / "c.yml"),), "unit_m": 1e-3}
        ),
        "m long with --unit mm; state its unit, that of the board's squares: --unit m or mm",
    ),
    "calibration of no kind": (
        calibration_is("c.yaml", "a: 1\n"),
        "lacks R, from the left to the right camera",
    ),
    "calibration without keys": (calibration_is("c.yaml", "1\n"), "c.yaml is no calibration"),
    "calibration that is missing": (
        with_folders(lambda *_: {"calibration": (Path("none.yaml"),)}),
        "none.yaml is missing: give a YAML or JSON file of OpenCV",
    ),
    "images of two sizes": (with_folders(one_smaller), "32x24 px, where the images before it have 64x48"),
    "tolerance exceeded": (
        with_folders(jittered),
        "2 pairs within 5 ms of a constant offset: the nearest images of the two cameras differ by -13 ms "
        "to 48 ms",
    ),
    "no images in a folder": (with_folders(no_images), "holds no images (.png"),
    "names that are no times": (
        with_folders(named_otherwise),
        "the name frame0.png is no time; give --rate-hz",
    ),
    "times for other images": (with_folders(too_many_times), "9 timestamps for the 6 images"),
    "images that are none": (with_folders(all_unreadable), "6 images cannot be read (first: "),
    "crop beyond the image": (
        with_folders(lambda *_: {"crop": Crop(40, 0, 32, 32)}),
        "--crop 40,0,32,32: reaches beyond the images of 64x48 px",
    ),
    "a part without pairs": (with_folders(lambda *_: {"start_s": 2.0}), "2 of 6 pairs are left by --start"),
    "TUM RGB-D": (tum, "rgb.txt is empty"),
    "one folder twice": (twice, "are the same folder"),
    "three sources": (three, "3 sources were given: give two folders"),
    "no such source": (missing, "no such file or folder; give two folders"),
    "a file of the user": (not_a_source, "notes.txt: not a source; give two folders"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_leaves_nothing(name: str, small_sequence: Path, tmp_path: Path) -> None:
    area = tmp_path / "area"
    area.mkdir()
    make, words = BAD[name]
    sources, options = make(original(small_sequence), area)
    line = refused(sources, tmp_path / "out" / "seq", **options)
    assert words in line
    assert line.startswith(("--", str(tmp_path), "none.yaml", "3 sources")) and len(line) < 600


@pytest.mark.parametrize(
    ("module", "suffix", "what"), [("rosbags", ".bag", "bags"), ("av", ".mp4", "videos")]
)
def test_a_missing_library_is_named_with_its_command(
    module: str, suffix: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a{suffix}"
    path.touch()
    monkeypatch.setitem(sys.modules, module, None)
    line = refused([path], tmp_path / "out" / "seq")
    assert line == f"{what}: {missing_message(module)}"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--tolerance-s", "-1"], "--tolerance-s -1: give a number from 0 to 1e+09"),
        (["--rate-hz", "0"], "--rate-hz 0: give a number above 0"),
        (["--end", "0"], "--end-s 0: give a time after --start-s 0"),
        (["--every", "0"], "--every 0: give a whole number of at least 1"),
        (["--start", "nan"], "--start nan: give a number"),
        (["--unit", "inch"], "--unit inch: give one of m, mm"),
        (["--crop", "1,2"], "--crop 1,2: give LEFT,TOP,WIDTH,HEIGHT"),
    ],
)
def test_options_out_of_range(
    words: list[str], expected: str, small_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["import", str(small_sequence), "-o", str(tmp_path / "out"), *words]) == 2
    stderr = capsys.readouterr().err
    assert expected in stderr and stderr.count("\n") == 1 and not (tmp_path / "out").exists()
