"""The files of a result by content, without times and logs."""

import hashlib
import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

TIMES = re.compile("timing_s|wall_s|seconds|(own_|summary_)?sha256|digest|trace|memory_mb")
"""Keys of JSON files and names of arrays that differ from call to call: times, and digests of these"""


def contents(place: Path) -> dict[str, str]:
    """Digests of the files below ``place``/R; of pages and logs, which contain times, only their presence."""
    files = (path for path in (place / "R").rglob("*") if path.is_file())
    temporary = re.compile(r"\..+\.partial-\d+(\.\w+)?")
    return {
        path.relative_to(place).as_posix(): _digest(path, place)
        for path in sorted(files)
        if not temporary.fullmatch(path.name)
    }


def _digest(path: Path, place: Path) -> str:
    if path.name.endswith((".html", "log.txt", ".polhode-output")):
        return "there"
    content = path.read_bytes().replace(str(place).encode(), b"PLACE")
    if path.suffix == ".json":
        content = _without_times(content)
    if path.suffix == ".npz":
        with suppress(ValueError, BadZipFile), np.load(path) as arrays:
            kept = {name: arrays[name].tobytes() for name in sorted(arrays) if not TIMES.fullmatch(name)}
            # "tree": of a stored result (polhode/files/record_files.py)
            content = b"".join(
                name.encode() + (_without_times(each) if name == "tree" else each)
                for name, each in kept.items()
            )
    return hashlib.sha256(content).hexdigest()[:16]


def _without_times(content: bytes) -> bytes:
    def kept(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return {key: value for key, value in pairs if not TIMES.fullmatch(key)}

    return json.dumps(json.loads(content, object_pairs_hook=kept), sort_keys=True).encode()
