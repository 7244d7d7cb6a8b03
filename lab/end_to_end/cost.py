"""What a run costs: seconds of the processor over those of one SIFT on its images, which differ by machine.

    python -m lab.end_to_end.cost [--short] [--record DIR]

One SIFT: ``SIFT_create(8192, contrastThreshold=0.01)`` of OpenCV on the target's part (grey above 12) of both
images of all pairs, enlarged twice, in one thread. Runs are those of the program with the default
configuration, of the sample and of the replica of TS38, with what they make by default and with the motion
alone; each after one that compiles what is not compiled yet. The largest memory is that of one process.
"""

import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import cv2
import numpy as np

from lab.command import DEFAULT, RECORDS, ROOT, Record, Short, beginning_of_sample, command, simulated
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.frontend.segmentation import Image
from polhode.geometry.lie import Bools
from polhode.records.dataset import open_sequence

OUTPUTS = {"default": (), "motion": ("--outputs", "motion")}
GREY, MARGIN_PX = 12, 4
COLUMNS = (
    "sequence | outputs | one SIFT [s] | run, processor [s] | over one SIFT | run, clock [s] | "
    "over one SIFT | largest process [GB]"
)


def main(short: Short = False, record: Record = RECORDS / "cost") -> None:
    """Measure what the record lacks and print it; short: few pairs of the sample."""
    sequences = ["beginning"] if short else ["sample", "ts38"]
    cases = [{"sequence": name, "outputs": outputs} for name in sequences for outputs in OUTPUTS]
    print_table(COLUMNS, map(_row, complete(record, cases, measure, 1)), right_from=2)


def _row(found: Case) -> list[str]:
    case, sift, used, wall = found["case"], found["sift_cpu"], found["run_cpu"], found["run_s"]
    numbers = (f"{sift:.1f}", f"{used:.1f}", f"{used / sift:.2f}", f"{wall:.1f}", f"{wall / sift:.2f}")
    return [case["sequence"], case["outputs"], *numbers, f"{found['process_gb']:.1f}"]


def measure(case: Case) -> Case:
    """A row of the record: seconds, and gigabytes (1e9 bytes)."""
    sequence = _sequence(case["sequence"])
    sift = cv2.SIFT_create(8192, contrastThreshold=0.01)
    _run(sequence, case["outputs"])
    before, start_s = _used_by_children(), perf_counter()
    _run(sequence, case["outputs"])
    return {
        "run_s": perf_counter() - start_s,
        "run_cpu": _used_by_children() - before,
        "sift_cpu": seconds_of_one_sift(sequence, sift, lambda image: np.asarray(image > GREY)),
        "process_gb": 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e9,
    }


def seconds_of_one_sift(folder: Path, sift: cv2.Feature2D, target: Callable[[Image], Bools]) -> float:
    """Of the processor, for the target's part of both images of all pairs, enlarged twice."""
    sequence, total = open_sequence(folder), 0.0
    for k in range(len(sequence)):
        pair = sequence.read_pair(k)
        for image in (pair.left, pair.right):
            rows, columns = np.nonzero(target(image))
            if len(rows):
                top, left = max(rows.min() - MARGIN_PX, 0), max(columns.min() - MARGIN_PX, 0)
                part = image[top : rows.max() + MARGIN_PX, left : columns.max() + MARGIN_PX]
                start_s = process_time()
                sift.detectAndCompute(cv2.resize(part, None, fx=2.0, fy=2.0), None)
                total += process_time() - start_s
    return total


def _sequence(name: str) -> Path:
    if name == "sample":
        return ROOT / "examples/sample"
    if name == "beginning":
        return beginning_of_sample()
    return simulated(ROOT / f"configs/{name}.yaml", ROOT / "data" / name)


def _run(sequence: Path, outputs: str) -> None:
    with TemporaryDirectory() as scratch:
        words = ["-m", "polhode", "run", DEFAULT, "--data", sequence, "-o", f"{scratch}/run", "--quiet"]
        subprocess.run([sys.executable, *map(str, words), *OUTPUTS[outputs]], cwd=ROOT, check=True)


def _used_by_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    command(main)
