"""The folder of a study: a record for each point, simulated sequences, runs that are kept.

Records and sequences are named by what they are made of (their address), so that whoever needs one can see
whether it is there. A record is written whole or not at all, by the process that computed the point.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polhode.atomic import write_text
from polhode.errors import InputError
from polhode.foreign_files import MIB, read_text

POINTS, SEQUENCES, RUNS, WORK = "points", "sequences", "runs", "work"
PARTS = (POINTS, SEQUENCES, RUNS, WORK)
MAX_RECORD_BYTES = 4 * MIB
_SHORT = 24
"""Hexadecimal digits of the names of folders"""

Record = dict[str, Any]


@dataclass(frozen=True)
class Store:
    """Where a study keeps what it has computed."""

    folder: Path

    def record_file(self, address: str) -> Path:
        """Of a point; a folder for every 256th of them."""
        return self.folder / POINTS / address[:2] / f"{address[2:]}.json"

    def sequence_folder(self, digest: str) -> Path:
        """Of a simulated sequence."""
        return self.folder / SEQUENCES / digest[:_SHORT]

    def run_folder(self, address: str) -> Path:
        """Of what is kept of a point's run."""
        return self.folder / RUNS / address[:_SHORT]

    def has_sequence(self, digest: str) -> bool:
        """Whether it is complete: the folder appears when it is."""
        return (self.sequence_folder(digest) / "mav0").is_dir()

    def has_records(self) -> bool:
        """Whether any point is stored, of whatever study."""
        return next((self.folder / POINTS).glob("*/*.json"), None) is not None

    def read(self, address: str) -> Record | None:
        """The record of a point; None: there is none, or it is damaged and the point is computed again."""
        with suppress(InputError, OSError, ValueError, KeyError, TypeError, RecursionError):
            text = read_text(self.record_file(address), MAX_RECORD_BYTES, "a record of a study")
            content = json.loads(text)
            record = content["record"]
            if content["digest"] == _digest(record) and record["address"] == address:
                return dict(record)
        return None

    def write(self, record: Record) -> None:
        """Store the record of a point, whole or not at all. Raises RunFailure."""
        file = self.record_file(record["address"])
        file.parent.mkdir(parents=True, exist_ok=True)
        content = {"record": record, "digest": _digest(record)}
        write_text(file, json.dumps(content, allow_nan=False) + "\n")

    @contextmanager
    def attempt(self) -> Iterator[Path]:
        """A folder for the work on one point, which is removed in the end."""
        (self.folder / WORK).mkdir(parents=True, exist_ok=True)
        path = Path(tempfile.mkdtemp(prefix="attempt-", dir=self.folder / WORK))
        try:
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)

    def keep(self, source: Path, address: str) -> None:
        """Let a folder become what is kept of a point's run."""
        place = self.run_folder(address)
        place.parent.mkdir(parents=True, exist_ok=True)
        # of an attempt that was killed after this step, or of one that failed
        shutil.rmtree(place, ignore_errors=True)
        source.rename(place)

    def remove_sequence(self, digest: str) -> None:
        """Remove a sequence that no point needs any more."""
        shutil.rmtree(self.sequence_folder(digest), ignore_errors=True)

    def clear_work(self) -> None:
        """Remove what killed processes left of their attempts."""
        for left in (self.folder / WORK).glob("attempt-*"):
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)


def _digest(record: Record) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()
