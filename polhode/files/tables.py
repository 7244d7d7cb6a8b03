"""Reading the small text tables and YAML files of a dataset, with errors that name file and line.

A table is read line by line into arrays, so that its memory is that of its numbers, and is refused where it
has more rows or longer lines than any recording.
"""

import io
import re
from array import array
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.foreign_files import MIB, MissingFile, open_regular
from polhode.files.yaml_files import read_yaml
from polhode.geometry.lie import Array, Ints, matrix_from_wxyz
from polhode.runtime.errors import InputError

DATASET_DOCS = "docs/dataset.md"
MAX_ROWS = 4_000_000
MAX_LINE = 4096
"""Characters of a line: 14 numbers of full precision have 350."""
MAX_STAMP_NS = 2**62
"""146 years: the difference of two timestamps always fits 64 bits."""


@dataclass(frozen=True)
class Table:
    """A table of timestamps and numbers."""

    path: Path
    lines: Ints
    """(n,) line of each row in the file, for errors"""
    timestamps_ns: Ints
    """(n,) strictly increasing"""
    values: Array
    """(n, columns)"""


def read_table(path: Path, columns: int, finite: bool = True, docs: str = DATASET_DOCS) -> Table:
    """A timestamp [ns] and ``columns`` numbers a row; further columns are not read.

    Blank lines, ``#`` comments and a header are skipped; ``docs`` is the page about such tables. Raises
    InputError, which names the line, when the file is missing, is not text, has no rows or too many,
    timestamps are not whole numbers that increase, or a number is missing, or NaN or infinite where they must
    be ``finite``.
    """
    lines, stamps, values = array("q"), array("q"), array("d")
    for number, fields in _rows(path, docs):
        stamps.append(_later_stamp(path, number, fields[0], stamps[-1] if stamps else None))
        if len(fields) <= columns:
            found = f"{len(fields)} columns, expected {columns + 1}"
            raise InputError(f"{path} line {number}: {found} (see {docs})")
        try:
            values.extend([plain_number(field) for field in fields[1 : columns + 1]])
        except ValueError:
            raise InputError(f"{path} line {number}: not a number in {_shown(','.join(fields))}") from None
        lines.append(number)
    numbers = np.array(values, dtype=np.float64).reshape(len(stamps), columns)
    bad = ~np.isfinite(numbers).all(axis=1)
    if finite and bad.any():
        line = lines[int(bad.argmax())]
        raise InputError(f"{path} line {line}: NaN or infinity; remove or correct the row")
    return Table(path, np.array(lines, dtype=np.int64), np.array(stamps, dtype=np.int64), numbers)


def header_of(path: Path) -> list[str]:
    """The fields of the first line. Raises InputError as ``read_table``."""
    return next(([field.strip() for field in line.split(",")] for _, line in _lines(path)), [])


def read_listing(path: Path) -> dict[int, str]:
    """Timestamp [ns] -> name of the file, relative to the folder ``data`` beside; it defaults to <ns>.png.

    Raises InputError as ``read_table``, and for a name that is no file below that folder, or is listed twice.
    """
    names: dict[int, str] = {}
    seen: set[str] = set()
    before: int | None = None
    for number, fields in _rows(path):
        before = _later_stamp(path, number, fields[0], before)
        name = fields[1] if len(fields) > 1 and fields[1] else f"{fields[0]}.png"
        if wrong := wrong_name(name):
            raise InputError(f"{path} line {number}: the name {_shown(name)} {wrong}")
        if name in seen:
            wrong = f"{_shown(name)} is listed twice; an image has one timestamp"
            raise InputError(f"{path} line {number}: {wrong}")
        seen.add(name)
        names[before] = name
    return names


def wrong_name(name: str) -> str:
    """What is wrong with the name of an image, and what to do; empty: nothing."""
    if re.fullmatch(r"\w[\w.-]*", name, re.ASCII):
        return ""
    steps = name.replace("\\", "/").split("/")
    if steps[0] == "" or ".." in steps or re.match(r"[A-Za-z]:", name):
        return "leads out of the dataset; give that of a file in the folder data"
    if not name.isprintable() or '"' in name:
        return "has quotes or control characters; write it plainly"
    return ""


def number_rows(path: Path, columns: int, what: str, limit: int) -> Iterator[tuple[int, list[float]]]:
    """Rows of finite numbers, separated by blanks or commas, with their lines: files of other programs.

    Blank lines, ``#`` comments and words above the first row are skipped; ``what`` names the columns, for the
    message. Raises InputError, which names the line.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    rows = 0
    for number, line in _rows_of(path):
        fields, values = line.replace(",", " ").split(), []
        for field in fields:
            with suppress(ValueError):
                values.append(plain_number(field))
        if not values and not rows:
            continue
        if not len(values) == len(fields) == columns or not np.isfinite(values).all():
            raise InputError(f"{path} line {number}: give {columns} finite numbers: {what}")
        rows += 1
        if rows > limit:
            raise InputError(f"{path} line {number}: more than {limit} rows; give fewer")
        yield number, values


def _rows(path: Path, docs: str = DATASET_DOCS) -> Iterator[tuple[int, list[str]]]:
    """Rows of a table as (line number, stripped fields); skips blanks, ``#`` comments and a header."""
    rows = 0
    for number, line in _rows_of(path):
        fields = [field.strip() for field in line.split(",")]
        if number == 1 and any(letter.isalpha() for letter in fields[0]):
            continue
        rows += 1
        if rows > MAX_ROWS:
            raise InputError(f"{path} line {number}: more than {MAX_ROWS} rows; split the recording")
        yield number, fields
    if not rows:
        raise InputError(f"{path} is empty: it must list one row per frame (see {docs})")


