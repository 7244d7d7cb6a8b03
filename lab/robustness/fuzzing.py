"""Fuzzing of every reader of files: inputs tried, and those that end neither in success nor in one line.

    python -m lab.robustness.fuzzing [TARGET ...] [--seconds 600] [--engine automatic|atheris|own]

Targets of one format (YAML, CSV, PLY ...) go through one reader of polhode, and differ in what it requires
of the content. Each format has ten minutes, which its targets divide; --seconds gives each target so much.

Each target runs in a process of its own. An input may take 5 s of processor time and 1 GiB of memory, may
print nothing and may touch nothing but the files that are read. Whatever else it does is a finding: it is
stored, with its traceback, under runs/fuzzing/TARGET/part0/findings, one input for each place in the code.
With --short every reader gets its corpus and a few seeded mutations, in this process. Targets of the record
are not fuzzed again; --again removes them from it first. Atheris, which follows the coverage of branches, is
used where it is installed (pip install .[fuzz]).
"""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from lab.command import RECORDS, ROOT, Record, Short, command
from lab.presentation import print_table
from lab.record import complete, forget
from lab.robustness.fuzz_check import Checker, Finding
from lab.robustness.fuzz_mutation import mutated
from lab.robustness.fuzz_process import store_finding
from lab.robustness.fuzz_targets import TARGETS, share_of, target_named

RUNS = ROOT / "runs" / "fuzzing"
PROCESS = "from lab.robustness.fuzz_process import from_words; from_words()"
"""What the process of a target executes."""
SILENT_S = 60.0
"""After this much processor time without a sign of life a process is killed: a library in C hangs."""
START_S = 300.0
FORMAT_S = 600.0
SHORT_MUTATIONS = 5
"""Of each target"""


def main(
    targets: Positional[Annotated[tuple[str, ...], arg(metavar="TARGET")]] = (),
    short: Short = False,
    seconds: Annotated[
        float | None, arg(help="Time of each target [s]; its share of its format's, unless given.")
    ] = None,
    engine: Annotated[
        Literal["automatic", "atheris", "own"], arg(help="What makes the inputs.")
    ] = "automatic",
    again: Annotated[bool, arg(help="Measure targets again that the record has.")] = False,
    record: Record | None = None,
) -> None:
    """Fuzz the targets one after another and print the table."""
    names = targets or tuple(each.name for each in TARGETS)
    for name in names:
        target_named(name)
    if short:
        sys.exit(_short(names))
    used = ("atheris" if find_spec("atheris") else "own") if engine == "automatic" else engine
    path = record or (RUNS / "short_record" if seconds else RECORDS / "fuzzing")
    if again:
        forget(path, lambda case: case["target"] in names)
    cases = [{"target": name, "seconds": seconds or FORMAT_S * share_of(name)} for name in names]
    lines = complete(path, cases, Fuzz(used), workers=1)
    print_table(
        "format | target | engine | inputs | seconds | inputs/s | branches | findings",
        (_row(line) for line in lines),
        right_from=3,
    )
    print()
    print_table("format | targets | inputs | minutes | findings", _rows_of_formats(lines), right_from=1)
    total = sum(line["inputs"] for line in lines)
    minutes = sum(line["seconds"] for line in lines) / 60
    found = [place for line in lines for place in line["findings"]]
    print(f"\n{total} inputs in {minutes:.0f} minutes, {len(found)} findings.")
    for line in lines:
        for place in line["findings"]:
            print(f"{line['case']['target']}: {place}")


def _short(names: tuple[str, ...]) -> bool:
    """Every corpus and some seeded mutations; whether anything was found."""
    findings: list[str] = []
    for name in names:
        target, rng = target_named(name), Random(name)  # noqa: S311
        with TemporaryDirectory() as folder:
            check, seeds = Checker(target, Path(folder)), target.seeds()
            inputs = (mutated(target, rng.choice(seeds), rng) for _ in range(SHORT_MUTATIONS))
            found = [*check.warm_up(seeds), *map(check, inputs), check.changed_folder()]
            findings += [f"{name}: {each.place}" for each in found if each is not None]
    print(f"{len(names)} readers, {len(findings)} findings", *findings, sep="\n")
    return bool(findings)


def _row(line: dict[str, Any]) -> tuple[str, ...]:
    rate = line["inputs"] / max(line["seconds"], 1e-9)
    branches = "" if line["branches"] is None else str(line["branches"])
    return (
        target_named(line["case"]["target"]).format,
        line["case"]["target"],
        line["engine"],
        str(line["inputs"]),
        f"{line['seconds']:.0f}",
        f"{rate:.0f}",
        branches,
        str(len(line["findings"])),
    )


