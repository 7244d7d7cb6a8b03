"""Times of images as people and programs write them: which column of a table, which part of a name, which
unit.

The unit is what the user states (--time-unit), what a header names, or what follows from the numbers: their
size, where they count from 1970 (or ticks of Windows and .NET), or their intervals. Cameras that record a
target take an image every 8 ms to 15 s, so that of two units, a thousand apart, both fit from 8 to 15 ms
alone. What several units explain, or none, is refused; so is a column that may or may not be the times.
"""

import calendar
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from polhode.files.foreign_files import MIB, MissingFile, read_text
from polhode.files.images import SUFFIXES
from polhode.files.tables import MAX_STAMP_NS
from polhode.geometry.lie import Ints
from polhode.records.pairing import time_in_words
from polhode.runtime.errors import InputError

TimeUnit = Literal["ns", "us", "ms", "s"]
UNITS: tuple[TimeUnit, ...] = get_args(TimeUnit)
IN_NS: dict[TimeUnit, int] = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
WORDS: dict[TimeUnit, str] = {
    "ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds", "s": "seconds",
}  # fmt: skip
USUAL_S = 0.008, 15.0
"""Intervals between the images of a camera that records a target"""
PLAUSIBLE_S = 1e-3, 3600.0
"""Intervals beyond which a unit has to be stated"""
SINCE_1970_S = 9.46e8, 4.1e9
"""From 2000 to 2099"""
TICKS_NS = 100
TICKS_AT_1970 = 621_355_968_000_000_000, 116_444_736_000_000_000
"""Of .NET since the year 1, of Windows since 1601"""
LEAST_STEP = 8
"""Whole numbers that differ by less may be numbers of frames"""
LEAST_OF_NAME = 10**9
"""Below it the numbers in names are those of frames, unless the user states their unit"""
RATE_AGREES = 1.25
"""Factor between the interval of times and that of a stated rate"""
_TABLE_BYTES = 512 * MIB
_MOST_DIGITS = 25
_NUMBER = re.compile(r"[-+]?(\d{1,25})(\.\d{0,25})?([eE][-+]?\d{1,2})?", re.ASCII)
_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)([-/.:_]?)(\d\d)\2(\d\d)[T _-]?(\d\d)([-:._h]?)(\d\d)[-:._m]?(\d\d)s?"
    r"(?:[.,:](\d{1,9})(?!\d)|[_-]?(\d{1,12})(?!\d))?",
    re.ASCII,
)
_FRACTIONS = (3, 6, 7, 9)
"""Digits of a fraction of a second without a point"""
_CLOCK = re.compile(r"(\d{1,3}):(\d\d):(\d\d(?:[.,]\d{1,9})?)", re.ASCII)
_NAMES_OF_UNITS: tuple[tuple[TimeUnit, str], ...] = (
    ("ns", r"nano|nsec|(?<![a-z])ns(?![a-z])"),
    ("us", r"micro|usec|(?<![a-z])[uµ]s(?![a-z])"),
    ("ms", r"milli|msec|(?<![a-z])ms(?![a-z])|timecode format v[24]"),
    ("s", r"second|(?<![a-z])secs?(?![a-z])|[\[(_]s(?![a-z])"),
)
_OTHER_UNIT = r"\d\s*[nuµm]?s(?![a-z])|tick|(?<![a-z])(min|minutes?|h|hrs?|hours?|days?)(?![a-z])"
_STAMP_COLUMN = r"stamp"
_TIME_COLUMN = (
    r"time|(?<![a-z])t(?![a-z])|sec|date|clock|second|(?<![a-z])[nuµm]s(?![a-z])|(?<![a-z])epoch(?![a-z])"
)
_NO_TIME_COLUMN = r"expos|shutter|gain|integration|delay|laten|duration|delta|interval|(?<![a-z])dt(?![a-z])"


