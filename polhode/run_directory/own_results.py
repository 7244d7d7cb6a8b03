"""Whether the files in the folder of a run are those that the run wrote: their digests in summary.json.

Files of two runs in one folder give numbers that belong to no run, and nothing in them shows it: attitudes of
one motion with the inertia of another, for example.
"""

import logging
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from polhode.files.foreign_files import GIB, sha256_of
from polhode.files.output.run_files import LATER, SUMMARY, is_run_file
from polhode.run_directory.archives import (
    read_covariance,
    read_measurements,
    read_online,
    read_relative_poses,
    read_residuals,
)
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError

NUMBERS: dict[str, tuple[Callable[[Path], object], ...]] = {
    "trajectory.csv": (read_trajectory,),
    "covariance.npz": (read_covariance,),
    "measurements.npz": (read_measurements, read_relative_poses, read_residuals),
    "online.npz": (read_online,),
}
"""By name: the files whose numbers are used together, and their readers."""
EDITABLE: tuple[str, ...] = ("config.yaml", "landmarks.ply", "mesh.ply")
"""Files that users may change on purpose: a mesh is cleaned, a configuration is run again."""
METRICS = "metrics.json"
OF_SUMMARY = "summary_sha256"
"""In metrics.json: the digest of the summary.json of the run that was evaluated."""

_log = logging.getLogger(__name__)


def digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256, hexadecimal, of those of a run's files that do not change later; pictures are left out."""
    kept = (name for name in sorted(names) if "/" not in name and not name.startswith("."))
    return {name: _digest(folder / name) for name in kept if name == "config.yaml" or name not in LATER}


def require_own_results(folder: Path, recorded: Mapping[str, str] | None) -> None:
    """Compare the files of a run with the digests that its summary has; None: an earlier version wrote none.

    Raises InputError for sound numbers that are not this run's. Damaged files are left to their readers,
    which say what is wrong with them; for surfaces, landmarks and the configuration there is a warning.
    """
    for name in () if recorded is None else (*NUMBERS, *EDITABLE):
        file = folder / name
        found = _readable_digest(file) if file.is_file() else None
        if recorded is None or found is None or found == recorded.get(name):
            continue
        why = "has another digest" if name in recorded else "has no digest of it"
        wrong = f"{file}: not the file that this run wrote (summary.json {why})"
        if name in EDITABLE:
            _log.warning("%s; it was changed, or is of another run", wrong)
            continue
        try:
            for read in NUMBERS[name]:
                read(file)
        except InputError:
            continue
        raise InputError(f"{wrong}; take all files of one run")


def changed_results(folder: Path, recorded: Mapping[str, str] | None) -> set[str]:
    """Names of the files that are no longer what the run wrote, by the digests of its summary."""
    return {
        name
        for name, digest in (recorded or {}).items()
        if is_run_file(name) and (folder / name).is_file() and _readable_digest(folder / name) != digest
    }


def summary_digest(folder: Path) -> str:
    """Of a run's summary.json, by which metrics.json names the run that it belongs to."""
    return _digest(folder / SUMMARY)


def own_metrics(folder: Path, metrics: dict[str, Any]) -> dict[str, Any]:
    """The metrics of a run; none, with a warning, if they were made from another summary than the run has.

    Metrics of earlier versions do not name their run, and are taken as they are.
    """
    recorded = metrics.pop(OF_SUMMARY, None)
    if recorded is None or recorded == summary_digest(folder):
        return metrics
    _log.warning(
        "%s: of another run, or summary.json was changed; left out: polhode evaluate makes them again",
        folder / METRICS,
    )
    return {}


def _readable_digest(file: Path) -> str | None:
    """None: it cannot be read, or is too large."""
    try:
        return _digest(file)
    except InputError:
        return None


def _digest(file: Path) -> str:
    return sha256_of(file, GIB, "a file of a run")
