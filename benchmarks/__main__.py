"""Run benchmarks by topic or name, keep what they print, and show what is stored.

    python -m benchmarks [TOPIC|NAME ...] [--short]     all of them without a name
    python -m benchmarks [TOPIC|NAME ...] --list        what there is, how long it takes, and what is stored
    python -m benchmarks [TOPIC|NAME ...] --stored      print the stored results instead of measuring

What a benchmark prints is stored in runs/benchmarks/NAME.md (NAME-short.md), under a head that names the
commit and the configuration that made it; an old result is shown as old. A benchmark whose requirements are
missing is skipped; one that fails does not stop the others.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Annotated

from tyro.conf import Positional, arg

from benchmarks.command import ROOT, command
from benchmarks.presentation import print_table
from benchmarks.record import provenance, state
from benchmarks.registry import Benchmark, chosen, code_of

STORE = ROOT / "runs" / "benchmarks"
MARK = "<!-- made: "


def main(
    names: Positional[Annotated[tuple[str, ...], arg(metavar="TOPIC|NAME")]] = (),
    short: Annotated[bool, arg(help="The small versions: minutes in all.")] = False,
    list_: Annotated[bool, arg(name="list", help="List the benchmarks instead of running them.")] = False,
    stored: Annotated[bool, arg(help="Print what was stored instead of running them.")] = False,
) -> None:
    """Run, list or print the selected benchmarks."""
    benchmarks = chosen(names)
    if list_:
        head = "topic | name | what it prints | minutes | page | stored"
        print_table(
            head,
            (
                (each.topic, each.name, each.prints, f"{each.minutes:g}", each.page, stored_state(each))
                for each in benchmarks
            ),
        )
    elif stored:
        for benchmark in benchmarks:
            print_stored(benchmark, short)
    else:
        failed = [each.name for each in benchmarks if not run(each, short)]
        if failed:
            sys.exit(f"failed: {', '.join(failed)}")


def run(benchmark: Benchmark, short: bool) -> bool:
    """Run one in a process of its own, show and store what it prints; False after a failure."""
    arguments, missing = benchmark.arguments(short), benchmark.missing(short)
    if arguments is None:
        print(f"\n# {benchmark.name}: skipped, it has no small version", flush=True)
        return True
    if missing:
        print(f"\n# {benchmark.name}: skipped, it needs {missing}", flush=True)
        return True
    words = ["-m", f"benchmarks.{benchmark.module}", *arguments]
    print(f"\n# {benchmark.name}: python {' '.join(words)}\n", flush=True)
    start, lines = perf_counter(), []
    made = provenance(code_of(f"benchmarks.{benchmark.module}"))
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, *words], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            print(line, end="", flush=True)
            lines.append(line)
    if process.returncode != 0:
        return False
    head = made | {"command": f"python {' '.join(words)}", "seconds": round(perf_counter() - start)}
    STORE.mkdir(parents=True, exist_ok=True)
    file_of(benchmark, short).write_text(f"{MARK}{json.dumps(head)} -->\n\n" + "".join(lines))
    return True


def print_stored(benchmark: Benchmark, short: bool) -> None:
    """What the benchmark printed last, and whether that is old."""
    file = file_of(benchmark, short)
    print(f"\n# {benchmark.name}: {stored_state(benchmark, short)}\n")
    if file.is_file():
        print(file.read_text())


def stored_state(benchmark: Benchmark, short: bool = False) -> str:
    """Whether there is a stored result, and whether it is current."""
    file = file_of(benchmark, short)
    if not file.is_file():
        return "nothing"
    head = file.read_text().partition("\n")[0]
    made = json.loads(head.removeprefix(MARK).removesuffix(" -->")) if head.startswith(MARK) else None
    return state(made, code_of(f"benchmarks.{benchmark.module}"))


def file_of(benchmark: Benchmark, short: bool) -> Path:
    """Where what it prints is stored."""
    return STORE / f"{benchmark.name}{'-short' if short else ''}.md"


if __name__ == "__main__":
    command(main)
