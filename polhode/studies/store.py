"""The folder of a study: a record for each point, simulated sequences, runs that are kept.

Records and sequences are named by what they are made of (their address), so that whoever needs one can see
whether it is there. A record is written whole or not at all, by the process that computed the point. When all
points of a study are stored, their records are packed into one file: each takes up a block of the disk.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from polhode.files.atomic import replaced, write_text
from polhode.files.foreign_files import MIB, read_text
from polhode.runtime.errors import InputError

POINTS, SEQUENCES, RUNS, WORK = "points", "sequences", "runs", "work"
PARTS = (POINTS, SEQUENCES, RUNS, WORK)
PACKED = "records.parquet"
PACKED_AT_ONCE = 500
"""Records of a row group of that file: so many are in memory"""

Record = dict[str, Any]
Item = TypeVar("Item")


@dataclass(frozen=True)
class Store:
    """Where a study keeps what it has computed."""

    folder: Path

    def record_file(self, address: str) -> Path:
        """Of a point; a folder for every 256th of them."""
        return self.folder / POINTS / address[:2] / f"{address[2:]}.json"

    def sequence_folder(self, digest: str) -> Path:
        """Of a simulated sequence."""
        return self.folder / SEQUENCES / digest[:24]

    def run_folder(self, address: str) -> Path:
        """Of what is kept of a point's run."""
        return self.folder / RUNS / address[:24]

    def has_sequence(self, digest: str) -> bool:
        """Whether it is complete: the folder appears when it is."""
        return (self.sequence_folder(digest) / "mav0").is_dir()

    def has_records(self) -> bool:
        """Whether any point is stored, of whatever study."""
        return bool(len(self._packed.addresses)) or next(self._files(), None) is not None

    def read(self, address: str) -> Record | None:
        """The record of a point; None: there is none, or it is damaged and the point is computed again.

        Raises InputError: the file of the packed records is damaged.
        """
        with suppress(InputError, OSError, ValueError, KeyError, TypeError, RecursionError):
            return _record(read_text(self.record_file(address), 4 * MIB, "a record of a study"), address)
        packed = self._packed.get(address)
        with suppress(ValueError, KeyError, TypeError, RecursionError):
            return None if packed is None else _record(packed, address)
        return None

    def records(self) -> Iterator[Record]:
        """All records, of whatever study: first those that are packed, in the order of their packing."""
        files = (f"{file.parent.name}{file.stem}" for file in sorted(self._files()))
        # those that are packed and have a file, too, come twice
        for address in dict.fromkeys(chain((each.decode() for each in self._packed.addresses), files)):
            if (record := self.read(address)) is not None:
                yield record

    def pack(self, first: Iterable[str] = (), without: Container[str] = ()) -> None:
        """Put all records into one file, beginning with those of ``first`` (addresses), and remove those of
        ``without``. Raises RunFailure."""
        files = list(self._files())
        if not files and not without:
            return

        def texts() -> Iterator[dict[str, str]]:
            seen: set[str] = set()
            for record in chain((self.read(address) for address in first), self.records()):
                if record is not None and record["address"] not in seen:
                    seen.add(record["address"])
                    if record["address"] not in without:
                        yield {"address": record["address"], "record": _text(record)}

        schema = pa.schema([("address", pa.string()), ("record", pa.string())])
        with (
            replaced(self.folder / PACKED) as partial,
            pq.ParquetWriter(partial, schema, compression="zstd") as writer,
        ):
            for rows in batches(texts(), PACKED_AT_ONCE):
                writer.write_table(pa.Table.from_pylist(rows, schema), row_group_size=PACKED_AT_ONCE)
        self.__dict__.pop("_packed", None)
        for file in files:
            file.unlink()
            with suppress(OSError):
                file.parent.rmdir()

    def _files(self) -> Iterator[Path]:
        return (self.folder / POINTS).glob("??/*.json")

    @cached_property
    def _packed(self) -> "_Packed":
        return _Packed(self.folder / PACKED)

    def write(self, record: Record) -> None:
        """Store the record of a point, whole or not at all. Raises RunFailure."""
        file = self.record_file(record["address"])
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, _text(record) + "\n")

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


class _Packed:
    """The records of the one file: where each is, and the group of rows that was read last."""

    def __init__(self, path: Path) -> None:
        """Raises InputError: the file is damaged."""
        self._path, self._group, self._texts = path, -1, list[str]()
        self.addresses, sizes = np.empty(0, "S64"), list[int]()
        """In the order of the file; in fixed widths, a million of them take 64 MB"""
        with self._readable():
            if path.is_file():
                self._file = pq.ParquetFile(path)
                groups = self._file.metadata
                sizes = [groups.row_group(k).num_rows for k in range(groups.num_row_groups)]
                self.addresses = np.array(self._file.read(["address"]).column(0).to_pylist()).astype("S64")
        self._starts = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
        self._rows = np.argsort(self.addresses, kind="stable")

    def get(self, address: str) -> str | None:
        """The text of a record; None: it is not there. Raises InputError."""
        wanted = address.encode()
        place = int(np.searchsorted(self.addresses, wanted, sorter=self._rows))
        if place == len(self.addresses) or self.addresses[self._rows[place]] != wanted:
            return None
        row = int(self._rows[place])
        group = int(np.searchsorted(self._starts, row, side="right")) - 1
        if group != self._group:
            with self._readable():
                self._texts = self._file.read_row_group(group, ["record"]).column(0).to_pylist()
            self._group = group
        return self._texts[row - int(self._starts[group])]

    @contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except (pa.ArrowException, OSError, UnicodeEncodeError) as error:
            said = str(error).partition("\n")[0][:120]
            raise InputError(
                f"{self._path} cannot be read ({said}); remove it, and its points are computed again"
            ) from None


def _record(text: str, address: str) -> Record:
    """A record as it was written. Raises ValueError, KeyError, TypeError: it is damaged, or of another
    point."""
    content = json.loads(text)
    record = content["record"]
    if content["digest"] != _digest(record) or record["address"] != address:
        raise ValueError(address)
    return dict(record)


def _text(record: Record) -> str:
    return json.dumps({"record": record, "digest": _digest(record)}, allow_nan=False)


def _digest(record: Record) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def batches(items: Iterable[Item], size: int) -> Iterator[list[Item]]:
    """The items in lists of at most so many."""
    rest = iter(items)
    while batch := list(islice(rest, size)):
        yield batch
