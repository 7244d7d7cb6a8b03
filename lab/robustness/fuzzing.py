"""Fuzzing of every reader of files: inputs tried, and those that end neither in success nor in one line.

    python -m lab.robustness.fuzzing [TARGET ...] [--seconds 600]

Targets of one format (YAML, CSV, PLY ...) go through one reader of polhode, and differ in what it requires
of the content. Each format has ten minutes, which its targets divide; --seconds gives each target so much.

Each target runs in a process of its own. An input may take 5 s of processor time and 1 GiB of memory, may
print nothing and may touch nothing but the files that are read. Whatever else it does is a finding: it is
stored, with its traceback, under runs/fuzzing/TARGET, one input for each place in the code. With --short
every reader gets its corpus and a few seeded mutations. Targets of the record are not fuzzed again.
"""

import json
import resource
import shutil
import sys
import time
from collections import deque
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from tyro.conf import Positional, arg

from lab.command import RECORDS, ROOT, Record, Short, command
from lab.presentation import print_table
from lab.record import complete
from lab.robustness.fuzz_check import LIMIT_BYTES, Checker, Finding
from lab.robustness.fuzz_mutation import mutated
from lab.robustness.fuzz_targets import TARGETS, share_of, target_named
from polhode.runtime.threads import limit_threads

RUNS = ROOT / "runs" / "fuzzing"
FORMAT_S = 600.0
START_S = 300.0
"""Imports and the corpus, on a busy machine."""
SILENT_S = 300.0
"""A process that writes no state for so long hangs in a library, where no signal ends it."""
MAX_PARTS = 20
"""Processes of a target, one after another dies."""
MAX_FINDINGS = 50
MAX_INPUT_BYTES = 1 << 20
SHORT_MUTATIONS = 5
"""Of each target"""


def main(
    targets: Positional[Annotated[tuple[str, ...], arg(metavar="TARGET")]] = (),
    short: Short = False,
    seconds: Annotated[
        float | None, arg(help="Time of each target [s]; its share of its format's, unless given.")
    ] = None,
    record: Record | None = None,
) -> None:
    """Fuzz the targets one after another and print the table."""
    names = targets or tuple(each.name for each in TARGETS)
    for name in names:
        target_named(name)
    if short:
        sys.exit(_short(names))
    path = record or (RUNS / "short_record" if seconds else RECORDS / "fuzzing")
    cases = [{"target": name, "seconds": seconds or FORMAT_S * share_of(name)} for name in names]
    lines = complete(path, cases, fuzz, workers=1)
    formats: dict[str, list[dict[str, Any]]] = {}
    for line in lines:
        formats.setdefault(target_named(line["case"]["target"]).format, []).append(line)
    rows = [(name, str(len(some)), *_sums(some)) for name, some in formats.items()]
    print_table("format | targets | inputs | minutes | findings", rows, right_from=1)
    inputs, minutes, findings = _sums(lines)
    print(f"\n{inputs} inputs in {minutes} minutes, {findings} findings.")
    for line in lines:
        for place in line["findings"]:
            print(f"{line['case']['target']}: {place}")


def _sums(lines: list[dict[str, Any]]) -> tuple[str, str, str]:
    inputs, seconds = (sum(line[key] for line in lines) for key in ("inputs", "seconds"))
    return str(inputs), f"{seconds / 60:.0f}", str(sum(len(line["findings"]) for line in lines))


def _short(names: tuple[str, ...]) -> bool:
    """Every corpus and some seeded mutations, in this process; whether anything was found."""
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


def fuzz(case: dict[str, Any]) -> dict[str, Any]:
    """Inputs, seconds and places of findings; after a process that dies or hangs another one goes on."""
    name, folder = case["target"], RUNS / case["target"]
    shutil.rmtree(folder, ignore_errors=True)
    inputs, seconds, part = 0, 0.0, 0
    while seconds < case["seconds"] - 1.0 and part < MAX_PARTS:
        place = folder / f"part{part}"
        process = get_context("spawn").Process(
            target=_session, args=(name, place, case["seconds"] - seconds, part)
        )
        process.start()
        ended = _wait(process, place / "state.json")
        if ended:
            file = place / "work" / target_named(name).file
            store_finding(
                place, file.read_bytes() if file.is_file() else b"", Finding(f"the process {ended}", "")
            )
        state = json.loads((place / "state.json").read_text()) if (place / "state.json").is_file() else {}
        inputs, seconds = inputs + state.get("inputs", 0), seconds + max(state.get("seconds", 0.0), 0.1)
        part += 1
    places = sorted({file.read_text().partition("\n")[0] for file in folder.glob("part*/findings/*.txt")})
    return {"inputs": inputs, "seconds": round(seconds, 1), "findings": places}


def _wait(process: Any, state: Path) -> str:
    """How a process died; empty: it came to its end."""
    deadline_s = time.time() + START_S
    while process.is_alive():
        process.join(1.0)
        if state.is_file():
            deadline_s = state.stat().st_mtime + SILENT_S
        if time.time() > deadline_s:
            process.kill()
            process.join()
            return "hung"
    return "" if process.exitcode == 0 else f"died with {process.exitcode}"


def _session(name: str, folder: Path, seconds: float, seed: int) -> None:
    """Feed the corpus, then mutations of it and of earlier inputs, until the time is over."""
    limit_threads(1)
    target, rng = target_named(name), Random(seed)  # noqa: S311
    seeds, places = target.seeds(), set[str]()
    (folder / "work").mkdir(parents=True)
    checker = Checker(target, folder / "work")

    def keep(content: bytes, found: Finding | None) -> None:
        if found is not None and found.place not in places and len(places) < MAX_FINDINGS:
            places.add(found.place)
            store_finding(folder, content, found)

    for found in checker.warm_up(seeds):
        keep(b"", found)
    if sys.platform == "linux":
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    recent: deque[bytes] = deque(seeds, maxlen=200)
    start, written, inputs = time.monotonic(), 0.0, 0
    while time.monotonic() - start < seconds:
        content = mutated(target, rng.choice(seeds if rng.random() < 0.6 else recent), rng)[:MAX_INPUT_BYTES]
        finding = checker(content)
        inputs += 1
        keep(content, finding)
        if finding is None and rng.random() < 0.1:
            recent.append(content)
        if time.monotonic() - written > 1.0:
            written = time.monotonic()
            keep(content, checker.changed_folder())
            (folder / "draft").write_text(
                json.dumps({"inputs": inputs, "seconds": round(written - start, 1)})
            )
            (folder / "draft").replace(folder / "state.json")


def store_finding(folder: Path, content: bytes, found: Finding) -> None:
    """An input with what it led to, under a name made from the place."""
    name = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in found.place)[:100]
    (folder / "findings").mkdir(exist_ok=True)
    (folder / "findings" / name).write_bytes(content)
    text = f"{found.place}\n\n{found.details}\n"
    (folder / "findings" / f"{name}.txt").write_text(text, encoding="utf-8", errors="backslashreplace")


if __name__ == "__main__":
    command(main)