@dataclass(frozen=True)
class Times:
    """Times of images."""

    stamps_ns: Ints
    """(n,)"""
    origin: str
    """What they were written in, and how that is known: "milliseconds, by their intervals" """


def read_times(
    path: Path,
    unit: TimeUnit | None = None,
    rate_hz: float | None = None,
    files: Sequence[str] | None = None,
) -> Times:
    """The times of a table, one row an image, in columns separated by commas or blanks.

    unit: as the user states it; rate_hz: frames a second, which the times must agree with; files: names of
    the images, by which rows that name files are ordered. Raises InputError for what is no time, does not
    increase, has no unit that is plain, or names other files.
    """
    header, rows = _rows(path)
    rows, is_by_name = _by_name(path, rows, files)
    columns = _columns(path, rows)
    names = _header_fields(header, len(rows[0][1]))
    chosen = _time_column(path, names, columns)
    if chosen is None:
        number, fields = next(row for row in rows if _value(row[1][0]) is None)
        raise InputError(
            f"{path} line {number}: {fields[0][:40]!r} is no time; give numbers, whose unit a header or "
            "--time-unit names, or dates"
        )
    named = names[chosen[0]] if names else header
    values = [value for value, _ in columns[chosen[0]]]
    by_header: TimeUnit | None
    if len(chosen) > 1:
        part = unit_in(names[chosen[1]]) if names else None
        values = [
            a + b * IN_NS[part or "ns"] / 10**9 for a, (b, _) in zip(values, columns[chosen[1]], strict=True)
        ]
        by_header = "s"
    else:
        if unit is None and re.search(_OTHER_UNIT, named.lower()):
            raise InputError(
                f"{path}: the unit of {' '.join(named.split())[:60]!r} is not known; convert the times, or "
                "state --time-unit ns, us, ms or s"
            )
        by_header = unit_in(named)
    is_date = all(kind == "date" for _, kind in columns[chosen[0]])
    found = _in_ns(str(path), values, unit, by_header, rate_hz, is_date)
    if not is_by_name:
        require_increasing(path, found.stamps_ns)
    return found


def times_of_names(
    folder: Path, names: Sequence[str], unit: TimeUnit | None = None, rate_hz: float | None = None
) -> Times | None:
    """The times (n,) that names of files state, in any order; None: they state none, or may be numbers of
    frames.

    unit, rate_hz: as ``read_times`` takes them. Raises InputError for times without a plain unit, or that
    contradict the rate.
    """
    found = [_DATE.search(name) for name in names]
    dates = [_date(name) for name in names]
    known = [date for date in dates if date is not None]
    if len(known) == len(names):
        rest = [each[10] for each in found if each is not None and each[10] is not None]
        if rest and not _is_fraction(folder, names, rest):
            known = [Fraction(int(date)) for date in known]
        # the date of a session is that of no image
        if len({*known}) < len(names):
            return None
        return _in_ns(str(folder), known, unit, None, rate_hz, is_date=True)
    words = [column for column in _numbers_of(names) if len({*column}) > 1 or len(names) == 1]
    columns = [[Fraction(word) for word in column] for column in words]
    if len(columns) == 2 and _since_1970(columns[0]) and not _counts(columns[1]):
        widths = {len(word) for word in words[1]}
        digits = widths.pop() if len(widths) == 1 else 9
        if max(columns[1]) < 10**digits and digits in _FRACTIONS:
            values = [a + b / 10**digits for a, b in zip(columns[0], columns[1], strict=True)]
            return _in_ns(str(folder), values, unit, "s", rate_hz)
    if unit is None:
        columns = [each for each in columns if max(map(abs, each)) >= LEAST_OF_NAME and not _counts(each)]
    elif len(columns) > 1:
        columns = [each for each in columns if not _counts(each)]
    if len(columns) != 1:
        return None
    return _in_ns(str(folder), columns[0], unit, None, rate_hz)