def _rows_of(path: Path) -> Iterator[tuple[int, str]]:
    return ((number, line) for number, line in _lines(path) if line and not line.startswith("#"))


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines of a text file with their numbers, stripped; any of the three ends of a line.

    The limit of a table: a pose 100 times a second for eight hours has 450 MB.
    """
    number = 0
    try:
        with (
            open_regular(path, 512 * MIB, "a table") as stream,
            io.TextIOWrapper(stream, encoding="utf-8-sig") as text,
        ):
            readline = text.readline
            while line := readline(MAX_LINE + 1):
                number += 1
                if len(line) > MAX_LINE:
                    raise InputError(f"{path} line {number}: longer than {MAX_LINE} characters; not a table")
                if "\0" in line:
                    raise InputError(f"{path} line {number}: a zero byte; save the file as UTF-8 text")
                yield number, line.strip()
    except MissingFile:
        raise InputError(f"{path} is missing: add it (see docs/dataset.md)") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text after line {number}; save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read as text: {' '.join(str(error).split())}") from None


def _later_stamp(path: Path, number: int, field: str, before: int | None) -> int:
    """A timestamp [ns]; raises InputError when it is not a whole number above ``before``."""
    if not re.fullmatch(r"[-+]?\d{1,40}", field, re.ASCII):
        wrong = f"timestamp {_shown(field)} is not a whole number of nanoseconds"
        raise InputError(f"{path} line {number}: {wrong}")
    stamp = int(field)
    if abs(stamp) > MAX_STAMP_NS:
        raise InputError(f"{path} line {number}: timestamp {stamp} is beyond 146 years; give nanoseconds")
    if before is not None and stamp <= before:
        wrong = "repeats" if stamp == before else "goes back from"
        raise InputError(f"{path} line {number}: timestamp {stamp} {wrong} {before}; sort the rows by time")
    return stamp


def plain_number(text: str) -> float:
    """A decimal number, ``inf`` or ``nan``: not Python's 1_000, nor digits of other scripts.

    Raises ValueError.
    """
    if not text.isascii() or "_" in text:
        raise ValueError(f"{_shown(text)} is not a number")
    return float(text)


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")


def require_below(table: Table, most: float, what: str) -> None:
    """Raise InputError, naming the line, for a value whose size is above ``most``."""
    size = abs(table.values).max(axis=1)
    if size.max() > most:
        line = table.lines[int(size.argmax())]
        raise InputError(f"{table.path} line {line}: {size.max():g} is no value of {what}; correct the row")


def attitudes_of(table: Table, q_wxyz: Array, name: str) -> Array:
    """Unit quaternions (n, 4) as rotations (n, 3, 3); raises InputError naming the line of a wrong one."""
    with np.errstate(over="ignore"):
        off = abs(np.linalg.norm(q_wxyz, axis=1) - 1.0)
    if off.max() > 1e-2:
        line = table.lines[int(off.argmax())]
        raise InputError(f"{table.path} line {line}: {name} (w, x, y, z) is not a unit quaternion")
    return matrix_from_wxyz(q_wxyz)


def read_mapping(path: Path, purpose: str) -> dict[str, Any]:
    """A YAML file whose top level is a mapping; raises InputError naming file, purpose and YAML line."""
    loaded = read_yaml(path, f"{path} is missing: {purpose}")
    if not isinstance(loaded, dict):
        raise InputError(f"{path} has no keys: {purpose}")
    return loaded


def numbers_at(path: Path, mapping: dict[str, Any], key: str, count: tuple[int, ...] | None) -> Array:
    """A flat or nested list under ``key`` as finite numbers (n,), n one of ``count`` (None: any).

    Also takes EuRoC's matrices, ``{cols, rows, data}``. Raises InputError naming file and key.
    """
    if key not in mapping:
        raise InputError(f"{path} lacks the key '{key}' (see docs/dataset.md)")
    value = mapping[key]
    if isinstance(value, dict):
        value = value.get("data")
    try:
        numbers = np.array(list(_flat([] if value is None else value)), dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{path} key '{key}': expected a list of numbers") from None
    if count is not None and len(numbers) not in count:
        expected = " or ".join(str(n) for n in count)
        raise InputError(f"{path} key '{key}': {len(numbers)} numbers, expected {expected}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{path} key '{key}': contains NaN or infinity; give the calibrated values")
    return numbers


def _flat(value: Any) -> Iterator[float]:
    """The numbers of nested lists, in order. Raises TypeError or ValueError for anything else."""
    if isinstance(value, list):
        for inner in value:
            yield from _flat(inner)
    elif isinstance(value, str):
        yield plain_number(value)
    elif isinstance(value, bool):
        raise TypeError("true and false are not numbers")
    else:
        yield float(value)
