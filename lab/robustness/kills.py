"""What kills at random moments and full disks leave of the output of every command.

    python -m lab.robustness.kills [COMMAND ...] [--short] [--workers 1] [--record FILE] [--stage DIR]

66 times a command is killed (SIGKILL, its main process alone): at a random share of its time, or right after
a random change of the names beside its output, as its steps of writing are short. 25 times the disk of its
output is full: a tmpfs with room for a random share of the result (limits on the size of a file where nothing
can be mounted). Some commands replace an earlier good result. After each:

- kept: an earlier result is unchanged, or the new one complete; without an earlier one, the result is absent,
  complete, or declared unfinished (a run that failed; a comparison, which begins again; a training)
- later: a later command on the output works if it is whole, and else refuses in one line with exit code 2
- same: the command repeated gives the bytes of an undisturbed one, but for times and logs
- gone: five seconds after the kill no process of it is left
- clean: the repeated command leaves nothing beside its result, and has named or resumed what lay there
- told: a full disk ends in one line on standard error, which names the reason, with exit code 1 or 2

The first call makes the inputs and an undisturbed result of each command in the folder of the stage. Each
case is recorded; an interrupted benchmark goes on. The moments are seeded; where they fall depends on the
machine.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import ROOT, Record, Short, Workers, command
from lab.presentation import print_table
from lab.record import Case, complete
from lab.robustness.disturbed_commands import JOBS, STAGE, Job, Stage, prepared
from lab.robustness.results import PARTIAL, State, names_of, size_of
from polhode.runtime.parent_death import tied

RECORD = ROOT / "runs/records/kills"
KILLS = {
    "run": 6, "run --overwrite": 6, "simulate": 4, "simulate --overwrite": 4, "compare": 5, "train": 5,
    "plan": 4, "export": 4, "report": 2, "evaluate": 2, "observability": 4, "predict": 4,
    "calibrate": 4, "checkout": 3, "import": 5, "import --overwrite": 4,
}  # fmt: skip
FULL = {
    "run": 3, "run --overwrite": 3, "simulate": 2, "simulate --overwrite": 2, "compare": 2, "train": 2,
    "plan": 1, "export": 2, "report": 1, "observability": 1, "predict": 1,
    "calibrate": 1, "checkout": 1, "import": 2, "import --overwrite": 1,
}  # fmt: skip
CHECKS = ("kept", "later", "same", "gone", "clean", "told")
MARK = "POLHODE_KILLS_CASE"
"""Environment variable by which the processes of a case are found"""
GONE_S = 5.0
POLL_S = 0.002
LIMIT_S = 600.0
ATTEMPTS = 6
"""Tries to kill a command before it ends, each at an earlier moment"""
ROOM_BYTES = 2**30
MIN_ROOM_BYTES = 16384


def main(
    commands: Positional[Annotated[tuple[str, ...], arg(metavar="COMMAND", help="Only these.")]] = (),
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stage: Annotated[Path, arg(help="Folder of the inputs and of undisturbed results.")] = STAGE,
) -> None:
    """Measure what the record lacks, print the tables; exit code 1 if a case does not hold."""
    jobs = ("simulate",) if short else tuple(JOBS)
    jobs = tuple(job for job in jobs if not commands or job in commands)
    prepared(stage.resolve(), jobs)
    wanted = [("kill", KILLS), ("full", FULL)]
    # seeds outermost: an interrupted benchmark has some of each command
    cases: list[Case] = [
        {"fault": fault, "job": job, "seed": seed, "stage": str(stage)}
        for seed in range(1 if short else max(KILLS.values()))
        for fault, counts in wanted
        for job in jobs
        if seed < counts.get(job, 0)
    ]
    lines = complete(record, cases, measure, workers)
    print_tables(lines)
    if any(line["failures"] for line in lines):
        sys.exit(1)


def measure(case: Case) -> Case:
    """One case: the command is disturbed, judged, and repeated."""
    stage, job = Stage(Path(case["stage"]).resolve()), JOBS[case["job"]]
    rng = np.random.default_rng([case["seed"], list(JOBS).index(job.name), case["fault"] == "full"])
    place = stage.cases / f"{case['fault']} {job.name} {case['seed']}".replace(" ", "_")
    with _emptied(place):
        if case["fault"] == "kill":
            line, state, failures = _killed(stage, job, place, rng)
            failures += _judged(stage, job, place, state)
        else:
            with _small_disk(stage, job, place, rng) as (room, prefix, enlarge):
                line, state, failures = _filled(stage, job, place, prefix)
                line["disk"] = room
                failures += _judged(stage, job, place, state, enlarge)
    return line | {"state": state, "failures": failures}


def _killed(stage: Stage, job: Job, place: Path, rng: np.random.Generator) -> tuple[Case, State, list[str]]:
    """Kill the command; how, what is left, and which checks fail."""
    by_time = bool(rng.random() < 0.5)
    known, share = stage.undisturbed(job), float(rng.uniform(0.02, 0.98))
    for _ in range(ATTEMPTS):
        stage.lay_out(job, place)
        program = _start(stage, job, place)
        begin, seen, changes = time.monotonic(), names_of(place), 0
        while program.poll() is None:
            seconds = time.monotonic() - begin
            if by_time:
                if seconds >= share * known["seconds"]:
                    break
            elif (now := names_of(place)) != seen:
                seen, changes = now, changes + 1
                if changes >= share * known["changes"]:
                    break
            time.sleep(POLL_S)
        running = program.poll() is None
        program.kill()
        program.wait()
        if running:
            break
        share *= 0.7
    failures = []
    if not _gone(place):
        failures.append("gone: processes are left: " + ", ".join(_processes(place)))
    state = stage.state_of(job, place)
    moment = f"{seconds:.2f} s" if by_time else f"change {changes}"
    return {"moment": moment if running else f"missed ({moment})"}, state, failures


def _filled(stage: Stage, job: Job, place: Path, prefix: list[str]) -> tuple[Case, State, list[str]]:
    """Run the command on a disk that is too small; what is left, and which checks fail."""
    program = _start(stage, job, place, prefix)
    out, error = program.communicate(timeout=LIMIT_S)
    state = stage.state_of(job, place)
    failures = []
    lines = error.splitlines()
    if program.returncode not in (0, 1, 2) or len(lines) != (program.returncode != 0):
        failures.append(f"told: exit code {program.returncode}, {len(lines)} lines: {error[:300]}")
    if program.returncode and "defect" in error:
        failures.append(f"told: {error[:300]}")
    if program.returncode == 0 and state != "new":
        failures.append(f"told: exit code 0, and the result is {state}: {out[-200:]}")
    if not _gone(place):
        failures.append("gone: processes are left: " + ", ".join(_processes(place)))
    return {"moment": f"exit code {program.returncode}", "said": error[:300]}, state, failures


def _judged(stage: Stage, job: Job, place: Path, state: State, enlarge: list[str] | None = None) -> list[str]:
    """The checks of what is left, and of the command repeated."""
    failures = []
    if state in ("lost", "half"):
        failures.append(f"kept: the result is {state}: {names_of(place)}")
    for words in job.later:
        code, out, error = stage.call(words, place)
        whole = state in ("old", "new")
        fine = code == 0 if whole else (code == 2 and len(error.splitlines()) == 1)
        if not fine and not (state == "failed" and code in (0, 1, 2)):
            failures.append(f"later: {' '.join(words)} on a result that is {state}: {code}, {error[:300]}")
    if enlarge:
        subprocess.run(enlarge, check=True)
    left = sorted(path.name for path in place.iterdir() if path.name.startswith("."))
    code, out, error = stage.call(job.repeated, place)
    if code != 0:
        failures.append(f"same: repeated: exit code {code}: {error[:300]}")
    else:
        found = stage.state_of(job, place)
        if found != "new":
            failures.append(f"same: repeated, the result is {found}: {stage.differences(job, place)}")
    beside = sorted({path.name for path in place.iterdir()} - set(stage.expected(job)))
    beside += [name for name in names_of(place) if PARTIAL.fullmatch(Path(name).name)]
    if beside:
        failures.append(f"clean: left beside the result: {', '.join(beside)}")
    unnamed = [name for name in left if name not in out + error and name not in job.continues]
    if unnamed and not job.resumes:
        failures.append(f"clean: not named: {', '.join(unnamed)}")
    return failures


def _start(stage: Stage, job: Job, place: Path, prefix: list[str] | None = None) -> "subprocess.Popen[str]":
    environment = os.environ | {MARK: str(place), "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    program = [*(prefix or []), sys.executable, "-m", "polhode", *stage.filled_in(job.words, place)]
    return subprocess.Popen(
        tied(program),
        cwd=place,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )


def _gone(place: Path) -> bool:
    """Whether all processes of the case end within the time that they have."""
    end = time.monotonic() + GONE_S
    while _processes(place):
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def _processes(place: Path) -> list[str]:
    """Processes whose environment names the case, with their commands; not those that have ended."""
    wanted, found = f"{MARK}={place}".encode(), []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
                state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
                if state not in "ZX":
                    found.append(f"{folder.name} {' '.join(words)[:80]}")
    return found


@contextlib.contextmanager
def _emptied(place: Path) -> Iterator[None]:
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    try:
        yield
    finally:
        shutil.rmtree(place, ignore_errors=True)


@contextlib.contextmanager
def _small_disk(
    stage: Stage, job: Job, place: Path, rng: np.random.Generator
) -> Iterator[tuple[str, list[str], list[str]]]:
    """A disk at ``place``: what it is, words to begin the command with, the command that enlarges it."""
    result, share = stage.undisturbed(job)["bytes"], float(rng.uniform(0.0, 1.0))
    stage.lay_out(job, place)
    room = size_of(place) + MIN_ROOM_BYTES + int(share * result)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode == 0:
        try:
            stage.lay_out(job, place)
            enlarge = ["mount", "-o", f"remount,size={ROOM_BYTES}", str(place)]
            yield f"tmpfs of {room >> 10} kB", [], enlarge
        finally:
            subprocess.run(["umount", "--lazy", str(place)], check=False)
    else:
        limit = MIN_ROOM_BYTES + int(share * stage.undisturbed(job)["largest"])
        yield f"files of at most {limit >> 10} kB", ["prlimit", f"--fsize={limit}"], []


def print_tables(lines: list[Case]) -> None:
    """How many cases hold, by fault and command; then those that do not."""
    rows = []
    for fault in ("kill", "full"):
        for job in dict.fromkeys(line["case"]["job"] for line in lines):
            some = [x for x in lines if (x["case"]["fault"], x["case"]["job"]) == (fault, job)]
            if some:
                states = Counter(line["state"] for line in some)
                failed = Counter(text.partition(":")[0] for line in some for text in line["failures"])
                rows.append(
                    [
                        {"kill": "killed", "full": "disk full"}[fault],
                        job,
                        len(some),
                        sum(not line["failures"] for line in some),
                        ", ".join(f"{count} {state}" for state, count in states.items()),
                        *(failed[check] or "" for check in CHECKS),
                    ]
                )
    print_table(("fault", "command", "cases", "hold", "result afterwards", *CHECKS), rows)
    hold = sum(not line["failures"] for line in lines)
    missed = sum("missed" in line["moment"] for line in lines)
    disks = sorted({line["disk"].partition(" of ")[0] for line in lines if "disk" in line})
    print(
        f"\n{hold} of {len(lines)} hold; {missed} kills came too late. Disks: {', '.join(disks) or 'none'}."
    )
    for line in lines:
        for failure in line["failures"]:
            case = line["case"]
            print(f"\n{case['fault']} {case['job']} {case['seed']} ({line['moment']}): {failure}")


if __name__ == "__main__":
    command(main)
