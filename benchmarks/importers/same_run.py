"""The sample through each format and back: is its run the same, byte by byte?

    python -m benchmarks.importers.same_run            all formats
    python -m benchmarks.importers.same_run --stored   what the record has, nothing measured
    python -m benchmarks.importers.same_run --short    two imports without a run, kept in no record

Each format is written from the sample's pixels, times and numbers, and imported by the command; pixels, times
and calibration are compared with the sample's bit by bit. Every dataset is identified by the digest of all
files that a run reads, and the command runs each distinct one of them once, with the default configuration.
Its files are compared with those of a run of the sample itself: without times, the log, and pages with times.
Two rows have no import: the sample whose right camera's stamps are later, run as it is.
"""

import hashlib
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import RECORDS, ROOT, Record, Short, Workers, command
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
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete, measured
from benchmarks.robustness.results import contents
from polhode.dataset_writer import image_path, write_camera_csv

SAMPLE = ROOT / "sample"
Stored = Annotated[bool, arg(help="Only what the record has.")]
Words = Callable[[Original, Path], list[str]]

ITSELF = "the sample itself"
COLUMNS = "format | dataset | its run: that of | files that are the same | said of the clocks"
CLOCKS = "the stamps of "
"""In the warning about an offset of the clocks"""
NOT_READ = ("target0", "truth0", "truth1")
"""Folders below mav0 that no run reads"""
MAY_WARN = {"summary.json"}
"""Of a run that warns of an offset, the file that states it"""


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
    "lossless video": _video,
    "OpenCV (YAML) and folders": _opencv(".yml"),
    "OpenCV (JSON) and folders": _opencv(".json"),
    "camera_info and folders": _camera_info,
    "ROS 1": lambda data, area: [str(write_ros1(data, area / "a.bag"))],
    "ROS 2, sqlite3": lambda data, area: [str(write_ros2(data, area / "bag"))],
    "ROS 2, MCAP": lambda data, area: [str(write_ros2(data, area / "bag", storage="MCAP"))],
    "ROS 2, compressed images": lambda data, area: [
        str(write_ros2(data, area / "bag", BagContents(compressed=True)))
    ],
    "clocks 4 us apart": _folders(4_000),
    "clocks 0.4 frames apart": _folders(200_000_000),
}
AS_THEY_ARE = {"clocks 4 us apart, not imported": 4_000, "clocks 0.4 frames apart, not imported": 200_000_000}
"""Run without an import: how much later the right camera's stamps are [ns]."""
DATASETS = (ITSELF, *FORMATS, *AS_THEY_ARE)
SHORT = ("Kalibr and folders", "lossless video")


def main(
    workers: Workers = 1,
    record: Record = RECORDS / "same_run",
    stored: Stored = False,
    short: Short = False,
) -> None:
    """Measure what the record lacks, print the table; exit code 1 if a dataset or a run is another one."""
    datasets: list[Case] = [{"dataset": name} for name in (SHORT if short else DATASETS)]
    if short:
        lines, runs = [{"case": case, **measure(case)} for case in datasets], []
    elif stored:
        lines = measured(record, datasets)
        runs = measured(record, distinct(lines))
    else:
        lines = complete(record, datasets, measure, workers)
        runs = complete(record, distinct(lines), measure, workers)
    same = print_tables(lines, runs)
    if not same:
        sys.exit(1)


def distinct(lines: list[Case]) -> list[Case]:
    """The runs that are needed: of the sample, and of the first imported dataset of each digest."""
    names: dict[str, str] = {}
    for line in lines:
        if line["case"]["dataset"] != ITSELF:
            names.setdefault(line["input"], line["case"]["dataset"])
    return [{"run": name} for name in (ITSELF, *names.values())]


