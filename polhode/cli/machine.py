"""What the machine and the installation offer: packages, processors, memory, space for temporary files."""

import os
import platform
import resource
import shutil
import tempfile
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

MEMINFO = Path("/proc/meminfo")
CGROUP_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
GIB = 2**30


def wrong_packages() -> list[str]:
    """Packages that polhode requires and that are missing, or too old, each in words."""
    found = []
    for requirement in map(Requirement, requires("polhode") or ()):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            found.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            found.append(f"{requirement.name} {installed} does not meet {requirement.specifier}")
    return found


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0))


def load_average() -> float | None:
    """Processes that wanted to compute, on average over the last minute; None: not known."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None


def memory_gib() -> tuple[float | None, float | None]:
    """(Usable at all, free now) [GiB]: of the machine, of the container, or by ulimit -v; None: not known."""
    known = {}
    if MEMINFO.is_file():
        for line in MEMINFO.read_text().splitlines():
            name, _, value = line.partition(":")
            known[name] = 1024 * int(value.split()[0])
    limits = [known["MemTotal"]] if "MemTotal" in known else []
    for path in CGROUP_LIMITS:
        if path.is_file() and (text := path.read_text().strip()).isdigit():
            limits.append(int(text))
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    usable = min([*limits, *([soft] if soft != resource.RLIM_INFINITY else [])], default=None)
    free = min((each for each in (known.get("MemAvailable"), usable) if each is not None), default=None)
    is_known = "MemAvailable" in known
    return usable and usable / GIB, free / GIB if free is not None and is_known else None


def scratch() -> tuple[Path, float]:
    """Where temporary files go, and the free space there [GiB]."""
    folder = Path(tempfile.gettempdir())
    return folder, shutil.disk_usage(folder).free / GIB


def python() -> str:
    """The interpreter, as people name it."""
    system = f"{platform.system()} {platform.machine()}"
    return f"{platform.python_implementation()} {platform.python_version()} on {system}"
