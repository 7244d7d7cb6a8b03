"""Sequences replayed at two frames a second: latency of stages, time to the report, errors live and final.

    python -m benchmarks.live [SEQ ...] [--rate-hz 2] [--short] [--record FILE]

Sequences: those of configs/ts38.yaml and three scenes of configs/scenes, which are simulated if data/ lacks
them; ``--short``: the shipped sample. Each is replayed by ``polhode run --live``, and solved by ``polhode
run`` for comparison, both with configs/default.yaml. Times are those of the wall clock on this machine, with
what else it does: the load (processes that want to run, mean of a minute) before each run is printed beside
them. "Of the processor" is what the main process took; on a machine that does nothing else, the others work
beside it, so that it is near the wall clock's time.

Errors are root mean squares over the second half of the frames: of the states as they were known live, of the
causal window of the batch run, whose tracks were found with all frames, and of the final answer. "r / sigma"
is the error of the position over the final answer's standard deviations; that of the live states may be 1.5
times that of the window. NEES is of the live states; right sigmas give the number of components, and a single
frame lies within the band in 95 % of cases.

The batch is compared with what bounds it: SIFT by OpenCV (detectAndCompute) on the enlarged crops of the
target in all images, on as many processes as the run has.
"""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from benchmarks.command import ROOT, Record, Sequences, Short, command, simulated
from benchmarks.live.replay import (
    BATCH,
    ERRORS,
    NEES_HEAD,
    SAMPLE,
    SCENES,
    TIMES,
    batch_row,
    error_rows,
    measure,
    nees_row,
    times_row,
)
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete

RECORD = ROOT / "runs/records/live"
"""Not kept in the repository: times are those of a machine."""


def main(
    sequences: Sequences = (),
    rate_hz: Annotated[float, arg(help="Frames a second.")] = 2.0,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    if short:
        chosen = [SAMPLE]
    else:
        chosen = list(sequences) or [
            simulated(ROOT / each, ROOT / "data" / Path(each).stem) for each in SCENES
        ]
    cases: list[Case] = [{"sequence": str(folder), "rate_hz": rate_hz} for folder in chosen]
    # one after the other: they are timed
    lines = complete(record, cases, measure, 1)
    print_table(TIMES, map(times_row, lines))
    print("\nSeconds of the stages: median (95 % are below).\n")
    print_table(ERRORS, [row for line in lines for row in error_rows(line)])
    print()
    print_table(NEES_HEAD, map(nees_row, lines))
    print()
    print_table(BATCH, map(batch_row, lines))


if __name__ == "__main__":
    command(main)
