"""What an installation needs: disk of the packages, and memory of a run on the sample.

    python -m benchmarks.end_to_end.footprint [--record FILE]

Disk: the files of all packages that ``polhode``, and ``polhode[dev]`` (``make setup``), require directly or
not, as they are installed in this environment. PyTorch is shown by itself: its build for processors only is
several gigabytes smaller than that with CUDA. Memory: the largest sum of the proportional set sizes (Linux)
of all processes of ``polhode run`` with the default configuration, looked at every half second.
"""

import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from packaging.requirements import Requirement

from benchmarks.command import DEFAULT, RECORDS, ROOT, Record, command
from benchmarks.record import Case, complete

RECORD = RECORDS / "footprint"
CASES: tuple[Case, ...] = ({"of": "packages"}, {"of": "run on the sample"})
LOOK_S = 0.5


def main(record: Record = RECORD) -> None:
    """Measure what the record lacks and print it."""
    print("\n".join(map(line_of, complete(record, CASES, measure, 1))))


def line_of(found: Case) -> str:
    """What is printed of a case."""
    if found["case"]["of"] != "packages":
        return f"memory: {found['memory_gb']:.1f} GB"
    return (
        f"disk: {found['core_gb']:.1f} GB of packages, of which PyTorch ({found['torch']}) has "
        f"{found['torch_gb']:.1f} GB; with the tools of developers {found['dev_gb']:.1f} GB"
    )


def measure(case: Case) -> dict[str, Any]:
    """Gigabytes (1e9 bytes)."""
    if case["of"] != "packages":
        return {"memory_gb": memory_of_run(ROOT / "sample") / 1e9}
    core, dev = required("polhode", frozenset()), required("polhode", frozenset({"dev"}))
    torch = distribution("torch")
    return {
        "core_gb": size_of(core) / 1e9,
        "dev_gb": size_of(dev) / 1e9,
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
        try:
            here = distribution(name)
        except PackageNotFoundError:
            continue
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
        process = subprocess.Popen(
            [sys.executable, *words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        most = 0
        while process.poll() is None:
            most = max(most, sum(map(proportional_bytes, family(process.pid))))
            with_patience(process)
    if process.returncode:
        raise RuntimeError(f"polhode run ended with exit code {process.returncode}")
    return most


def with_patience(process: "subprocess.Popen[bytes]") -> None:
    """Wait until it ends or it is time to look again."""
    try:
        process.wait(LOOK_S)
    except subprocess.TimeoutExpired:
        return


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