def _rows_of_formats(lines: list[dict[str, Any]]) -> Iterator[tuple[str, ...]]:
    of_format = [(target_named(line["case"]["target"]).format, line) for line in lines]
    for name in dict.fromkeys(name for name, _ in of_format):
        some = [line for each, line in of_format if each == name]
        inputs, seconds = (sum(line[key] for line in some) for key in ("inputs", "seconds"))
        findings = sum(len(line["findings"]) for line in some)
        yield name, str(len(some)), str(inputs), f"{seconds / 60:.0f}", str(findings)


@dataclass(frozen=True)
class Fuzz:
    """Measures a target; a process that dies or hangs is a finding, and another one goes on."""

    engine: str

    def __call__(self, case: dict[str, Any]) -> dict[str, Any]:
        """Inputs, seconds, covered branches and places of findings."""
        name, folder = case["target"], RUNS / case["target"]
        shutil.rmtree(folder, ignore_errors=True)
        inputs, seconds, branches, part = 0, 0.0, None, 0
        while seconds < case["seconds"] - 1.0 and part < 20:
            state, ended, found = _session(
                name, folder / f"part{part}", case["seconds"] - seconds, self.engine, part
            )
            inputs, seconds = inputs + state["inputs"], seconds + max(state["seconds"], 0.1)
            branches = max(branches or 0, found) if found is not None else branches
            if ended:
                _keep_last_input(folder / f"part{part}", name, ended)
            part += 1
        places = sorted({_first_line(file) for file in folder.glob("part*/findings/*.txt")})
        return {
            "engine": self.engine,
            "inputs": inputs,
            "seconds": round(seconds, 1),
            "branches": branches,
            "findings": places,
        }


def _session(
    name: str, folder: Path, seconds: float, engine: str, seed: int
) -> tuple[dict[str, Any], str, int | None]:
    """State of a process at its end, how it died (empty: it did not), branches that Atheris counted."""
    folder.mkdir(parents=True)
    words = ["-c", PROCESS, name, str(folder), str(seconds), engine, str(seed)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONFAULTHANDLER": "1"}
    output = folder / "output.txt"
    with output.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, *words], cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=stream
        )
        hung = _wait(process, folder)
    text = output.read_text(errors="replace")
    state_file = folder / "state.json"
    state = json.loads(state_file.read_text()) if state_file.is_file() else {"inputs": 0, "seconds": 0.0}
    if done := re.search(r"Done (\d+) runs in (\d+) second", text):
        state = {"inputs": int(done[1]), "seconds": max(float(done[2]), state["seconds"])}
    covered = re.findall(r"\bcov: (\d+)", text)
    ended = "hung" if hung else "" if process.returncode == 0 else f"died with {process.returncode}"
    return state, ended, int(covered[-1]) if covered else None


def _wait(process: "subprocess.Popen[bytes]", folder: Path) -> bool:
    """Until it ends; True when it had to be killed since it worked, or waited, without a sign of life.

    Work is counted in processor time: a process that a busy machine leaves waiting is no finding.
    """
    sign, since_cpu_s, since = 0.0, 0.0, time.monotonic()
    while process.poll() is None:
        time.sleep(0.5)
        state = folder / "state.json"
        latest = state.stat().st_mtime if state.is_file() else 0.0
        if latest != sign:
            sign, since_cpu_s, since = latest, _processor_s(process.pid), time.monotonic()
        allowed_s = SILENT_S if sign else START_S
        idle = time.monotonic() - since > 20.0 * allowed_s
        if idle or _processor_s(process.pid) - since_cpu_s > allowed_s:
            process.kill()
            process.wait()
            return True
    return False


def _processor_s(pid: int) -> float:
    """Processor time of a process so far [s], of Linux; 0 elsewhere."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _keep_last_input(folder: Path, name: str, ended: str) -> None:
    """The input that the process was working on."""
    file = folder / "work" / target_named(name).file
    content = file.read_bytes() if file.is_file() else b""
    trace = (folder / "output.txt").read_text(errors="replace")[-4000:]
    store_finding(folder, content, Finding(f"the process {ended}", trace))


def _first_line(file: Path) -> str:
    return file.read_text(errors="replace").partition("\n")[0]


if __name__ == "__main__":
    command(main)
