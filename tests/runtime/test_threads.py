"""The work runs on one thread for each library, whatever the shell says and whatever was imported before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from polhode.runtime.threads import VARIABLES


def output(code: str, **variables: str) -> str:
    """What the code prints in a process without any variable that limits threads, but those given."""
    clean = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    environment = clean | {"PYTHONPATH": str(Path.cwd())} | variables
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, env=environment, capture_output=True, text=True
    )
    return done.stdout.strip()


CORES = len(os.sched_getaffinity(0))
COUNTS = """
from threadpoolctl import threadpool_info
def counts():
    return max(each["num_threads"] for each in threadpool_info())
"""
MANY = {"OPENBLAS_NUM_THREADS": "4", "OMP_NUM_THREADS": "4"}
"""A shell that asks for more; OpenBLAS takes no more than there are cores."""


def test_libraries_that_are_loaded_before_or_later_are_limited() -> None:
    limit = "from polhode.runtime.threads import limit_threads\n"
    code = f"import numpy\n{COUNTS}\n{limit}before = counts()\nlimit_threads(1)\nprint(before > 1, counts())"
    assert output(code, **MANY) == f"{CORES > 1} 1"
    assert output(f"{limit}limit_threads(1)\nimport numpy\n{COUNTS}print(counts())", **MANY) == "1"


def test_work_is_limited_only_while_it_runs_and_may_be_nested() -> None:
    code = f"""
import numpy, cv2, torch
{COUNTS}
from polhode.runtime.threads import single_threaded
def all_counts():
    return counts(), torch.get_num_threads(), cv2.getNumThreads()
cv2.setNumThreads(4)
@single_threaded
def work(depth=1):
    return work(depth - 1) if depth else all_counts()
before = all_counts()
print(work(), all_counts() == before, before[2])
from polhode.runtime.threads import limit_threads
limit_threads(2)
print(single_threaded(counts)())
"""
    assert output(code, **MANY) == f"(1, 1, 1) True 4\n{min(2, CORES)}"


@pytest.mark.parametrize("entry", ["estimate_motion", "estimate_online", "initialize_motion"])
def test_the_estimator_called_from_python_is_limited(entry: str) -> None:
    """``import numpy, polhode`` as a user writes it: the call reaches its first line on one thread."""
    code = f"""
import numpy
{COUNTS}
import polhode.backend
class Measured:
    def __getattr__(self, name):
        print(counts())
        raise SystemExit
polhode.backend.{entry}(Measured(), Measured(), Measured(), Measured())
"""
    code = code if entry == "estimate_motion" else code.replace(", Measured())\n", ")\n")
    assert output(code, **MANY) == "1"
