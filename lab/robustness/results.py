"""What a command left: its files by content, without times and logs, and whether that is a whole result."""

import csv
import hashlib
import io
import json
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal
from zipfile import BadZipFile

import numpy as np

State = Literal["absent", "old", "new", "failed", "unfinished", "half", "lost"]
"""Nothing; the earlier result; the complete one; a run that says that it failed; one that resumes; part of a
result; the earlier result is no longer whole"""

TIMES = (
    *("timing_s", "training_s", "prepared_s", "wall_s", "build_s", "evaluation_s", "linear_s", "callback_s"),
    *("memory_mb", "memory_before_mb", "trace", "profiles", "machine", "elapsed_s"),
    *("own_sha256", "summary_sha256", "digest", "sha256", "seconds"),
)
"""Keys of JSON files and names of arrays that differ from call to call: times, and digests of these"""
UNLIKE = (".html", "log.txt", "checkpoint.safetensors", ".polhode-output")
"""Endings of files that contain times, or names that are yet to be written: only their presence counts"""
SKIPPED = ("curves",)
"""Folders of files whose names contain times"""
PARTIAL = re.compile(r"\..+\.partial-\d+(\.\w+)?")
"""Temporary files: no part of a result; the repeated command removes them"""


def contents(place: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Digests of the files below ``place`` that belong to the results of these names."""
    found = {}
    for name in names:
        root = place / name
        files = [root] if root.is_file() else sorted(path for path in root.rglob("*") if path.is_file())
        for path in files:
            parts = path.relative_to(place).parts
            if not set(SKIPPED) & set(parts) and not PARTIAL.fullmatch(path.name):
                found["/".join(parts)] = _digest(path, place)
    return found


def _digest(path: Path, place: Path) -> str:
    if path.name.endswith(UNLIKE):
        return "there"
    content = path.read_bytes().replace(str(place).encode(), b"PLACE")
    if path.suffix == ".json":
        content = json.dumps(_without_times(json.loads(content)), sort_keys=True).encode()
    if path.name == "compare.csv":
        rows = csv.DictReader(io.StringIO(content.decode()))
        content = json.dumps([_without_times(row) for row in rows]).encode()
    if path.suffix == ".npz":
        with suppress(ValueError, BadZipFile), np.load(path) as arrays:
            kept = [name for name in sorted(arrays) if name not in TIMES]
            content = b"".join(name.encode() + _bytes(name, arrays[name]) for name in kept)
    return hashlib.sha256(content).hexdigest()[:16]


def _bytes(name: str, values: Any) -> bytes:
    """Of an array; of the tree of a stored result (polhode/files/record_files.py) without times."""
    if name != "tree":
        return bytes(values.tobytes())
    return json.dumps(_without_times(json.loads(values.tobytes()))).encode()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(each) for key, each in value.items() if key not in TIMES}
    return [_without_times(each) for each in value] if isinstance(value, list) else value


def judged(now: dict[str, str], old: dict[str, str], new: dict[str, str], resumes: bool) -> State:
    """What the files of the results are, beside those of the earlier and of the undisturbed result."""
    if now == new:
        return "new"
    if old and now == old:
        return "old"
    if old:
        return "lost"
    # A folder that has only been marked as ours is empty.
    if all(name.endswith("/.polhode-output") for name in now):
        return "absent"
    return "unfinished" if resumes else "half"


def names_of(place: Path) -> tuple[str, ...]:
    """Names of all files and folders below ``place``, hidden ones too, sorted."""
    found = []
    for root, folders, files in os.walk(place):
        found += [os.path.relpath(os.path.join(root, name), place) for name in (*folders, *files)]  # noqa: PTH118
    return tuple(sorted(found))


def size_of(place: Path) -> int:
    """Bytes of all files below ``place``, each rounded up to pages of 4 KiB."""
    return sum(-(-path.lstat().st_size // 4096) * 4096 for path in place.rglob("*"))


def is_failed_run(folder: Path) -> bool:
    """Whether the folder is a run that says that it failed."""
    try:
        return bool(json.loads((folder / "summary.json").read_text())["status"] == "failed")
    except (OSError, ValueError, KeyError):
        return False
