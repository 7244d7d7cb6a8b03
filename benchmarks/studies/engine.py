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
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import yaml

from benchmarks.command import ROOT, Record, Short, command, simulated
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.studies.store import Store
from polhode.studies.table import TABLE, TIME

DEFAULT_RECORD = Path("runs/study_engine.jsonl")
WORKERS = 2
CASES = {"none": (100, 1000, 10_000), "run": (20, 100)}
SHORT_CASES = {"none": (50, 200), "run": (4,)}
STEPS = {"none": [], "run": ["run", "evaluate"]}
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
        return _watched(folder, case["points"])


def _watched(folder: Path, points: int) -> Case:
    words = ["sweep", folder / "study.yaml", "-o", folder / "out", "--workers", WORKERS]
    process = subprocess.Popen(
        [sys.executable, "-m", "polhode", *map(str, words)], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    memory: list[tuple[float, float]] = []
    while process.poll() is None:
        time.sleep(LOOK_S)
        stored = sum(1 for _ in (folder / "out" / "points").glob("*/*.json"))
        if stored >= PARTS[min(len(memory), len(PARTS) - 1)] * points and len(memory) < len(PARTS):
            memory.append(_megabytes(process.pid))
    if process.returncode:
        raise SystemExit(f"the study ended with exit code {process.returncode}")
    return {**_time_between_records(Store(folder / "out")), "memory_mb": memory}


def _time_between_records(store: Store) -> dict[str, float]:
    """From the first record to the last [s], and what the steps of all workers took of it."""
    table = pq.read_table(store.folder / TABLE).to_pydict()
    ends = [store.record_file(each).stat().st_mtime for each in table["digest.point"]]
    steps = [table[name] for step in STEPS["run"] if (name := f"{TIME}{step}_s") in table]
    works = [sum(filter(None, each)) for each in zip(*steps, strict=True)]
    first = min(ends)
    # of a point that was begun before the first record, what came after it
    inside = [min(work, end - first) for end, work in zip(ends, works, strict=False)]
    return {"seconds": max(ends) - first, "work_s": sum(inside)}


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
    share = f"{beside / (seconds * WORKERS):.1%}" if line["work_s"] else "-"
    program, worker = (", ".join(f"{each[k]:.0f}" for each in line["memory_mb"]) for k in (0, 1))
    # the first record is where the time begins
    each = f"{1e3 * beside / (case['points'] - 1):.1f}"
    return [case["work"], str(case["points"]), f"{seconds:.1f}", each, share, program, worker]


if __name__ == "__main__":
    command(main)
