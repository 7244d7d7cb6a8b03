"""What the engine of ``polhode sweep`` costs: time per point without work, share of small real ones, memory.

    python -m benchmarks.studies.engine [--short] [--record FILE]

Studies of more and more points on two worker processes. Points without steps show what a point costs the
engine; real ones (``run`` and ``evaluate`` of 12 pairs of 160x128 px, another seed each) its share of the
work: what the workers' time has beside the steps, from the first record to the last. That is also the time in
which a worker has no point because the last ones are with others, so few points give a larger share. The
memory of the program and of the largest worker is that when a tenth, half, and all of the points are stored.
What the record has is not measured again.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import yaml

from benchmarks.command import ROOT, Record, Short, command, simulated
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.studies.store import PACKED, POINTS
from polhode.studies.sweep import READY_PER_WORKER
from polhode.studies.table import TABLE, TIME

DEFAULT_RECORD = Path("runs/records/study_engine")
WORKERS = 2
CASES = {"none": (100, 1000, 10_000), "run": (20, 100)}
SHORT_CASES = {"none": (50, 200), "run": (4,)}
STEPS: dict[str, list[str]] = {"none": [], "run": ["run", "evaluate"]}
LOOK_S = 0.2
"""Between two looks at the memory"""
PARTS = (0.1, 0.5, 1.0)
"""Shares of the points at which the memory is noted"""
SCENE: dict[str, Any] = {
    "seed": 4,
    "scene": {
        "frames": 12,
        "interval_s": 0.5,
        "truth_horizon_s": 0,
        "body": {"family": "free_flyer", "size_m": 0.22},
        "motion": {
            "position_m": [0.04, 0.0, 0.5],
            "spin_rpm": [3.0, 9.0, 2.0],
            "spin_axes": "principal",
        },
        "rig": {"width_px": 160, "height_px": 128, "focal_px": 144.0, "baseline_m": 0.09},
    },
}


def main(short: Short = False, record: Record = DEFAULT_RECORD) -> None:
    """Measure what the record lacks, and print all of it."""
    wanted = SHORT_CASES if short else CASES
    cases: list[Case] = [
        {"work": work, "points": points} for work, counts in wanted.items() for points in counts
    ]
    lines = complete(record, cases, measure, workers=1)
    columns = "work | points | s | ms per point and worker | share of the engine | program [MB] | worker [MB]"
    print_table(columns, map(_row, lines), right_from=1)


def measure(case: Case) -> Case:
    """Sweep a study, and look at its processes meanwhile."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        study: dict[str, Any] = {
            "axes": {"seed": {"range": [0, case["points"] - 1], "count": case["points"]}},
            "steps": STEPS[case["work"]],
            "keep": "nothing",
        }
        if case["work"] != "none":
            (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))
            study["data"] = str(simulated(folder / "scene.yaml", folder / "sequence"))
        (folder / "study.yaml").write_text(yaml.safe_dump(study))
        return _watched(folder, case["points"], STEPS[case["work"]])


def _watched(folder: Path, points: int, steps: Sequence[str]) -> Case:
    process = begun_sweep(folder / "study.yaml", folder / "out", "--workers", WORKERS)
    memory = watched_memory(process, folder / "out", points)
    if process.wait():
        raise SystemExit(f"the study ended with exit code {process.returncode}")
    return {**time_between_records(folder / "out", steps), "memory_mb": memory}


def begun_sweep(study: Path, out: Path, *options: object) -> "subprocess.Popen[bytes]":
    """The command, in a group of processes of its own."""
    words = [sys.executable, "-m", "polhode", "sweep", study, "-o", out, *options]
    return subprocess.Popen(
        [str(word) for word in words], cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True
    )


def watched_memory(process: "subprocess.Popen[bytes]", out: Path, points: int) -> list[tuple[float, float]]:
    """Memory of a sweep and of its largest worker [MB] at each of PARTS; returns when the sweep has ended."""
    memory: list[tuple[float, float]] = []
    while process.poll() is None:
        start = time.perf_counter()
        if len(memory) < len(PARTS) and stored_records(out) >= PARTS[len(memory)] * points:
            memory.append(_megabytes(process.pid))
        # counting many files would take the time of the workers
        time.sleep(max(LOOK_S, 20.0 * (time.perf_counter() - start)))
    return memory


def stored_records(out: Path) -> int:
    """Points that the folder of a study has."""
    packed = out / PACKED
    return sum(1 for _ in (out / POINTS).glob("*/*.json")) or (
        pq.ParquetFile(packed).metadata.num_rows if packed.is_file() else 0
    )


def time_between_records(folder: Path, steps: Sequence[str]) -> dict[str, float]:
    """From the first record to the last [s], and what the steps of all workers took of it."""
    table = pq.read_table(folder / TABLE).to_pydict()
    ends = [datetime.fromisoformat(each).timestamp() for each in table[f"{TIME}finished"]]
    first, work_s = min(ends), 0.0
    for rank, row in enumerate(sorted(range(len(ends)), key=ends.__getitem__)):
        # the first sequences were simulated before the first record
        ahead = rank < READY_PER_WORKER * WORKERS
        own = [each for each in steps if each != "simulate" or not ahead]
        work = sum(table[f"{TIME}{each}_s"][row] or 0.0 for each in own)
        # of a point that was begun before the first record, what came after it
        work_s += min(work, ends[row] - first)
    return {"seconds": max(ends) - first, "work_s": work_s}


def engine_share(line: Case) -> float:
    """Share of the workers' time that the steps did not take."""
    return max(1.0 - line["work_s"] / (line["seconds"] * WORKERS), 0.0)


def memory_texts(line: Case) -> list[str]:
    """Of the program and of its largest worker [MB], at each of PARTS."""
    return [", ".join(f"{each[k]:.0f}" for each in line["memory_mb"]) for k in (0, 1)]


def _megabytes(pid: int) -> tuple[float, float]:
    """Resident memory of the program and of its largest worker [MB]; 0: it has ended."""
    try:
        program = psutil.Process(pid)
        workers = [each.memory_info().rss for each in program.children(recursive=True)]
        return program.memory_info().rss / 1e6, max(workers, default=0) / 1e6
    except psutil.NoSuchProcess:
        return 0.0, 0.0


def _row(line: Case) -> list[str]:
    case, seconds = line["case"], line["seconds"]
    beside = max(seconds * WORKERS - line["work_s"], 0.0)
    share = f"{engine_share(line):.1%}" if line["work_s"] else "-"
    # the first record is where the time begins
    each = f"{1e3 * beside / (case['points'] - 1):.1f}"
    return [case["work"], str(case["points"]), f"{seconds:.1f}", each, share, *memory_texts(line)]


if __name__ == "__main__":
    command(main)
