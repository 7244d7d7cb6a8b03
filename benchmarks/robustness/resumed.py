"""Runs that are killed at random moments and resumed, compared with one that was not.

    python -m benchmarks.robustness.resumed [--data SEQ] [--cases 20] [--record FILE] [--stage DIR]

Each time ``polhode run`` is killed (SIGKILL, the whole group of its processes): every other case after a
random share of its time, the others after a random share of the results of stages that it stores. The same
command with --resume goes on, and every file that it leaves, the stored results among them, must have the
bytes of the run that was not killed; times, and the page and the log, which contain them, are left out.
Printed is how many are equal, and how long the resumed runs took.

Without --data, eight rendered pairs of 200 x 160 px are used. The moments are seeded; where they fall depends
on the machine. Each case is recorded; an interrupted benchmark goes on.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import ROOT, Record, Short, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from benchmarks.robustness.results import contents
from benchmarks.robustness.small_data import write_sequence
from polhode.program_digest import program_digest

RECORD, STAGE = ROOT / "runs/records/resumed", ROOT / "runs" / "resumed"
POLL_S = 0.005
ATTEMPTS = 6
"""Tries to kill a run before it ends, each at an earlier moment"""
RUN = "R"


def main(
    data: Annotated[Path | None, arg(metavar="SEQ", help="Another sequence.")] = None,
    cases: int = 20,
    short: Short = False,
    record: Record = RECORD,
    stage: Annotated[Path, arg(help="Folder of the runs.")] = STAGE,
) -> None:
    """Measure what the record lacks, print the table; exit code 1 if a resumed run differs."""
    stage = stage.resolve()
    stage.mkdir(parents=True, exist_ok=True)
    if data is None:
        data = stage / "sequence"
        if not data.exists():
            write_sequence(data)
    wanted: list[Case] = [
        {"seed": seed, "data": str(data.resolve()), "stage": str(stage)}
        for seed in range(2 if short else cases)
    ]
    _undisturbed(stage, data.resolve())
    lines = complete(record, wanted, measure, 1)
    _print(lines)
    if any(line["differ"] for line in lines):
        sys.exit(1)


def measure(case: Case) -> Case:
    """Kill a run, resume it, compare."""
    stage, data = Path(case["stage"]), Path(case["data"])
    whole = _undisturbed(stage, data)
    rng, by_time = np.random.default_rng(case["seed"]), case["seed"] % 2 == 0
    share, place = float(rng.uniform(0.02, 0.98)), stage / f"case_{case['seed']}"
    for _ in range(ATTEMPTS):
        killed_s, stored = _kill(data, place, whole, share, by_time)
        if killed_s is not None:
            break
        share *= 0.7
    seconds = _run(data, place, ("--resume",))
    found = contents(place, (RUN,))
    left = sorted(path.name for path in place.iterdir() if path.name != RUN)
    names = found.keys() | whole["files"].keys()
    differ = sorted(name for name in names if found.get(name) != whole["files"].get(name))
    shutil.rmtree(place)
    moment = f"{share:.0%} of the {'time' if by_time else 'results'}"
    return {
        "moment": moment if killed_s is not None else "missed",
        "stored": stored,
        "of": whole["stored"],
        "undisturbed_s": whole["seconds"],
        "resumed_s": seconds,
        "compared": len(names),
        "differ": [*differ, *left],
    }


def _kill(data: Path, place: Path, whole: Case, share: float, by_time: bool) -> tuple[float | None, int]:
    """Start a run and kill it; after how long (None: it ended before), and how many results it had stored."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    begin = time.monotonic()
    program = _start(data, place, ())
    while program.poll() is None:
        done = (time.monotonic() - begin) / whole["seconds"] if by_time else _stored(place) / whole["stored"]
        if done >= share:
            break
        time.sleep(POLL_S)
    running = program.poll() is None
    if running:
        os.killpg(program.pid, signal.SIGKILL)
    program.wait()
    return time.monotonic() - begin if running else None, _stored(place)


def _stored(place: Path) -> int:
    """Results of stages in the run that is being written, or in the one that is complete."""
    return sum(1 for _ in place.glob("*/stages/**/[0-9a-f]*.npz"))


def _run(data: Path, place: Path, words: tuple[str, ...]) -> float:
    """A whole run; its seconds."""
    begin = time.monotonic()
    program = _start(data, place, words)
    if program.wait():
        raise SystemExit(f"{place}: the run ends with {program.returncode}")
    return time.monotonic() - begin


def _start(data: Path, place: Path, words: tuple[str, ...]) -> "subprocess.Popen[bytes]":
    line = [sys.executable, "-m", "polhode", "run", "--data", str(data), "-o", str(place / RUN)]
    return subprocess.Popen(
        [*line, "--runtime.workers", "2", *words],
        cwd=place,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )


def _undisturbed(stage: Path, data: Path) -> Case:
    """The files, the seconds and the number of stored results of a run that is not killed, by this code."""
    file, of = stage / "undisturbed.json", f"{program_digest()} {data}"
    known: Case = json.loads(file.read_text()) if file.is_file() else {}
    if known.get("of") != of:
        place = stage / "undisturbed"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        seconds = _run(data, place, ())
        files = contents(place, (RUN,))
        known = {"of": of, "seconds": seconds, "stored": _stored(place), "files": files}
        file.write_text(json.dumps(known))
    return known


def _print(lines: list[Case]) -> None:
    header = ("killed after", "stored", "undisturbed s", "resumed s", "files", "differ")
    rows = [
        [
            line["moment"],
            f"{line['stored']} of {line['of']}",
            f"{line['undisturbed_s']:.1f}",
            f"{line['resumed_s']:.1f}",
            line["compared"],
            ", ".join(line["differ"]) or "none",
        ]
        for line in lines
    ]
    print_table(header, rows)
    equal = sum(not line["differ"] for line in lines)
    saved = 1.0 - median(line["resumed_s"] / line["undisturbed_s"] for line in lines)
    missed = sum(line["moment"] == "missed" for line in lines)
    print(
        f"\n{equal} of {len(lines)} resumed runs are equal to the undisturbed one; {missed} kills too late."
    )
    print(f"Resuming took {saved:.0%} less time than a new run (median).")


if __name__ == "__main__":
    command(main)
