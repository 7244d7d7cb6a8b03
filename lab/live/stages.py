"""Seconds of each stage of a run by the clock: the first run, which compiles, and the second.

    python -m lab.live.stages [SEQ] [--short]

``polhode run`` with the default configuration, the shipped sample unless another sequence is named; the first
run begins with an empty folder for compiled code. Stages overlap where one process works beside another, so
that their sum may exceed the total. Last row: seconds of the processor, of all processes.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from lab.command import DEFAULT, LIGHT, ROOT, Short, beginning_of_sample, command
from lab.presentation import print_table


def main(
    sequence: Positional[Annotated[Path, arg(metavar="SEQ", help="Folder of a sequence.")]] = ROOT
    / "examples"
    / "sample",
    short: Short = False,
) -> None:
    """Measure and print; short: one run of the first seconds, with the code that is compiled already."""
    runs = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if short:
            sequence = beginning_of_sample()
        (folder / "compiled").mkdir(mode=0o700)
        environment = {} if short else {"NUMBA_CACHE_DIR": str(folder / "compiled")}
        for name in ("run",) if short else ("first", "second"):
            options = [f"--{key}={value}" for key, value in LIGHT.items()] if short else []
            runs.append(stage_times(sequence, folder / name, environment, options))
    stages = list(dict.fromkeys(stage for each in runs for stage in each))
    head = ["stage", *(["run [s]"] if short else ["first run [s]", "second run [s]"])]
    print_table(head, ([stage, *(f"{each.get(stage, 0.0):.1f}" for each in runs)] for stage in stages))


def stage_times(
    sequence: Path, output: Path, environment: dict[str, str], options: list[str]
) -> dict[str, float]:
    """Seconds by stage, the total and those of the processor of one run."""
    words = ["-m", "polhode", "run", str(DEFAULT), "--data", str(sequence), "-o", str(output), *options]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.DEVNULL,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode > 1:
        raise SystemExit(done.returncode)
    found = dict(json.loads((output / "summary.json").read_text(encoding="utf-8"))["timing_s"])
    total = found.pop("total")
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return found | {"total": total, "of the processor": processor}


if __name__ == "__main__":
    command(main)
