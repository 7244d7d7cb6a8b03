"""Which tests notice each of the deliberate faults.

Run: ``python -m lab.mutation.catch [--only TEXT] [--jobs 2] [--short]``. Half an hour.

Each fault goes alone into a copy of the repository, and the tests that it names run until the first one
fails. That test must pass without the fault, else it counts for nothing.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from time import perf_counter
from typing import Annotated

import yaml
from tyro.conf import arg

from lab.command import ROOT, command
from lab.presentation import markdown_table

FAULTS = Path(__file__).with_name("faults.yaml")
LEFT_OUT = (".git", ".venv", "runs", "data", ".mypy_cache", ".ruff_cache", ".pytest_cache")
FAULTY = ("backend", "frontend", "train", "polhode")
LONGEST_S = 1500.0
"""Limit for the tests of a fault that makes a loop endless."""
_COMPILED = re.compile(r"^@(njit|compiled|fused)", re.MULTILINE)
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True)
class Fault:
    """One of ``faults.yaml``, which explains the fields."""

    kind: str
    file: str
    old: str
    new: str
    tests: Sequence[str]


@dataclass(frozen=True)
class FaultOutcome:
    """What the tests said to one fault."""

    fault: Fault
    caught_by: str
    """The first test that fails; empty: none does"""
    seconds: float
    trouble: str = ""
    """Why the fault could not be tried"""


def main(
    *,
    tree: Path = ROOT,
    only: str = "",
    jobs: int = 1,
    short: Annotated[bool, arg(help="Only whether code and tests of each fault are there.")] = False,
) -> None:
    """tree: the repository whose tests are tried; only: faults whose file or kind contains this text; jobs:
    copies of the repository that are tested at a time."""
    faults = [Fault(**each) for each in yaml.safe_load(FAULTS.read_text())]
    chosen = [fault for fault in faults if only in fault.file or only in fault.kind]
    if short:
        lost = [f"{fault.file}: {fault.kind}: its code is not there, or twice" for fault in chosen
                if place_of(fault, tree) is None]  # fmt: skip
        lost += [f"{fault.file}: {fault.kind}: no tests/{test}" for fault in chosen for test in fault.tests
                 if not (tree / "tests" / test.partition("::")[0]).exists()]  # fmt: skip
        print(f"{len(chosen)} faults", *lost, sep="\n")
        sys.exit(bool(lost))
    with tempfile.TemporaryDirectory(prefix="polhode-faults-") as folder:
        outcomes = try_all(chosen, tree.resolve(), Path(folder), jobs)
    print(table(outcomes))
    sys.exit(any(not outcome.caught_by for outcome in outcomes))


def try_all(faults: list[Fault], tree: Path, folder: Path, jobs: int) -> list[FaultOutcome]:
    """Each fault in one of ``jobs`` copies of the tree."""
    free: SimpleQueue[Path] = SimpleQueue()
    for job in range(jobs):
        copy = folder / str(job)
        # of the repository itself only: the sample has folders of the name data, too
        shutil.copytree(tree, copy, symlinks=True, ignore=lambda at, _: LEFT_OUT if Path(at) == tree else ())
        free.put(copy)

    def attempt(fault: Fault) -> FaultOutcome:
        copy = free.get()
        try:
            outcome = try_one(fault, copy, tree)
        finally:
            free.put(copy)
        said = outcome.trouble or outcome.caught_by or "NOT CAUGHT"
        print(f"{outcome.seconds:6.0f} s  {fault.file}: {fault.kind}: {said}", file=sys.stderr, flush=True)
        return outcome

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(attempt, faults))


def try_one(fault: Fault, copy: Path, tree: Path) -> FaultOutcome:
    """Put the fault into the copy, run its tests, and take it out again."""
    begin, file = perf_counter(), place_of(fault, copy)
    if file is None:
        return FaultOutcome(fault, "", 0.0, "the piece of code does not occur exactly once: renew the fault")
    code = file.read_text().replace(fault.old, fault.new)
    file.write_text(code)
    # callers elsewhere have compiled code of the function in the cache: recompile them
    cache = tempfile.mkdtemp(dir=copy.parent) if _COMPILED.search(code) else None
    try:
        said = run_tests(copy, fault.tests, cache)
    finally:
        shutil.copy2(tree / file.relative_to(copy), file)
        if cache:
            shutil.rmtree(cache)
    failed = _FAILED.search(said)
    if failed is None:
        return FaultOutcome(fault, "", perf_counter() - begin, "" if " passed" in said else said[-300:])
    name = failed.group(1)
    if " passed" not in run_tests(copy, (name.removeprefix("tests/"),), None):
        return FaultOutcome(fault, "", perf_counter() - begin, f"{name} fails without the fault too")
    return FaultOutcome(fault, name, perf_counter() - begin)


def place_of(fault: Fault, tree: Path) -> Path | None:
    """The file that holds the code of the fault: the one that it names, or the only other one."""
    named = tree / fault.file
    if named.is_file() and fault.old in named.read_text():
        found = [named]
    else:
        folders = [tree / part for part in FAULTY if (tree / part).is_dir()]
        files = [file for folder in folders for file in folder.rglob("*.py") if not file.is_symlink()]
        found = [file for file in files if fault.old in file.read_text()]
    return found[0] if len(found) == 1 and found[0].read_text().count(fault.old) == 1 else None


def run_tests(copy: Path, tests: Sequence[str], cache: str | None) -> str:
    """What pytest prints of one file or folder after the other, until the first failure."""
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    if cache:
        environment["NUMBA_CACHE_DIR"] = cache
    options = ["-p", "no:cacheprovider", "--exitfirst", "--quiet", "--numprocesses", "0", "-rfE"]
    said = ""
    for test in tests:
        command = [sys.executable, "-m", "pytest", *options, f"tests/{test}"]
        try:
            said = subprocess.run(
                command, cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST_S
            ).stdout
        except subprocess.TimeoutExpired:
            return f"FAILED tests/{test} (endless)"
        if _FAILED.search(said):
            break
    return said


def table(outcomes: list[FaultOutcome]) -> str:
    """In Markdown; a sentence at the end."""
    rows = []
    for outcome in outcomes:
        by = f"`{outcome.caught_by.removeprefix('tests/')}`" if outcome.caught_by else "**nothing**"
        rows.append((f"`{outcome.fault.file}`", outcome.fault.kind, outcome.trouble or by))
    caught = sum(bool(outcome.caught_by) for outcome in outcomes)
    summary = f"{caught} of {len(outcomes)} faults are caught."
    return f"{markdown_table('file | fault | caught by', rows)}\n\n{summary}"


if __name__ == "__main__":
    command(main)
