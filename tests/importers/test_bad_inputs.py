"""Each bad input is one line that names it and what to do, and nothing is half-written."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from polhode.cli.main import main
from polhode.importers.options import Crop
from polhode.runtime.optional_parts import missing_message
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
Paths = Path | Sequence[Path]


def as_list(paths: Paths) -> list[Path]:
    return [paths] if isinstance(paths, Path) else list(paths)


def edited(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def written(path: Path, text: str = "") -> Path:
    path.write_text(text)
    return path


def source(write: Callable[[Original, Path], Paths], calibrated: bool = False, **options: Any) -> Bad:
    """What ``write`` returns is imported, with or without the true calibration."""

    def make(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
        chain = {"calibration": (write_kalibr(data, area / "k.yaml"),)} if calibrated else {}
        return as_list(write(data, area)), chain | options

    return make


def bag1(options: dict[str, Any], **contents: Any) -> Bad:
    return source(lambda data, area: write_ros1(data, area / "a.bag", BagContents(**contents)), **options)


def no_bytes(suffix: str) -> Bad:
    return source(lambda data, area: written(area / f"a{suffix}"), calibrated=True)


def cut(write: Callable[[Original, Path], Path]) -> Bad:
    def cut_off(data: Original, area: Path) -> Path:
        bag = write(data, area / "whole")
        file = next(bag.glob("*.mcap"), bag)
        file.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
        return bag

    return source(cut_off, calibrated=True)


def folders(change: Callable[[tuple[Path, Path], Path], object] = lambda *_: None, **options: Any) -> Bad:
    """Two folders and a camchain, of which one thing is wrong; ``change`` spoils the images."""

    def make(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
        both = write_folders(data, area / "images")
        change(both, area)
        return list(both), {"calibration": (write_kalibr(data, area / "k.yaml"),)} | options

    return make


def calibration(write: Callable[[Original, Path], Paths], **options: Any) -> Bad:
    """Two folders, whose calibration is wrong."""
    return lambda data, area: (
        list(write_folders(data, area / "images")),
        {"calibration": tuple(as_list(write(data, area)))} | options,
    )


def chain_with(old: str, new: str) -> Bad:
    return calibration(lambda data, area: edited(write_kalibr(data, area / "k.yaml"), old, new))


def recalibrated(data: Original, **values: Any) -> Original:
    return replace(data, calibration=replace(data.calibration, **values))


def jitter(both: tuple[Path, Path], area: Path) -> None:
    for k, path in enumerate(sorted(both[1].iterdir())):
        path.rename(path.with_name(f"{int(path.stem) + 20_000_000 * (-1) ** k + 7_000_000 * k}.png"))


def name_otherwise(both: tuple[Path, Path], area: Path) -> None:
    for folder in both:
        for k, path in enumerate(sorted(folder.iterdir())):
            path.rename(path.with_name(f"frame{k}.png"))


def too_many_times(data: Original, area: Path) -> tuple[list[Path], dict[str, Any]]:
    times = written(area / "t.txt", "".join(f"{k}.5\n" for k in range(9)))
    return folders(stamps=(times,))(data, area)


LEFT = "/stereo/left/image_raw"
BAD: dict[str, tuple[Bad, str]] = {
    "empty bag": (
        source(lambda data, area: write_ros2(data, area / "bag", BagContents(cameras=(), tf=False))),
        "an empty bag, without a single message; record it again",
    ),
    "ROS 2 file without a byte": (no_bytes(".mcap"), "empty, damaged or cut off"),
    "ROS 1 bag cut off": (
        cut(lambda data, path: write_ros1(data, path.with_suffix(".bag"))),
        "repair it (rosbag reindex)",
    ),
    "MCAP bag cut off": (
        cut(lambda data, path: write_ros2(data, path, storage="MCAP")),
        "repair it (ros2 bag reindex)",
    ),
    "no images": (bag1({}, cameras=()), "none among /tf_static"),
    "one topic only": (bag1({}, cameras=(0,)), f"two topics with images; topics with images: {LEFT}"),
    "topic that is not there": (
        bag1({"left_topic": "/cam0"}),
        f"--left-topic /cam0 has no images; topics with images: {LEFT}, /stereo/right/image_raw",
    ),
    "one topic twice": (bag1({"left_topic": LEFT, "right_topic": LEFT}), f"are both {LEFT}"),
    "no camera_info": (
        bag1({}, info=False),
        f"/stereo/left/camera_info is missing, the calibration of {LEFT}; give --calibration",
    ),
    "no such poses": (bag1({"poses": "/odom"}), "--poses /odom has no poses; topics with poses: none"),
    "no such frame": (bag1({"poses": "tf:map"}), "tf does not link map and the left camera"),
    "video of odd width": (
        source(
            lambda data, area: write_video(
                (np.zeros((48, 65), dtype=np.uint8) for _ in range(4)), area / "v.mkv"
            ),
            calibrated=True,
        ),
        "65 px wide, which is odd",
    ),
    "video without a byte": (no_bytes(".mp4"), "empty, damaged or cut off"),
    "video without calibration": (
        source(lambda data, area: write_side_by_side(data, area / "v.mkv")),
        "no calibration in it; give --calibration",
    ),
    "calibration of another size": (
        calibration(
            lambda data, area: write_kalibr(recalibrated(data, width_px=128, height_px=96), area / "k2.yaml")
        ),
        "calibrated for images of 128x96 px, but they have 64x48; give the calibration of these images",
    ),
    "camera_info in another order": (
        calibration(lambda data, area: write_camera_info(data, area)[::-1]),
        "exchange left and right",
    ),
    "NaN in a camchain": (chain_with("- 31.5", "- .nan"), "'intrinsics': contains NaN or infinity"),
    "camchain without the transform": (chain_with("T_cn_cnm1", "T_other"), "cam1 lacks T_cn_cnm1"),
    "camchain of one camera": (chain_with("cam1:", "camera1:"), "lacks cam1"),
    "unknown distortion": (chain_with("radtan", "fov"), "the distortion model 'fov' is not known"),
    "OpenCV's file without T": (
        calibration(lambda data, area: edited(write_opencv(data, area / "c.yml"), "T:", "Tx:")),
        "lacks T, from the left to the right camera",
    ),
    "OpenCV's T in metres, said to be in millimetres": (
        calibration(lambda data, area: write_opencv(data, area / "c.yml"), unit_m=1e-3),
        "m apart with --unit mm; state the unit of the calibration's lengths: --unit m or mm",
    ),
    "calibration of no kind": (
        calibration(lambda data, area: written(area / "c.yaml", "a: 1\n")),
        "c.yaml: of no format that is read; give a file of OpenCV",
    ),
    "calibration that is missing": (
        calibration(lambda *_: Path("none.yaml")),
        "none.yaml is missing: give a file of OpenCV (YAML, XML, JSON, npz)",
    ),
    "images of two sizes": (
        folders(lambda both, _: Image.new("L", (32, 24)).save(both[1] / f"{TIMESTAMPS_NS[4]}.png")),
        "32x24 px, where the images before it have 64x48",
    ),
    "tolerance exceeded": (
        folders(jitter),
        "2 pairs within 5 ms of a constant offset: the nearest images of the two cameras differ by -13 ms "
        "to 48 ms",
    ),
    "no images in a folder": (
        folders(lambda both, _: [path.rename(path.with_suffix(".txt")) for path in both[1].iterdir()]),
        "holds no images (.png",
    ),
    "names that are no times": (
        folders(name_otherwise),
        "the name frame0.png states no time; give --rate-hz",
    ),
    "times for other images": (too_many_times, "9 timestamps for the 6 images"),
    "images that are none": (
        folders(lambda both, _: [path.write_bytes(b"no image") for path in both[0].iterdir()]),
        "6 images cannot be read (first: ",
    ),
    "crop beyond the image": (
        folders(crop=Crop(40, 0, 32, 32)),
        "--crop 40,0,32,32: reaches beyond the images of 64x48 px",
    ),
    "a part without pairs": (folders(start_s=2.0), "2 of 6 pairs are left by --start"),
    "one folder twice": (
        source(lambda data, area: 2 * [write_folders(data, area / "images")[0]]),
        "are the same folder",
    ),
    "three sources": (source(lambda data, area: 3 * [area]), "3 sources were given: give two folders"),
    "no such source": (
        source(lambda data, area: area / "no.bag"),
        "no such file or folder; give two folders",
    ),
    "a file of the user": (
        source(lambda data, area: written(area / "notes.txt", "mine\n")),
        "notes.txt: not a source; give two folders",
    ),
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


def test_a_missing_library_is_named_with_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module, suffix, what in (("rosbags", ".bag", "bags"), ("av", ".mp4", "videos")):
        path = tmp_path / f"a{suffix}"
        path.touch()
        monkeypatch.setitem(sys.modules, module, None)
        assert refused([path], tmp_path / "out" / "seq") == f"{what}: {missing_message(module)}"


OPTIONS = {
    "--tolerance-s -1": "--tolerance-s -1: give a number from 0 to 1e+09",
    "--rate-hz 0": "--rate-hz 0: give a number above 0",
    "--end 0": "--end-s 0: give a time after --start-s 0",
    "--every 0": "--every 0: give a whole number of at least 1",
    "--start nan": "--start nan: give a number",
    "--unit inch": "--unit inch: give one of m, mm",
    "--crop 1,2": "--crop 1,2: give LEFT,TOP,WIDTH,HEIGHT",
    "--crop a,0,1,1": "--crop a,0,1,1: give LEFT,TOP,WIDTH,HEIGHT",
    "--crop=-1,0,5,5": "--crop -1,0,5,5: left and top must be at least 0",
    "--crop 0,0,0,5": "width and height at least 1",
}


def test_options_out_of_range(
    small_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, expected in OPTIONS.items():
        assert main(["import", str(small_sequence), "-o", str(tmp_path / "out"), *words.split()]) == 2
        stderr = capsys.readouterr().err
        assert expected in stderr and stderr.count("\n") == 1 and not (tmp_path / "out").exists()
