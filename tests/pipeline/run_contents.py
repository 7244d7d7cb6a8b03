"""The files of a result by content, without times and logs."""

import hashlib
import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

TIMES = (
    "timing_s",
    "wall_s",
    "seconds",
    "own_sha256",
    "summary_sha256",
    "digest",
    "sha256",
    "trace",
    "memory_mb",
)
"""Keys of JSON files and names of arrays that differ from call to call: times, and digests of these"""
PARTIAL = re.compile(r"\..+\.partial-\d+(\.\w+)?")
"""Temporary files: no part of a result"""


def contents(place: Path) -> dict[str, str]:
    """Digests of the files below ``place``/R; of pages and logs, which contain times, only their presence."""
    files = sorted(path for path in (place / "R").rglob("*") if path.is_file())
    return {
        path.relative_to(place).as_posix(): _digest(path, place)
        for path in files
        if not PARTIAL.fullmatch(path.name)
    }


def _digest(path: Path, place: Path) -> str:
    if path.name.endswith((".html", "log.txt", ".polhode-output")):
        return "there"
    content = path.read_bytes().replace(str(place).encode(), b"PLACE")
    if path.suffix == ".json":
        content = json.dumps(_without_times(json.loads(content)), sort_keys=True).encode()
    if path.suffix == ".npz":
        with suppress(ValueError, BadZipFile), np.load(path) as arrays:
            kept = [name for name in sorted(arrays) if name not in TIMES]
            content = b"".join(name.encode() + _bytes(name, arrays[name]) for name in kept)
    return hashlib.sha256(content).hexdigest()[:16]


def _bytes(name: str, values: Any) -> bytes:
    """Of an array; of the tree of a stored result (polhode/files/record_files.py) without times."""
    return (
        json.dumps(_without_times(json.loads(values.tobytes()))).encode()
        if name == "tree"
        else values.tobytes()
    )


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(each) for key, each in value.items() if key not in TIMES}
    return [_without_times(each) for each in value] if isinstance(value, list) else value
