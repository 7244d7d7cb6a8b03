"""Run benchmarks by topic or name, or the short form of each of them.

    python -m lab [TOPIC|NAME ...]             one after the other, as the pages quote them: hours
    python -m lab --short [TOPIC|NAME ...]     a short form of each, two at a time: minutes
    python -m lab --short --quick [...]        without those that take longest
    python -m lab --list [TOPIC|NAME ...]      what there is, and how long it takes

The short forms show that the commands work, not the numbers of the pages. Those that need a run take that of
`make demo`, which is made unless it is there. A benchmark whose requirements are missing is skipped; one that
fails does not stop the others, and the exit code is then 1.
"""

import subprocess
import sys
from typing import Annotated

from tyro.conf import Positional, arg

from lab.command import ROOT, command
from lab.presentation import print_table
from lab.registry import LONGEST, Benchmark, chosen
from lab.short_forms import run_short_forms


def main(
    names: Positional[Annotated[tuple[str, ...], arg(metavar="TOPIC|NAME")]] = (),
    short: Annotated[bool, arg(help="The short form of each.")] = False,
    quick: Annotated[bool, arg(help="Of the short forms, leave out those that take longest.")] = False,
    list_: Annotated[bool, arg(name="list", help="List the benchmarks instead of running them.")] = False,
) -> None:
    """Run or list the selected benchmarks."""
    benchmarks = chosen(names)
    if list_:
        head = "topic | name | what it prints | minutes | page"
        rows = [(each.topic, each.name, each.prints, f"{each.minutes:g}", each.page) for each in benchmarks]
        print_table(head, rows)
        return
    benchmarks = [each for each in benchmarks if not (quick and each.name in LONGEST)]
    failed = run_short_forms(benchmarks) if short else [each.name for each in benchmarks if not run(each)]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def run(benchmark: Benchmark) -> bool:
    """Run one in a process of its own and show what it prints; False after a failure."""
    missing = benchmark.missing()
    if missing:
        print(f"\n# {benchmark.name}: skipped: {missing}", flush=True)
        return True
    words = benchmark.words()
    print(f"\n# {benchmark.name}: python {' '.join(words)}\n", flush=True)
    return subprocess.run([sys.executable, *words], cwd=ROOT, check=False).returncode == 0


if __name__ == "__main__":
    command(main)
