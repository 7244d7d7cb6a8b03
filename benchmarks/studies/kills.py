"""A study that is killed three times, or has a scheduler of its own: its tables beside an undisturbed one.

    python -m benchmarks.studies.kills [--short] [--record FILE]

500 points, each of which simulates 12 pairs of 160x128 px, runs and evaluates them, by two workers:

- undisturbed, with the memory of the program and of its largest worker when a tenth, half and all of the
  points are stored, and the engine's share of the time (see benchmarks.studies.engine)
- killed: SIGKILL ends a worker when a quarter of the points is stored, the program with its scheduler at a
  half, and the whole group of processes at three quarters, as when the machine goes down; after the last two
  the same command is given again
- scheduler: by a scheduler and two workers of Dask that are started by themselves (``--cluster``)

Tables are compared in all columns but those of times. What the record has is not measured again. The points
leave out what is not needed for a comparison: second features, the network of depths, light that is
reflected. The small version has 300 points without work.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from benchmarks.command import ROOT, Record, Short, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from benchmarks.studies.engine import (
    SCENE,
    WORKERS,
    begun_sweep,
    engine_share,
    memory_texts,
    stored_records,
    time_between_records,
    watched_memory,
)
from polhode.studies.steps import DONE
from polhode.studies.table import TABLE, TIME

DEFAULT_RECORD = Path("runs/records/study_kills")
TABLES = ("undisturbed", "killed", "scheduler")
POINTS, SHORT_POINTS = 500, 300
STEPS: dict[str, list[str]] = {"run": ["simulate", "run", "evaluate"], "none": []}
BASE: dict[str, Any] = {
    **SCENE,
    "scene": {
        **SCENE["scene"],
        "motion": {**SCENE["scene"]["motion"], "spin_rpm": [0.7, 2.5, 0.7]},
        "light": {"earth": 0.0},
        "render": {"bounces": 0},
    },
    "frontend": {
        "features": {"second": None, "upsample": 1.0},
        "guided": {"rounds": 1},
        "depth": {"method": "sgbm"},
    },
    "backend": {
        "solver": "gauss_newton",
        "process_noise": "given",
        "correlated_errors": "none",
        "unknown_wrench": "none",
        "bounds": {"intervals": False},
        "window": {"enabled": False},
    },
    "mapping": {"voxel_mm": 8.0, "align": False, "divide_shading": False, "levels": []},
}
"""A point takes three seconds"""
LOOK_S = 0.02
ENDS_S = 300.0
"""In which workers end that have lost their scheduler, and a scheduler and its workers start"""


def main(short: Short = False, record: Record = DEFAULT_RECORD) -> None:
    """Measure what the record lacks, and print it."""
    work, points = ("none", SHORT_POINTS) if short else ("run", POINTS)
    cases: list[Case] = [{"table": table, "points": points, "work": work} for table in TABLES]
    lines = complete(record, cases, measure, workers=1)
    columns = "table | points | rows | done | columns that differ | s"
    print_table(columns, [_row(line, lines[0]) for line in lines], right_from=1)
    program, worker = memory_texts(lines[0])
    print(f"\nmemory at a tenth, half, end [MB]: program {program}; largest worker {worker}")
    if lines[0]["work_s"]:
        print(f"the engine's share of the workers' time: {engine_share(lines[0]):.1%}")


def measure(case: Case) -> Case:
    """One of the tables: seconds, rows, a digest of each column."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, count = Path(temporary), int(case["points"])
        study, out = folder / "study.yaml", folder / "out"
        study.write_text(yaml.safe_dump(_study(count, case["work"])))
        start, more = time.perf_counter(), {}
        if case["table"] == "undisturbed":
            process = _begun(study, out)
            more["memory_mb"] = watched_memory(process, out, count)
            _require_success(process)
            more |= time_between_records(out, STEPS[case["work"]])
        elif case["table"] == "killed":
            more["stored_at_kills"] = _kill_three_times(study, out, count)
        else:
            with _scheduler(folder) as address:
                _require_success(begun_sweep(study, out, "--cluster", address))
        table = pq.read_table(out / TABLE)
        return {
            "whole_s": time.perf_counter() - start,
            "rows": table.num_rows,
            "done": table.column("status").to_pylist().count(DONE),
            "columns": column_digests(table),
            **more,
        }


