"""The sample through each format and back: are the bytes of its run the same?

python -m benchmarks.importers.same_run            pixels, times and calibration of all formats; runs of some
python -m benchmarks.importers.same_run --all      a run for every format
"""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import Short, command, polhode
from benchmarks.importers.recordings import (
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
    write_stamps,
)

SAMPLE = Path(__file__).parents[2] / "sample"
RESULTS = ("trajectory.csv", "landmarks.ply", "mesh.ply")
RUN = ("--backend.window.enabled", "False", "--runtime.workers", "1")

EveryRun = Annotated[bool, arg(name="all", help="A run for every format.")]
Words = Callable[[Original, Path], list[str]]


def _folders(later_ns: int = 0) -> Words:
    return lambda data, area: [
        *map(str, write_folders(data, area / "images", later_ns)),
        *("--calibration", str(write_kalibr(data, area / "camchain.yaml"))),
    ]


def _video(data: Original, area: Path) -> list[str]:
    chain, stamps = write_kalibr(data, area / "camchain.yaml"), write_stamps(data, area / "times.txt")
    video = write_side_by_side(data, area / "both.mkv")
    return [str(video), "--calibration", str(chain), "--stamps", str(stamps)]


def _opencv(suffix: str) -> Words:
    return lambda data, area: [
        *map(str, write_folders(data, area / "images")),
        *("--calibration", str(write_opencv(data, area / f"stereo{suffix}"))),
    ]


def _camera_info(data: Original, area: Path) -> list[str]:
    folders = map(str, write_folders(data, area / "images"))
    return [*folders, "--calibration", *map(str, write_camera_info(data, area))]


FORMATS: dict[str, Words] = {
    "Kalibr and folders": _folders(),
    "OpenCV (YAML) and folders": _opencv(".yml"),
    "OpenCV (JSON) and folders": _opencv(".json"),
    "camera_info and folders": _camera_info,
    "ROS 1": lambda data, area: [str(write_ros1(data, area / "a.bag"))],
    "ROS 2, sqlite3": lambda data, area: [str(write_ros2(data, area / "bag"))],
    "ROS 2, MCAP": lambda data, area: [str(write_ros2(data, area / "bag", storage="MCAP"))],
    "ROS 2, compressed images": lambda data, area: [
        str(write_ros2(data, area / "bag", BagContents(compressed=True)))
    ],
    "lossless video": _video,
    "clocks 4 us apart": _folders(4_000),
    "clocks 0.4 frames apart": _folders(200_000_000),
}
RUNS = ("ROS 2, MCAP", "lossless video", "clocks 0.4 frames apart")
"""Whose runs are compared without --all: datasets of the same bytes give the same run."""


def same_dataset(data: Original, folder: Path) -> bool:
    """Whether pixels, times and calibration are those of the sample, bit by bit."""
    back = original(folder)
    return all(
        list(back.files[camera]) == list(data.files[0])
        and (folder / name).read_text() == (data.folder / name).read_text()
        and all(
            np.array_equal(back.pixels(camera, stamp), data.pixels(camera, stamp)) for stamp in data.files[0]
        )
        for camera, name in enumerate(("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"))
    )


def run_of(sequence: Path, folder: Path) -> dict[str, bytes]:
    """The results of a run of a dataset."""
    polhode("run", "--data", sequence, "-o", folder, *RUN)
    return {name: (folder / name).read_bytes() for name in RESULTS}


def main(
    all_runs: Annotated[bool, arg(name="all", help="A run for every format.")] = False, short: Short = False
) -> None:
    """Print the table."""
    data = original(SAMPLE)
    print("| format | dataset | run |\n|---|---|---|", flush=True)
    with TemporaryDirectory() as temporary:
        base = Path(temporary)
        wanted = {} if short else run_of(SAMPLE, base / "sample_run")
        for number, (name, words) in enumerate(FORMATS.items()):
            area = base / str(number)
            area.mkdir()
            polhode("import", *words(data, area), "-o", area / "seq")
            runs = "not run"
            if wanted and (all_runs or name in RUNS):
                runs = "same bytes" if run_of(area / "seq", area / "run") == wanted else "other bytes"
            alike = "same, bit by bit" if same_dataset(data, area / "seq") else "other"
            print(f"| {name} | {alike} | {runs} |", flush=True)


if __name__ == "__main__":
    command(main)
