"""Seconds until the program answers, and what the first run compiles.

    python -m benchmarks.live.start [--help-calls 10] [--short]

``polhode --help`` as a user starts it: seconds by the clock and of the processor. Then the shipped sample is
run with one process and an empty folder for compiled code, and again with what is kept there; ``--short``:
its first seconds. Compiling is timed by numba's own events, in seconds of the processor, so that other
programs on the machine count little. The last column is the wall-clock time of both runs with one process per
core.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Annotated, Any

from numba.core import event
from tyro.conf import arg

from benchmarks.command import ROOT, Short, command, in_process, polhode
from benchmarks.presentation import print_table
from polhode.config import Config
from polhode.pipeline.run import run
from polhode.progress import Silent

SHORT_END_S = 7.0
LONGEST = 12
"""Functions that are listed."""


def main(
    help_calls: Annotated[int, arg(help="How often the help is called.")] = 10,
    short: Short = False,
    timed_run: Annotated[
        tuple[Path, Path, int] | None,
        arg(help="Only run this sequence into this folder by so many processes; prints the times as JSON."),
    ] = None,
) -> None:
    """Measure and print."""
    if timed_run is not None:
        print(json.dumps(run_and_time(*timed_run)))
        return
    times = [time_help() for _ in range(help_calls)]
    clock, processor = ([each[k] for each in times] for k in (0, 1))
    print(
        f"polhode --help, {help_calls} times: {median(clock):.2f} s by the clock ({min(clock):.2f} to "
        f"{max(clock):.2f}), {median(processor):.2f} s of the processor\n"
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder, sequence = Path(temporary), ROOT / "sample"
        if short:
            sequence = folder / "part"
            polhode("import", ROOT / "sample", "-o", sequence, "--end", SHORT_END_S)
        rows, compiled = [], {}
        for name in ("first", "second"):
            alone, together = (_timed(sequence, folder, name, workers) for workers in (1, 0))
            numbers = (alone["total"], alone["compiling"], together["clock"])
            total, compiling, clock_s = (f"{number:.1f}" for number in numbers)
            rows.append([name, total, compiling, str(len(alone["seconds"])), clock_s])
            compiled |= alone["seconds"]
    print_table(
        "run | seconds of the processor | of these, compiling | functions | by the clock, all cores", rows
    )
    print()
    print_table(
        "longest to compile | seconds of the processor",
        [[name, f"{s:.2f}"] for name, s in sorted(compiled.items(), key=lambda item: -item[1])[:LONGEST]],
    )


def _timed(sequence: Path, folder: Path, name: str, workers: int) -> dict[str, Any]:
    """A run in a new process; runs with the same number of workers share their compiled code."""
    cache = folder / f"compiled_{workers}"
    cache.mkdir(mode=0o700, exist_ok=True)
    found: dict[str, Any] = in_process(
        *("benchmarks.live.start", "--timed-run", sequence, folder / f"{name}_{workers}", workers),
        environment=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    )
    return found


def time_help() -> tuple[float, float]:
    """Seconds by the clock and of the processor."""
    used, begin = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    subprocess.run(
        [sys.executable, "-m", "polhode", "--help"], cwd=ROOT, stdout=subprocess.DEVNULL, check=True
    )
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return perf_counter() - begin, now.ru_utime - used.ru_utime + now.ru_stime - used.ru_stime


def run_and_time(sequence: Path, run_folder: Path, workers: int) -> dict[str, Any]:
    """A run: seconds by the clock, and of this process in all, for compiling, and of each function."""
    times = CompileTimes()
    event.register("numba:compile", times)
    begin, begin_clock = process_time(), perf_counter()
    config = Config()
    runtime = config.runtime.model_copy(update={"workers": workers})
    run(config.model_copy(update={"runtime": runtime}), sequence, run_folder, Silent())
    total, clock = process_time() - begin, perf_counter() - begin_clock
    compiling = sum(times.seconds.values())
    return {"total": total, "clock": clock, "compiling": compiling, "seconds": times.seconds}


class CompileTimes(event.Listener):
    """Seconds of the processor that numba spends on compiling, by function, and how many there are."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._open: list[float] = []

    def on_start(self, event: Any) -> None:
        """Of numba: one compilation begins, perhaps inside another."""
        self._open.append(process_time())

    def on_end(self, event: Any) -> None:
        """Of numba: it has ended; only the outermost counts, which contains the others."""
        begin = self._open.pop()
        if not self._open:
            name = event.data["dispatcher"].py_func.__qualname__.partition("-")[0]
            self.seconds[name] = self.seconds.get(name, 0.0) + process_time() - begin


if __name__ == "__main__":
    command(main)
