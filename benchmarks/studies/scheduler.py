"""100,000 points on paper: the size of the table, how long they take, and whether program or workers limit.

    python -m benchmarks.studies.scheduler [--short] [--record FILE]

Two studies of points without work are swept by one worker process. The processor time that the larger one
takes more, over the points that it has more, is what a point costs the program (with the scheduler, the
records, the table) and the worker. With these two costs a simulation of events goes through 100,000 points:
the program serves one completed point after the other, and a worker has READY_PER_WORKER points in reserve.
What the record has is not measured again.
"""

import heapq
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import yaml

from benchmarks.command import ROOT, Record, Short, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.studies.forecast import forecast, format_forecast
from polhode.studies.study import open_study
from polhode.studies.sweep import READY_PER_WORKER

DEFAULT_RECORD = Path("runs/records/study_scheduler")
POINTS = 100_000
CASES, SHORT_CASES = ((500, 2500),), ((50, 250),)
"""Points of the two studies"""
WORKERS = (2, 16, 128, 1024)
SECONDS = (0.0, 1.0, 60.0)
"""Work of a point"""
LOOK_S = 0.1
LIMITED = 0.95
"""Share of the time from which on the program is the limit"""


@dataclass(frozen=True)
class Outcome:
    """Of the simulation of a scheduler."""

    seconds: float
    """Until the last point is done"""
    workers_busy: float
    """Share of their time in which the workers compute"""
    program_busy: float


def main(short: Short = False, record: Record = DEFAULT_RECORD) -> None:
    """Measure what the record lacks, and print the plan."""
    cases: list[Case] = [{"few": few, "many": many} for few, many in (SHORT_CASES if short else CASES)]
    (line,) = complete(record, cases, measure, workers=1)
    program_s, worker_s = line["program_s"], line["worker_s"]
    with tempfile.TemporaryDirectory() as temporary:
        study = _study(Path(temporary), POINTS)
        print(format_forecast(forecast(open_study(study), Path(temporary) / "out")))
    print(f"a point costs the program {1e3 * program_s:.1f} ms, and its worker {1e3 * worker_s:.1f} ms\n")
    columns = "work of a point [s] | workers | hours | workers busy | program busy | limit"
    print_table(columns, _rows(program_s, worker_s), right_from=0)


def measure(case: Case) -> Case:
    """The costs of a point [s of a processor]."""
    with tempfile.TemporaryDirectory() as temporary:
        few, many = (_processor_time(Path(temporary), case[name]) for name in ("few", "many"))
    more = case["many"] - case["few"]
    return {"program_s": (many[0] - few[0]) / more, "worker_s": (many[1] - few[1]) / more}


def _study(folder: Path, points: int) -> Path:
    path = folder / f"study_{points}.yaml"
    axes = {"seed": {"range": [0, points - 1], "count": points}}
    path.write_text(yaml.safe_dump({"axes": axes, "steps": [], "keep": "nothing"}))
    return path


def _processor_time(folder: Path, points: int) -> tuple[float, float]:
    """Of the program and of its worker, for a whole sweep [s]."""
    words: list[Any] = ["sweep", _study(folder, points), "-o", folder / f"out_{points}", "--workers", 1]
    process = subprocess.Popen(
        [sys.executable, "-m", "polhode", *map(str, words)], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    program, worker = 0.0, 0.0
    while process.poll() is None:
        found = psutil.Process(process.pid)
        try:
            program = max(program, _used(found))
            worker = max(worker, sum(map(_used, found.children(recursive=True))))
        except psutil.NoSuchProcess:
            continue
        time.sleep(LOOK_S)
    if process.returncode:
        raise SystemExit(f"the study ended with exit code {process.returncode}")
    return program, worker


def _used(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def simulated(points: int, workers: int, work_s: float, program_s: float, worker_s: float) -> Outcome:
    """Go through all points, event by event: a worker ends a point, or the program has served one."""
    length = work_s + worker_s
    to_submit = points - min(points, READY_PER_WORKER * workers)
    ready, idle, served_at, now = points - to_submit, workers, 0.0, 0.0
    events: list[tuple[float, int]] = []  # time, and 0: a worker ends, 1: the program has served
    done = 0
    while done < points:
        while ready and idle:
            heapq.heappush(events, (now + length, 0))
            ready, idle = ready - 1, idle - 1
        now, kind = heapq.heappop(events)
        if kind == 0:
            idle += 1
            served_at = max(served_at, now) + program_s
            heapq.heappush(events, (served_at, 1))
        else:
            done += 1
            if to_submit:
                to_submit, ready = to_submit - 1, ready + 1
    return Outcome(now, points * length / (now * workers), points * program_s / now)


def _rows(program_s: float, worker_s: float) -> Iterator[list[str]]:
    for work_s in SECONDS:
        for workers in WORKERS:
            found = simulated(POINTS, workers, work_s, program_s, worker_s)
            limit = "program" if found.program_busy > LIMITED else "workers"
            shares = [f"{each:.0%}" for each in (found.workers_busy, found.program_busy)]
            yield [f"{work_s:g}", str(workers), f"{found.seconds / 3600.0:.2f}", *shares, limit]


if __name__ == "__main__":
    command(main)
