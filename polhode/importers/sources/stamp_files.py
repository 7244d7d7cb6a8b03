"""Tables of timestamps: one row an image, the first column the time."""

import re
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np

from polhode.files.foreign_files import MIB, MissingFile, read_text
from polhode.files.tables import MAX_STAMP_NS
from polhode.geometry.lie import Ints
from polhode.runtime.errors import InputError

_TABLE_BYTES = 512 * MIB
_NUMBER = re.compile(r"[-+]?\d{1,25}(?:\.\d{0,25})?", re.ASCII)
_UNITS_NS = ((17, 1), (14, 10**3), (12, 10**6))
"""Whole numbers of at least so many digits are nanoseconds, microseconds, milliseconds since 1970."""


def read_stamps(path: Path) -> Ints:
    """(n,) timestamps [ns] of the first column of a table, separated by commas or blanks.

    Whole numbers are nanoseconds; numbers with a point are seconds. Lines that begin with # and a header are
    skipped. Raises InputError for what is no number, or does not increase.
    """
    try:
        lines = read_text(path, _TABLE_BYTES, "a table").splitlines()
    except MissingFile:
        raise InputError(f"--stamps {path}: no such file; give a table with one row an image") from None
    stamps: list[int] = []
    for number, line in enumerate(lines, start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#") or (not stamps and words[0][0].isalpha()):
            continue
        if not _NUMBER.fullmatch(words[0]):
            raise InputError(
                f"{path} line {number}: {words[0][:40]!r} is no time; give ns, or s with a point"
            )
        stamps.append(round(Fraction(words[0]) * 10**9) if "." in words[0] else int(words[0]))
    if not stamps:
        raise InputError(f"{path} is empty: it must have one row an image")
    require_increasing(path, np.array(stamps, dtype=object))
    return np.array(stamps, dtype=np.int64)


def stamp_of_name(stem: str) -> int | None:
    """The time [ns] that a file name is, as nanoseconds, microseconds, milliseconds or seconds with a point
    since 1970; None: it is none."""
    if re.fullmatch(r"\d{9,11}\.\d{1,9}", stem, re.ASCII):
        return round(Fraction(stem) * 10**9)
    if re.fullmatch(r"\d{12,19}", stem, re.ASCII):
        return int(stem) * next(unit for digits, unit in _UNITS_NS if len(stem) >= digits)
    return None


def require_increasing(
    source: Path | str, stamps_ns: "Ints | np.ndarray[tuple[int], np.dtype[np.object_]]"
) -> None:
    """Raise InputError unless the timestamps increase and are within 146 years of 0."""
    for before, after in pairwise(stamps_ns):
        if after <= before:
            raise InputError(
                f"{source}: timestamp {after} ns does not come after {before} ns; sort the images by time"
            )
    if len(stamps_ns) and max(abs(int(stamps_ns[0])), abs(int(stamps_ns[-1]))) > MAX_STAMP_NS:
        raise InputError(f"{source}: timestamps beyond 146 years; give nanoseconds")