def _study(count: int, work: str) -> dict[str, Any]:
    return {
        "base": BASE,
        "steps": STEPS[work],
        "axes": {"seed": {"range": [0, count - 1], "count": count}},
        "keep": "nothing",
        "keep_sequences": work == "none",
    }


def column_digests(table: pa.Table) -> dict[str, str]:
    """A digest of the values of each column, but of those of times."""
    return {
        name: hashlib.sha256(json.dumps(table.column(name).to_pylist()).encode()).hexdigest()[:16]
        for name in table.column_names
        if not name.startswith(TIME)
    }


def differences(first: dict[str, str], second: dict[str, str]) -> list[str]:
    """Names of the columns that are not equal in both tables."""
    return [name for name in dict.fromkeys([*first, *second]) if first.get(name) != second.get(name)]


def _kill_three_times(study: Path, out: Path, count: int) -> list[int]:
    """How many points were stored at each kill."""
    stored = []
    process = _begun(study, out)
    stored.append(_wait(process, out, count // 4))
    workers_of(process.pid)[0].kill()
    stored.append(_wait(process, out, count // 2))
    workers = workers_of(process.pid)
    process.kill()
    process.wait()
    # workers end when they lose their scheduler; two programs would share the folder otherwise
    if psutil.wait_procs(workers, timeout=ENDS_S)[1]:
        raise SystemExit("workers go on without their scheduler")
    process = _begun(study, out)
    stored.append(_wait(process, out, 3 * count // 4))
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    _require_success(_begun(study, out))
    return stored


def workers_of(pid: int) -> list[psutil.Process]:
    """The workers of a program with a cluster of its own: at least one as soon as a point is stored.

    None once the program has ended.
    """
    found = list[psutil.Process]()
    try:
        below = psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return found
    for each in below:
        try:
            if "spawn_main" in " ".join(each.cmdline()):
                found.append(each)
        except psutil.NoSuchProcess:
            continue
    return found


def _begun(study: Path, out: Path) -> "subprocess.Popen[bytes]":
    return begun_sweep(study, out, "--workers", WORKERS)


def _require_success(process: "subprocess.Popen[bytes]") -> None:
    if process.wait():
        raise SystemExit(f"the study ended with exit code {process.returncode}")


def _wait(process: "subprocess.Popen[bytes]", out: Path, points: int) -> int:
    """The number of points that are stored, as soon as there are so many."""
    while (stored := stored_records(out)) < points:
        if process.poll() is not None:
            raise SystemExit("the study ended before it was killed")
        time.sleep(LOOK_S)
    return stored


@contextmanager
def _scheduler(folder: Path) -> Iterator[str]:
    """A scheduler and workers of one thread, each started by itself; its address."""
    file = folder / "scheduler.json"
    processes = [_dask("scheduler", file, "--host", "127.0.0.1", "--port", "0")]
    processes += [_dask("worker", file, "--nthreads", "1") for _ in range(WORKERS)]
    try:
        deadline = time.monotonic() + ENDS_S
        while not file.is_file():
            if time.monotonic() > deadline:
                raise SystemExit("the scheduler does not start")
            time.sleep(LOOK_S)
        address = str(json.loads(file.read_text())["address"])
        _wait_for_workers(address)
        yield address
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _wait_for_workers(address: str) -> None:
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(WORKERS, timeout=ENDS_S)


def _dask(what: str, file: Path, *options: str) -> "subprocess.Popen[bytes]":
    words = ["-m", f"distributed.cli.dask_{what}", "--no-dashboard", "--scheduler-file", str(file), *options]
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _row(line: Case, undisturbed: Case) -> list[str]:
    case = line["case"]
    differ = ", ".join(differences(undisturbed["columns"], line["columns"])) or "none"
    numbers = (case["points"], line["rows"], line["done"])
    return [case["table"], *map(str, numbers), differ, f"{line['whole_s']:.0f}"]


if __name__ == "__main__":
    command(main)