def _is_fraction(folder: Path, names: Sequence[str], rest: Sequence[str]) -> bool:
    """Whether the digits behind dates are fractions of a second, not numbers of images. Raises InputError."""
    widths, has_all = {len(word) for word in rest}, len(rest) == len(names)
    if has_all and _counts([Fraction(word) for word in rest]):
        return False
    if has_all and len(widths) == 1 and widths <= {*_FRACTIONS}:
        return True
    if len({*rest}) > 1:
        raise InputError(
            f"{folder}: the {rest[0]!r} behind the date of {names[0]} may be a fraction of a second or a "
            "number; give --stamps FILE"
        )
    return False


def numbers_of_names(names: Sequence[str]) -> list[int] | None:
    """The number (n,) of each file by its name, that which varies; None: some have none, or a clock."""
    columns = [
        [int(word) for word in column]
        for column in _numbers_of(names)
        if all(word.isdigit() and len(word) <= 10 for word in column)
    ]
    varying = [column for column in columns if len({*column}) == len(names)] or columns
    if not varying:
        return None
    chosen = varying[-1]
    steps = {b - a for a, b in pairwise(sorted(chosen))}
    clock = all(10_000 <= n < 240_000 and n % 100 < 60 and n // 100 % 100 < 60 for n in chosen)
    # hours, minutes and seconds count no images
    return None if clock and 1 not in steps else chosen


def require_increasing(source: Path | str, stamps_ns: Ints) -> None:
    """Raise InputError unless the timestamps increase and are within 146 years of 0."""
    for before, after in pairwise(stamps_ns):
        if after == before:
            raise InputError(
                f"{source}: two images have the time {before} ns: give finer times, or --rate-hz without them"
            )
        if after < before:
            raise InputError(
                f"{source}: timestamp {after} ns does not come after {before} ns; sort the images by time"
            )
    if len(stamps_ns) and max(abs(int(stamps_ns[0])), abs(int(stamps_ns[-1]))) > MAX_STAMP_NS:
        raise InputError(f"{source}: timestamps beyond 146 years; state their unit with --time-unit")


def require_plausible(source: Path | str, stamps_ns: Ints, advice: str) -> None:
    """Raise InputError for intervals that no camera has; ``advice`` ends the line."""
    if len(stamps_ns) > 1 and not _is_within(usual := float(np.median(np.diff(stamps_ns))), PLAUSIBLE_S):
        raise InputError(
            f"{source}: images {time_in_words(usual)} apart, where 1 ms to 1 h are plausible; {advice}"
        )


def _in_ns(
    source: str,
    values: Sequence[Fraction],
    stated: TimeUnit | None,
    by_header: TimeUnit | None,
    rate_hz: float | None,
    is_date: bool = False,
) -> Times:
    """Values in their unit as nanoseconds. Raises InputError where that is not plain."""
    ordered = sorted(values)
    if stated is by_header is None and not is_date:
        for at_1970 in TICKS_AT_1970:
            since = [(value - at_1970) * TICKS_NS for value in ordered]
            if all(_is_within(float(each), SINCE_1970_S) for each in (since[0], since[-1])):
                values = [(value - at_1970) * TICKS_NS for value in values]
                return Times(np.array([int(each) for each in values], dtype=np.int64), "ticks of 100 ns")
    if is_date:
        unit: TimeUnit = "s"
        origin = "dates"
    elif stated is not None:
        unit, origin = stated, f"{WORDS[stated]} (--time-unit)"
    elif by_header is not None:
        unit, origin = by_header, f"{WORDS[by_header]}, as they are named"
    else:
        unit, how = _unit_of(source, ordered, rate_hz)
        origin = f"{WORDS[unit]}, by {how}"
    whole = [round(value * IN_NS[unit]) for value in values]
    if max(map(abs, whole)) > MAX_STAMP_NS:
        raise InputError(f"{source}: timestamps beyond 146 years; state their unit with --time-unit")
    stamps_ns = np.array(whole, dtype=np.int64)
    in_order = np.sort(stamps_ns)
    if stated is None and (in_order[1:] > in_order[:-1]).all():
        advice = "if that is right, state the unit: --time-unit ns, us, ms or s"
        require_plausible(f"{source} (times in {origin})", in_order, advice)
    if rate_hz is not None and len(values) > 1:
        usual_s = 1e-9 * float(np.median(np.diff(in_order)))
        if not 1.0 / RATE_AGREES < usual_s * rate_hz < RATE_AGREES:
            raise InputError(
                f"{source}: images {usual_s:.4g} s apart (times in {origin}), but --rate-hz {rate_hz:g} says "
                f"{1.0 / rate_hz:.4g} s; leave --rate-hz out, or state the unit of the times: --time-unit"
            )
    return Times(stamps_ns, origin)


def _unit_of(source: str, ordered: Sequence[Fraction], rate_hz: float | None) -> tuple[TimeUnit, str]:
    """The unit of sorted values, and how it is known. Raises InputError: several fit, or none."""
    middle = float(ordered[len(ordered) // 2])
    steps = sorted(float(b - a) for a, b in pairwise(ordered))
    step = (steps[len(steps) // 2] or (float(ordered[-1] - ordered[0]) / len(steps))) if steps else 0.0
    steps_ns = {unit: step * IN_NS[unit] for unit in UNITS}
    for unit in UNITS:
        since_1970 = _is_within(middle * IN_NS[unit], SINCE_1970_S)
        if since_1970 and (not step or _is_within(steps_ns[unit], (0.0, PLAUSIBLE_S[1]))):
            return unit, "their size, since 1970"
    if not step:
        return "ns", "default"
    if rate_hz is not None:
        fits = [
            unit
            for unit in UNITS
            if 1.0 / RATE_AGREES < 1e-9 * steps_ns[unit] * rate_hz < RATE_AGREES
        ]  # fmt: skip
        if fits:
            return fits[0], "--rate-hz"
    usual = [unit for unit in UNITS if _is_within(steps_ns[unit], USUAL_S)]
    if step < LEAST_STEP and all(value.denominator == 1 for value in ordered):
        shown = ", ".join(str(value) for value in ordered[:3])
        raise InputError(
            f"{source}: {shown}, ... are numbers of frames, or whole units of time; give --rate-hz without "
            "--stamps, or --time-unit"
        )
    if len(usual) == 1:
        return usual[0], "their intervals"
    if usual:
        choices = " or ".join(f"{unit} ({time_in_words(steps_ns[unit])} apart)" for unit in usual)
        raise InputError(f"{source}: times that are {step:g} apart: state their unit, --time-unit {choices}")
    raise InputError(
        f"{source}: times that are {step:g} apart, which are plausible intervals in no unit; state it "
        "nevertheless with --time-unit ns, us, ms or s, or correct the times"
    )


def _is_within(time_ns: float, limits_s: tuple[float, float]) -> bool:
    return limits_s[0] <= 1e-9 * time_ns <= limits_s[1]


def _rows(path: Path) -> tuple[str, list[tuple[int, list[str]]]]:
    """Header (lines above the first row, without #), and the rows as line number and fields."""
    try:
        lines = read_text(path, _TABLE_BYTES, "a table").lstrip("\ufeff").splitlines()
    except MissingFile:
        raise InputError(f"--stamps {path}: no such file; give a table with one row an image") from None
    header: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%":
            header += [] if rows else [text.lstrip("#% ")]
            continue
        # no blank or comma within a date, or between date and clock, ends a column
        text = re.sub(r"(\d{4}-\d\d-\d\d)[\s,;]+(\d\d:\d\d)", r"\1T\2", text)
        text = re.sub(r"(\d\d:\d\d:\d\d),(\d{3})(?!\d)", r"\1.\2", text)
        fields = re.split(r"\s*[,;]\s*|\s+", text)
        if not rows and all(_value(field) is None for field in fields):
            if text[0].isdigit():
                rows.append((number, fields))
            else:
                header.append(text)
            continue
        rows.append((number, fields))
    if not rows:
        raise InputError(f"{path} is empty: it must have one row an image")
    return "\n".join(header), rows


def _value(text: str) -> tuple[Fraction, str] | None:
    """A number as it is, a date and a clock in seconds; "whole", "decimal" or "date"; None: no time."""
    text = text.strip("\"'")
    if found := _NUMBER.fullmatch(text):
        is_date = found[2] is None and found[3] is None and len(found[1]) in (14, 17)
        if is_date and (date := _date(text)) is not None:
            return date, "date"
        return Fraction(text), "whole" if found[2] is None and found[3] is None else "decimal"
    if clock := _CLOCK.fullmatch(text):
        return 3600 * int(clock[1]) + 60 * int(clock[2]) + Fraction(clock[3].replace(",", ".")), "date"
    date = _date(text)
    return None if date is None else (date, "date")


def _by_name(
    path: Path, rows: list[tuple[int, list[str]]], files: Sequence[str] | None
) -> tuple[list[tuple[int, list[str]]], bool]:
    """The rows in the order of the images whose names they have, and whether they have any."""
    for column in range(min(len(fields) for _, fields in rows) if files else 0):
        named = [fields[column].replace("\\", "/").rpartition("/")[2].strip("\"'") for _, fields in rows]
        if not all(name.lower().endswith(SUFFIXES) for name in named):
            continue
        row_of = dict(zip(named, rows, strict=True))
        if row_of.keys().isdisjoint(files or ()):
            # copies by other names, in the same order
            return rows, False
        lost = next((name for name in files or () if name not in row_of), None)
        if lost is not None:
            raise InputError(
                f"{path}: names {named[0]} and others, but not {lost}; give the table of these images"
            )
        return [row_of[name] for name in files or ()], True
    return rows, False


def _date(text: str) -> Fraction | None:
    """Seconds since 1970 of the date and time of day in a text; a time zone is not looked at."""
    if (found := _DATE.search(text)) is None:
        return None
    year, month, day, hour, minute, second = (int(found[k]) for k in (1, 3, 4, 5, 7, 8))
    if not (1 <= month <= 12 and hour < 24 and minute < 60 and second < 61):
        return None
    if not (year >= 1990 and 1 <= day <= calendar.monthrange(year, month)[1]):
        return None
    part = found[9] or (found[10] if found[10] and len(found[10]) in _FRACTIONS else None) or "0"
    whole = calendar.timegm((year, month, day, hour, minute, second))
    return whole + Fraction(int(part), 10 ** len(part))


def _columns(path: Path, rows: Sequence[tuple[int, list[str]]]) -> dict[int, list[tuple[Fraction, str]]]:
    """The columns whose every row is a time, by their number. Raises InputError for a row that ends early."""
    count = len(rows[0][1])
    for number, fields in rows:
        if len(fields) < min(count, 2):
            raise InputError(f"{path} line {number}: fewer columns than the rows before; correct it")
    columns: dict[int, list[tuple[Fraction, str]]] = {}
    for index in range(min(len(fields) for _, fields in rows)):
        found = [_value(fields[index]) for _, fields in rows]
        whole = [each for each in found if each is not None]
        if len(whole) == len(rows):
            columns[index] = whole
        elif index == 0 and len(whole) > 0.5 * len(rows):
            number, fields = rows[found.index(None)]
            raise InputError(f"{path} line {number}: {fields[0][:40]!r} is no time; correct the row")
    return columns


def _header_fields(header: str, count: int) -> list[str]:
    """Names of the columns by the last line of the header that has as many; empty: there is none."""
    for line in reversed(header.splitlines()):
        for fields in (re.split(r"\s*[,;]\s*", line), line.split()):
            if len(fields) == count and any(re.search(_TIME_COLUMN, each.lower()) for each in fields):
                return fields
    return []


def _time_column(
    path: Path, names: Sequence[str], columns: dict[int, list[tuple[Fraction, str]]]
) -> list[int] | None:
    """The column of the times, or those of seconds and of the rest; None: there is none.

    Raises InputError where two columns may be the times.
    """
    if not columns:
        return None
    values = {index: [value for value, _ in column] for index, column in columns.items()}
    for first in columns:
        after = first + 1
        if after in columns and _are_parts(names[first : after + 1], values[first], values[after]):
            return [first, after]
    if names:
        lower = [name.lower() for name in names]
        usable = [k for k in columns if not re.search(_NO_TIME_COLUMN, lower[k])]
        for pattern in (_STAMP_COLUMN, _TIME_COLUMN):
            if named := [k for k in usable if re.search(pattern, lower[k])]:
                return named[:1]
    left = [k for k in columns if not _counts(values[k])] or list(columns)
    plain = [k for k in left if any(kind == "date" for _, kind in columns[k]) or _since_1970(values[k])]
    if plain:
        return plain[:1]
    whole = not names and len(left) < len(columns) and len(left) == 1
    if whole and 10**6 <= max(values[left[0]]) < 10**9:
        # numbers and nanoseconds, or seconds and nanoseconds
        raise InputError(
            f"{path}: two columns may be the times; name them in a header: sec,nanosec or frame,ns"
        )
    rising = [k for k in left if all(a < b for a, b in pairwise(values[k]))] or left
    fine = [k for k in rising if any(value.denominator != 1 for value in values[k])]
    if not names and len(rising) > 1 and len(fine) != 1 and rising[0] not in fine:
        raise InputError(
            f"{path}: two columns may be the times; name them in a header, the times as timestamp"
        )
    return fine[:1] if fine and rising[0] not in fine else rising[:1]


def _since_1970(values: Sequence[Fraction]) -> bool:
    """Whether values are seconds, or parts of one, since 1970."""
    return any(
        all(_is_within(float(value) * IN_NS[unit], SINCE_1970_S) for value in (min(values), max(values)))
        for unit in UNITS
    )


def _are_parts(names: Sequence[str], seconds: Sequence[Fraction], parts: Sequence[Fraction]) -> bool:
    """Whether two columns are whole seconds and the rest, by their names, or where they count from 1970."""
    if any(value.denominator != 1 for value in (*seconds, *parts)):
        return False
    if min(parts) < 0 or max(parts) >= 10**9:
        return False
    if names:
        first, second = (name.lower() for name in names)
        return unit_in(first) == "s" and unit_in(second) in ("ns", "us", "ms")
    return all(_is_within(float(value) * 1e9, SINCE_1970_S) for value in seconds) and max(parts) >= 10**5


def _counts(values: Sequence[Fraction]) -> bool:
    """Whether values count images: whole numbers, each one more than the one before."""
    ordered = sorted(values)
    return all(value.denominator == 1 for value in ordered) and all(b - a == 1 for a, b in pairwise(ordered))


def _numbers_of(names: Sequence[str]) -> list[list[str]]:
    """The numbers in names, by their place; empty: the names have different numbers of them."""
    found = [re.findall(r"\d+(?:\.\d+)?", name, re.ASCII) for name in names]
    if len({len(each) for each in found}) != 1 or any(
        len(word) > _MOST_DIGITS for word in chain.from_iterable(found)
    ):
        return []
    return [list(column) for column in zip(*found, strict=True)]


def unit_in(text: str) -> TimeUnit | None:
    """The unit that a header names."""
    return next((unit for unit, pattern in _NAMES_OF_UNITS if re.search(pattern, text.lower())), None)
