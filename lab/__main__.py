"""Run benchmarks by topic or name, or the short form of each of them.

    python -m lab [TOPIC|NAME ...]             one after the other, as the pages quote them: hours
    python -m lab --short [TOPIC|NAME ...]     a short form of each, two at a time: minutes
    python -m lab --list [TOPIC|NAME ...]      what there is, and how long it takes

The short forms show that the commands work, not the numbers of the pages. Those that need a run take that of
the sample, which is made once, in runs/short. A benchmark whose requirements are missing is skipped; one that
fails does not stop the others, and the exit code is then 1.
"""

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import Annotated

from tyro.conf import Positional, arg

from lab.command import DEFAULT, ROOT, command, polhode
from lab.presentation import print_table
from lab.registry import SAMPLE_RUN, Benchmark, chosen

AT_ONCE = 2
"""Short forms that run beside each other; each takes one core."""
TIMEOUT_S = 600
"""Of a short form, which takes seconds: one that hangs is ended."""
SHOWN_LINES = 30
"""Last lines of the output of a short form that failed."""


def main(
    names: Positional[Annotated[tuple[str, ...], arg(metavar="TOPIC|NAME")]] = (),
    short: Annotated[bool, arg(help="The short form of each.")] = False,
    list_: Annotated[bool, arg(name="list", help="List the benchmarks instead of running them.")] = False,
) -> None:
    """Run or list the selected benchmarks."""
    benchmarks = chosen(names)
    if list_:
        head = "topic | name | what it prints | minutes | page"
        rows = [(each.topic, each.name, each.prints, f"{each.minutes:g}", each.page) for each in benchmarks]
        print_table(head, rows)
        return
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


def run_short_forms(benchmarks: list[Benchmark]) -> list[str]:
    """Run the short forms, print a line for each, and return the names of those that failed."""
    runnable = []
    for each in benchmarks:
        missing = "it has no short form" if each.short is None else each.missing(short=True)
        if missing:
            print(f"skipped          {each.name}: {missing}", flush=True)
        else:
            runnable.append(each)
    # a record of an earlier short form would leave nothing to do
    shutil.rmtree(ROOT / "runs/short/records", ignore_errors=True)
    if any(SAMPLE_RUN in (each.short or "") for each in runnable):
        make_sample_run()
    with ThreadPoolExecutor(AT_ONCE) as pool:
        results = list(pool.map(_run_short_form, runnable))
    return [each.name for each, passed in zip(runnable, results, strict=True) if not passed]


def _run_short_form(benchmark: Benchmark) -> bool:
    """Whether it succeeded; its output is printed if it did not."""
    words, start = [sys.executable, *benchmark.words(short=True)], perf_counter()
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        passed, output = done.returncode == 0, done.stdout + done.stderr
    except subprocess.TimeoutExpired:
        passed, output = False, f"no end after {TIMEOUT_S} s"
    seconds = f"{perf_counter() - start:5.0f} s"
    lines = [f"{'passed' if passed else 'FAILED'}  {seconds}  {benchmark.name}"]
    if not passed:
        lines += [f"    python {' '.join(words[1:])}"]
        lines += [f"    {line}" for line in output.splitlines()[-SHOWN_LINES:]]
    print("\n".join(lines), flush=True)
    return passed


def make_sample_run() -> None:
    """The run of the sample that short forms read, with its errors; nothing is done where it is there."""
    folder = ROOT / SAMPLE_RUN
    if not (folder / "metrics.json").is_file():
        polhode("run", DEFAULT, "--data", "examples/sample", "-o", folder, "--overwrite")
        polhode("evaluate", folder, "examples/sample")


if __name__ == "__main__":
    command(main)