def measure(case: Case) -> Case:
    """A dataset: whether it is the sample's, the digest of what a run reads, warnings about the clocks.
    A run of a dataset: digests of its files, warnings about the clocks."""
    name = str(case.get("dataset", case.get("run")))
    with TemporaryDirectory() as temporary:
        area = Path(temporary)
        sequence = area / "seq"
        said = _made(name, area, sequence)
        if "dataset" in case:
            return {
                "same": same_dataset(original(SAMPLE), sequence) if name in FORMATS else None,
                "input": input_digest(sequence),
                "said": said,
            }
        said = _polhode("run", "--data", sequence, "-o", area / "run")
        return {"files": contents(area, ("run",)), "said": said}


def _made(name: str, area: Path, sequence: Path) -> list[str]:
    """Make a dataset; what the import said of the clocks."""
    data = original(SAMPLE)
    if name in FORMATS:
        return _polhode("import", *FORMATS[name](data, area), "-o", sequence)
    shutil.copytree(SAMPLE / "mav0", sequence / "mav0")
    if name in AS_THEY_ARE:
        camera = sequence / "mav0" / "cam1"
        stamps = [stamp + AS_THEY_ARE[name] for stamp in data.files[1]]
        for stamp, own in zip(reversed(stamps), reversed(data.files[1].values()), strict=True):
            (camera / "data" / own.name).rename(image_path(camera, stamp))
        write_camera_csv(camera, stamps)
    return []


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


def input_digest(folder: Path) -> str:
    """Of names and contents of all files that a run may read: everything below mav0 but the truth."""
    digest = hashlib.sha256()
    for path in sorted(each for each in (folder / "mav0").rglob("*") if each.is_file()):
        name = path.relative_to(folder / "mav0")
        if name.parts[0] not in NOT_READ:
            digest.update(f"{name.as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()[:16]


def _polhode(*words: object) -> list[str]:
    """Run the program as a user does; its warnings about the clocks."""
    program = [sys.executable, "-m", "polhode", *map(str, words)]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}: exit code {done.returncode}: {done.stderr}")
    said = (*done.stdout.splitlines(), *done.stderr.splitlines())
    return list(dict.fromkeys(line for line in said if CLOCKS in line))


def print_tables(lines: list[Case], runs: list[Case]) -> bool:
    """The datasets, each beside the run of its digest; whether all are the sample's."""
    found = {line["case"]["run"]: line for line in runs}
    wanted = found[ITSELF]["files"] if ITSELF in found else {}
    of_input = {line["input"]: line["case"]["dataset"] for line in reversed(lines) if _has_run(line, found)}
    rows, same = [], True
    for line in lines:
        name, of = line["case"]["dataset"], of_input.get(line["input"])
        if name == ITSELF:
            continue
        alike = {True: "same, bit by bit", False: "other", None: "stamps differ"}[line["same"]]
        run = found.get(of or "")
        files = "not run"
        if run is not None and wanted:
            changed = differing(run["files"], wanted)
            files = f"{len(wanted) - len(changed)} of {len(wanted)}"
            files += f", not {', '.join(changed)}" if changed else ""
            same &= not set(changed) - (MAY_WARN if name in AS_THEY_ARE else set())
        same &= line["same"] is not False
        said = line["said"] or (found[name]["said"] if name in AS_THEY_ARE and name in found else [])
        rows.append([name, alike, "itself" if of == name else of or "-", files, "; ".join(said)])
    print_table(COLUMNS, rows)
    inputs = {line["input"] for line in lines if line["same"] is not None}
    print(f"\nThe imports make {len(inputs)} distinct dataset{'s' if len(inputs) > 1 else ''}.")
    return same


def _has_run(line: Case, found: dict[str, Case]) -> bool:
    return line["case"]["dataset"] in found and line["case"]["dataset"] != ITSELF


def differing(files: dict[str, str], wanted: dict[str, str]) -> list[str]:
    """Names of files that are there in one run only, or have another content."""
    names = files.keys() | wanted.keys()
    return sorted(name.removeprefix("run/") for name in names if files.get(name) != wanted.get(name))


if __name__ == "__main__":
    command(main)
