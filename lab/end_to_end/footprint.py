"""What an installation needs: disk of the packages, and memory of a run on the sample.

    python -m lab.end_to_end.footprint [--record DIR]

Disk: the files of all packages that ``polhode``, and ``polhode[dev]`` (``make setup``), require directly or
not, as they are installed in this environment. PyTorch is shown by itself: its build for processors only is
several gigabytes smaller than that with CUDA. Memory: the largest sum of the proportional set sizes (Linux)
of all processes of ``polhode run`` with the default configuration, measured every half second.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from packaging.requirements import Requirement

from lab.command import DEFAULT, RECORDS, ROOT, Record, Short, command
from lab.record import Case, complete

RECORD = RECORDS / "footprint"
PACKAGES: Case = {"of": "packages"}
INTERVAL_S = 0.5


def main(short: Short = False, record: Record = RECORD) -> None:
    """Measure what the record lacks and print it; short: the packages alone."""
    cases = [PACKAGES] if short else [PACKAGES, {"of": "run on the sample"}]
    print("\n".join(map(line_of, complete(record, cases, measure, 1))))


def line_of(found: Case) -> str:
    """What is printed of a case."""
    if found["case"] != PACKAGES:
        return f"memory: {found['memory_gb']:.1f} GB"
    return (
        f"disk: {found['core_gb']:.1f} GB of packages, of which PyTorch ({found['torch']}) has "
        f"{found['torch_gb']:.1f} GB; with the tools of developers {found['dev_gb']:.1f} GB"
    )


def measure(case: Case) -> dict[str, Any]:
    """Gigabytes (1e9 bytes)."""
    if case != PACKAGES:
        return {"memory_gb": memory_of_run(ROOT / "examples" / "sample") / 1e9}
    torch = distribution("torch")
    return {
        "core_gb": size_of(required("polhode", frozenset())) / 1e9,
        "dev_gb": size_of(required("polhode", frozenset({"dev"}))) / 1e9,
        "torch_gb": size_of({"torch": torch}) / 1e9,
        "torch": torch.version,
    }


def required(name: str, extras: frozenset[str]) -> dict[str, Distribution]:
    """All installed distributions that one needs, itself included, by their names."""
    found: dict[str, Distribution] = {}
    seen, waiting = set(), [(name, extras)]
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        with suppress(PackageNotFoundError):
            here = distribution(name)
            found[here.metadata["Name"]] = here
            waiting += [(need.name, frozenset(need.extras)) for need in _needs(here, extras)]
    return found


def _needs(here: Distribution, extras: frozenset[str]) -> Iterator[Requirement]:
    for line in here.requires or ():
        need = Requirement(line)
        if need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield need


def size_of(distributions: dict[str, Distribution]) -> int:
    """Bytes of their files."""
    files = (Path(str(file.locate())) for each in distributions.values() for file in each.files or ())
    return sum(file.stat().st_size for file in files if file.is_file())


def memory_of_run(sequence: Path) -> int:
    """Bytes."""
    with TemporaryDirectory() as scratch:
        words = ["-m", "polhode", "run", str(DEFAULT), "--data", str(sequence), "-o", f"{scratch}/run"]
        process = subprocess.Popen([sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL)
        largest = 0
        while process.poll() is None:
            largest = max(largest, sum(map(proportional_bytes, family(process.pid))))
            with suppress(subprocess.TimeoutExpired):
                process.wait(INTERVAL_S)
    if process.returncode:
        raise RuntimeError(f"polhode run ended with exit code {process.returncode}")
    return largest


def family(pid: int) -> list[int]:
    """A process and its descendants (Linux)."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(word) for task in tasks for word in (task / "children").read_text().split()]
    except OSError:
        return []
    return [pid, *(each for child in children for each in family(child))]


def proportional_bytes(pid: int) -> int:
    """Memory of a process, with its share of what it has in common with others; 0: it has ended."""
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")), 0)


if __name__ == "__main__":
    command(main)
