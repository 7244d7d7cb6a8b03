"""The constants of the estimate of a run's time, fitted to stored runs, and how far these lie from it.

    python -m benchmarks.checkout.run_cost RUN:SEQ ... [--memory]

Non-negative least squares of the relative errors of ``timing_s.total`` of summary.json: seconds per frame,
per frame and million pixels of the target, and per matched pair of frames. Runs must have been made on the
kind of machine that the estimate is for. ``--memory`` runs each sequence again, with two worker processes,
and prints the largest memory of all its processes together (proportional set sizes, ten times a second).
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.optimize import nnls
from tyro.conf import Positional, arg

from benchmarks.checkout.sequences import name_of
from benchmarks.command import command
from benchmarks.presentation import print_table
from polhode.dataset import open_sequence
from polhode.frontend.rectification import make_rectifier, target_crop
from polhode.frontend.segmentation import target_mask
from polhode.lie import Array
from polhode.pipeline.checkout.run_cost import RunSize, gibibytes, seconds

LOOKED_AT = 6
"""Images whose target is measured"""


def main(
    runs: Positional[Annotated[tuple[str, ...], arg(help="RUN:SEQ, a run and its sequence.")]],
    memory: Annotated[bool, arg(help="Run again, and measure the memory.")] = False,
) -> None:
    """Print the constants, and each run beside its estimate."""
    names, sizes, took = [], [], []
    for pair in runs:
        run, _, sequence = pair.partition(":")
        summary = json.loads((Path(run) / "summary.json").read_text())
        names.append(name_of(Path(sequence)))
        sizes.append(size_of(Path(sequence)))
        took.append(float(summary["timing_s"]["total"]))
    constants = fitted(sizes, np.array(took))
    print("S_PER_FRAME, S_PER_MPX, S_PER_PAIR = " + ", ".join(f"{each:.3g}" for each in constants))
    ratios = np.array(took) / [seconds(size) for size in sizes]
    low, middle, high = np.percentile(ratios, [5.0, 50.0, 95.0])
    print(
        f"with the constants in use, nine of ten runs take {low:.2f} to {high:.2f} times as long, median "
        f"{middle:.2f}\n"
    )
    columns = "sequence | frames | target [Mpx] | pairs matched | seconds | estimate"
    rows = (
        [
            name,
            size.frames,
            f"{size.target_mpx:.3f}",
            size.matched_pairs,
            f"{each:.0f}",
            f"{seconds(size):.0f}",
        ]
        for name, size, each in zip(names, sizes, took, strict=True)
    )
    print_table(columns, rows)
    if memory:
        print()
        print_table(
            "sequence | GiB | estimate",
            (
                [name, f"{peak_gib(Path(pair.partition(':')[2])):.2f}", f"{gibibytes(size):.2f}"]
                for name, size, pair in zip(names, sizes, runs, strict=True)
            ),
        )


def size_of(folder: Path) -> RunSize:
    """Of a sequence, as checkout takes it."""
    sequence = open_sequence(folder)
    rig = make_rectifier(sequence.calibration).rig
    areas = []
    for k in np.linspace(0, len(sequence) - 1, LOOKED_AT).astype(int).tolist():
        crop = target_crop(target_mask(*sequence.read_left(k)), margin_px=0)
        if crop is not None:
            areas.append(1e-6 * crop.width_px * crop.height_px)
    target = float(np.median(areas)) if areas else 0.0
    return RunSize(len(sequence), 1e-6 * rig.width_px * rig.height_px, target)


def fitted(sizes: list[RunSize], took: Array) -> Array:
    """(3,) constants, none negative, with the least relative errors."""
    A = np.array([[size.frames, size.frames * size.target_mpx, size.matched_pairs] for size in sizes])
    return np.asarray(nnls(A / took[:, None], np.ones(len(took)))[0])


def peak_gib(sequence: Path) -> float:
    """Largest memory of a run's processes together [GiB]."""
    with tempfile.TemporaryDirectory() as place:
        words = [sys.executable, "-m", "polhode", "run", "--data", str(sequence), "-o", f"{place}/run"]
        process = subprocess.Popen([*words, "--runtime.workers", "2"], stdout=subprocess.DEVNULL)
        peak = 0
        while process.poll() is None:
            peak = max(peak, sum(map(_pss_kib, _family(process.pid))))
            time.sleep(0.1)
    return peak / 2**20


def _family(pid: int) -> list[int]:
    """A process and all that it started."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [pid, *(member for child in children for member in _family(int(child)))]


def _pss_kib(pid: int) -> int:
    try:
        for text in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if text.startswith("Pss:"):
                return int(text.split()[1])
    except OSError:
        return 0
    return 0


if __name__ == "__main__":
    command(main)
