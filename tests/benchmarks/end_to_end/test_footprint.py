"""Disk and memory: of what is counted nothing is missing, nothing counts twice."""

import os
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

from benchmarks.end_to_end.footprint import family, line_of, proportional_bytes, required, size_of


def test_what_a_package_requires_is_counted() -> None:
    core, dev = required("polhode", frozenset()), required("polhode", frozenset({"dev"}))
    assert {"polhode", "torch", "numpy"} <= set(core)
    assert "pytest" not in core and "pytest" in dev
    assert size_of(core) < size_of(dev)


def test_the_size_of_a_package_is_that_of_its_files() -> None:
    found = distribution("tyro")
    folder = Path(str(found.locate_file("tyro")))
    files = sum(path.stat().st_size for path in folder.rglob("*.py"))
    assert size_of({"tyro": found}) >= files > 0


def test_processes_below_a_process_are_its_family() -> None:
    code = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'input()'])"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as process:
        while len(family(process.pid)) < 2:
            assert process.poll() is None
        assert set(family(process.pid)) < set(family(os.getpid()))
        assert proportional_bytes(process.pid) > 1_000_000
        process.communicate(b"\n")
    assert family(process.pid) == []


def test_what_is_printed() -> None:
    packages = {"core_gb": 2.04, "dev_gb": 2.4, "torch_gb": 0.76, "torch": "2.13.0+cpu"}
    disk = line_of({"case": {"of": "packages"}, **packages})
    assert disk.startswith("disk: 2.0 GB of packages, of which PyTorch (2.13.0+cpu) has 0.8 GB")
    assert line_of({"case": {"of": "run on the sample"}, "memory_gb": 1.55}) == "memory: 1.6 GB"
