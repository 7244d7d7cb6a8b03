"""Reading the small text tables and YAML files of a dataset, with errors that name file and line."""

from pathlib import Path
from typing import Any

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array, matrix_from_wxyz
from polhode.records import Ints
from polhode.yaml_files import read_yaml

UNIT_TOLERANCE = 1e-2


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows of a CSV file as (line number, stripped fields); skips blanks, ``#`` comments and a header.

    Raises InputError when the file is missing, is not text, or has no rows.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path} is missing: add it (see docs/dataset.md)") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as text: {' '.join(str(error).split())}") from None
    rows = [
        (number, [field.strip() for field in line.split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if rows and rows[0][0] == 1 and any(letter.isalpha() for letter in rows[0][1][0]):
        rows = rows[1:]
    if not rows:
        raise InputError(f"{path} is empty: it must list one row per frame (see docs/dataset.md)")
    return rows


def timestamps_of(path: Path, rows: list[tuple[int, list[str]]]) -> Ints:
    """First column as nanoseconds (n,), strictly increasing; raises InputError naming the line otherwise."""
    stamps: list[int] = []
    for number, fields in rows:
        try:
            stamp = int(fields[0])
        except ValueError:
            message = f"{path} line {number}: timestamp '{fields[0]}' is not a whole number of nanoseconds"
            raise InputError(message) from None
        if not -(2**63) <= stamp < 2**63:
            raise InputError(
                f"{path} line {number}: timestamp {stamp} does not fit 64 bits; give nanoseconds"
            )
        if stamps and stamp <= stamps[-1]:
            wrong = "repeats" if stamp == stamps[-1] else "goes back from"
            message = f"{path} line {number}: timestamp {stamp} {wrong} {stamps[-1]}; sort the rows by time"
            raise InputError(message)
        stamps.append(stamp)
    return np.array(stamps, dtype=np.int64)


def numbers_of(path: Path, rows: list[tuple[int, list[str]]], columns: int) -> Array:
    """Columns 1..columns as finite numbers (n, columns); raises InputError naming the line otherwise."""
    values = np.empty((len(rows), columns))
    for row, (number, fields) in enumerate(rows):
        if len(fields) <= columns:
            message = (
                f"{path} line {number}: {len(fields)} columns, expected {columns + 1} (see docs/dataset.md)"
            )
            raise InputError(message)
        try:
            values[row] = [float(field) for field in fields[1 : columns + 1]]
        except ValueError:
            raise InputError(f"{path} line {number}: not a number in '{','.join(fields)}'") from None
        if not np.isfinite(values[row]).all():
            raise InputError(f"{path} line {number}: NaN or infinity; remove or correct the row")
    return values


def attitudes_of(path: Path, rows: list[tuple[int, list[str]]], q_wxyz: Array, name: str) -> Array:
    """Unit quaternions (n, 4) as rotations (n, 3, 3); raises InputError naming the line of a wrong one."""
    off = abs(np.linalg.norm(q_wxyz, axis=1) - 1.0)
    if off.max() > UNIT_TOLERANCE:
        line = rows[int(off.argmax())][0]
        raise InputError(f"{path} line {line}: {name} (w, x, y, z) is not a unit quaternion")
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
        numbers = np.asarray(value if value is not None else [], dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{path} key '{key}': expected a list of numbers") from None
    if count is not None and len(numbers) not in count:
        expected = " or ".join(str(n) for n in count)
        raise InputError(f"{path} key '{key}': {len(numbers)} numbers, expected {expected}")
    if not np.isfinite(numbers).all():
        raise InputError(f"{path} key '{key}': contains NaN or infinity; give the calibrated values")
    return numbers
