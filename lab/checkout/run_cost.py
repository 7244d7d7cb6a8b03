"""The constants of the estimate of a run's time, fitted to stored runs, and how far these lie from it.

    python -m lab.checkout.run_cost RUN:SEQ ...

Non-negative least squares of the relative errors of ``timing_s.total`` of summary.json: seconds per frame,
per frame and million pixels of the target, and per matched pair of frames. Runs must have been made on the
kind of machine that the estimate is for; lab.end_to_end.footprint measures the memory of one.
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.optimize import nnls
from tyro.conf import Positional, arg

from lab.command import command
from lab.presentation import print_table
from polhode.frontend.rectification import make_rectifier, target_crop
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array
from polhode.pipeline.checkout.run_cost import RunSize, seconds
from polhode.records.dataset import open_sequence

SAMPLED_IMAGES = 6
"""Images whose target is measured."""


def main(
    runs: Positional[Annotated[tuple[str, ...], arg(help="RUN:SEQ, a run and its sequence.")]],
) -> None:
    """Print the constants, and each run beside its estimate."""
    pairs = [(Path(run), Path(sequence)) for run, _, sequence in (each.partition(":") for each in runs)]
    sizes = [size_of(sequence) for _, sequence in pairs]
    took = [float(json.loads((run / "summary.json").read_text())["timing_s"]["total"]) for run, _ in pairs]
    constants = fitted(sizes, np.array(took))
    print("S_PER_FRAME, S_PER_MPX, S_PER_PAIR = " + ", ".join(f"{each:.3g}" for each in constants))
    low, middle, high = np.percentile(np.array(took) / [seconds(size) for size in sizes], [5.0, 50.0, 95.0])
    print(
        f"with the constants in use, nine of ten runs take {low:.2f} to {high:.2f} times as long, median "
        f"{middle:.2f}\n"
    )
    print_table(
        "run | frames | target [Mpx] | pairs matched | seconds | estimate",
        (
            [
                run.name,
                size.frames,
                f"{size.target_mpx:.3f}",
                size.matched_pairs,
                f"{each:.0f}",
                f"{seconds(size):.0f}",
            ]
            for (run, _), size, each in zip(pairs, sizes, took, strict=True)
        ),
    )


def size_of(folder: Path) -> RunSize:
    """Of a sequence, as checkout takes it."""
    sequence = open_sequence(folder)
    rig = make_rectifier(sequence.calibration).rig
    areas = []
    for k in np.linspace(0, len(sequence) - 1, SAMPLED_IMAGES).astype(int).tolist():
        crop = target_crop(target_mask(*sequence.read_left(k)), margin_px=0)
        if crop is not None:
            areas.append(1e-6 * crop.width_px * crop.height_px)
    target = float(np.median(areas)) if areas else 0.0
    return RunSize(len(sequence), 1e-6 * rig.width_px * rig.height_px, target)


def fitted(sizes: list[RunSize], took: Array) -> Array:
    """(3,) constants, none negative, with the least relative errors."""
    A = np.array([[size.frames, size.frames * size.target_mpx, size.matched_pairs] for size in sizes])
    return np.asarray(nnls(A / took[:, None], np.ones(len(took)))[0])


if __name__ == "__main__":
    command(main)
