"""The short forms of benchmarks, two at a time, in processes that have imported most of what they need."""

import os
import runpy
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from lab.command import DEFAULT, ROOT, polhode
from lab.registry import SAMPLE_RUN, Benchmark

AT_ONCE = 2
"""Short forms that run beside each other; each takes one core."""
TIMEOUT_S = 600
"""Of a short form, which takes seconds: one that hangs is ended."""
SHOWN_LINES = 30
"""Last lines of the output of a short form that failed."""
PROCESSES = get_context("forkserver")
"""Of the short forms: what most of them import is imported once."""
PROCESSES.set_forkserver_preload(["tyro", "polhode.api", "polhode.pipeline.run", "polhode.simulation"])


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
    start = perf_counter()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "output"
        process = PROCESSES.Process(target=_as_program, args=(benchmark.words(short=True)[1:], file))
        process.start()
        process.join(TIMEOUT_S)
        if process.is_alive():
            process.kill()
            process.join()
        output = file.read_text(errors="backslashreplace") if file.exists() else "it did not start"
        used = file.with_name("processor")
        processor_s = used.read_text() if used.exists() else "?"
    passed = process.exitcode == 0
    seconds = f"{perf_counter() - start:5.0f} s, {processor_s:>3} s of the processor"
    lines = [f"{'passed' if passed else 'FAILED'}  {seconds}  {benchmark.name}"]
    if not passed:
        lines += [f"    python {' '.join(benchmark.words(short=True))}", f"    exit code {process.exitcode}"]
        lines += [f"    {line}" for line in output.splitlines()[-SHOWN_LINES:]]
    print("\n".join(lines), flush=True)
    return passed


def _as_program(words: list[str], output: Path) -> None:
    """Run ``python -m words`` in this process, which has imported most of what it needs."""
    with output.open("w") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    os.chdir(ROOT)
    sys.argv = words
    try:
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)
    finally:
        output.with_name("processor").write_text(f"{sum(os.times()[:4]):.0f}")


def make_sample_run() -> None:
    """The run of `make demo`, unless it is there."""
    folder = ROOT / SAMPLE_RUN
    if not (folder / "metrics.json").is_file():
        polhode("run", DEFAULT, "--data", "examples/sample", "-o", folder, "--overwrite")
        polhode("evaluate", folder, "examples/sample")
