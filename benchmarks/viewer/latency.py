"""Latency and processor time of a live run with and without a recording for the viewer.

    python -m benchmarks.viewer.latency [SEQ] [--rate 1] [--repeat 2] [--short]

A sequence, the shipped sample unless another is named, is replayed as by ``polhode run --live``, in turns
without and with ``--view-save``; ``--short``: once, at four times its speed. Printed are the median over all
pairs and the 95th percentile: of the latency by the wall clock, from the arrival of a pair to its state, with
whatever else this machine does; and of the time of the processor that the main process took for a pair, with
the thread of the viewer.
"""

import os
import tempfile
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, ROOT, Short, command
from benchmarks.presentation import print_table
from polhode.config.loader import load_config
from polhode.errors import RunFailure
from polhode.pipeline.live.run_live import Watch, WatchedPair, run_live
from polhode.pipeline.view.show_live import watching
from polhode.pipeline.view.target import ViewTarget
from polhode.progress import Silent

SHORT_RATE = 4.0


def main(
    sequence: Annotated[Positional[Path], arg(metavar="SEQ", help="Folder of the sequence.")] = ROOT
    / "sample",
    rate: Annotated[float, arg(help="Speed of the replay.")] = 1.0,
    repeat: Annotated[int, arg(help="Runs of each kind.")] = 2,
    short: Short = False,
) -> None:
    """Measure and print."""
    rate, repeat = (SHORT_RATE, 1) if short else (rate, repeat)
    rows = []
    for number in range(repeat):
        for kind in ("without", "with"):
            load = os.getloadavg()[0]
            latency_s, processor_s, size_mb, dropped = measured(sequence, rate, kind == "with")
            spread = (
                f"{np.median(each):.3f} ({np.percentile(each, 95):.3f})" for each in (latency_s, processor_s)
            )
            size = f"{size_mb:.1f}" if kind == "with" else "-"
            rows.append(
                [f"{kind} {number + 1}", str(len(latency_s)), str(dropped), *spread, size, f"{load:.1f}"]
            )
    print_table(
        "recording | pairs | dropped | arrival to state [s] | processor for a pair [s] | file [MB] | load",
        rows,
    )


def measured(sequence: Path, rate: float, is_viewed: bool) -> tuple[list[float], list[float], float, int]:
    """Latencies and times of the processor between states [s], size of the recording [MB], pairs dropped."""
    stamps: list[float] = []
    latencies: list[float] = []
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "live.rrd"
        viewer = (
            watching(ViewTarget(file, window=False), sequence.name) if is_viewed else nullcontext(_ignore)
        )
        dropped = 0
        with viewer as watch:
            try:
                _, live = run_live(
                    load_config(ROOT / DEFAULT),
                    sequence,
                    Path(temporary) / "run",
                    Silent(),
                    rate,
                    watch=_timed(watch, stamps),
                )
            except RunFailure as failure:
                raise SystemExit(str(failure)) from failure
            latencies, dropped = [each.latency_s for each in live.processed], live.dropped
        size_mb = 1e-6 * file.stat().st_size if is_viewed else 0.0
    return latencies, [after - before for before, after in pairwise(stamps)], size_mb, dropped


def _timed(watch: Watch, stamps: list[float]) -> Watch:
    def timed(pair: WatchedPair) -> None:
        watch(pair)
        stamps.append(process_time())

    return timed


def _ignore(pair: WatchedPair) -> None:
    del pair


if __name__ == "__main__":
    command(main)
