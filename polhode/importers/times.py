"""Times of images as people and programs write them: which column of a table, which part of a name, which
unit.

The unit is what the user states (--time-unit), what a header names, or what follows from the numbers: their
size, where they count from 1970, or their intervals. Cameras that record a target take an image every 8 ms to
15 s, so that of two units, a thousand apart, both fit from 8 to 15 ms alone. What several units explain, or
none, is refused.
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
SINCE_1970_S = 6.3e8, 4.1e9
"""From 1990 to 2099"""
LEAST_STEP = 8
"""Whole numbers that differ by less may be numbers of frames"""
LEAST_OF_NAME = 10**8
"""Below it the numbers in names are those of frames, unless the user states their unit"""
RATE_AGREES = 1.25
"""Factor between the interval of times and that of a stated rate"""
_TABLE_BYTES = 512 * MIB
_MOST_DIGITS = 25
_NUMBER = re.compile(r"[-+]?(\d{1,25})(\.\d{0,25})?([eE][-+]?\d{1,2})?", re.ASCII)
_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)([-/.:_]?)(\d\d)\2(\d\d)[T _-]?(\d\d)([-:._h]?)(\d\d)[-:._m]?(\d\d)"
    r"(?:[.,](\d{1,9})|[_-]?(\d{3}(?:\d{3}){0,2}))?(?!\d)",
    re.ASCII,
)
_CLOCK = re.compile(r"(\d{1,3}):(\d\d):(\d\d(?:[.,]\d{1,9})?)", re.ASCII)
_NAMES_OF_UNITS: tuple[tuple[TimeUnit, str], ...] = (
    ("ns", r"nano|nsec|(?<![a-z])ns(?![a-z])"),
    ("us", r"micro|usec|(?<![a-z])[uµ]s(?![a-z])"),
    ("ms", r"milli|msec|(?<![a-z])ms(?![a-z])|timecode format v[24]"),
    ("s", r"second|(?<![a-z])secs?(?![a-z])|[\[(_]s(?![a-z])"),
)
_TIME_COLUMN = r"time|stamp|(?<![a-z])t(?![a-z])|sec|date|clock"


@dataclass(frozen=True)
class Times:
    """Times of images."""

    stamps_ns: Ints
    """(n,)"""
    origin: str
    """What they were written in, and how that is known: "milliseconds, by their intervals" """


def read_times(path: Path, unit: TimeUnit | None = None, rate_hz: float | None = None) -> Times:
    """The times of a table, one row an image, in columns separated by commas or blanks.

    unit: as the user states it; rate_hz: frames a second, which the times must agree with. Raises InputError
    for what is no time, does not increase, or has no unit that is plain.
    """
    header, rows = _rows(path)
    columns = _columns(path, rows)
    names = _header_fields(header, len(rows[0][1]))
    chosen = _time_column(names, columns)
    if chosen is None:
        number, fields = next(row for row in rows if _value(row[1][0]) is None)
        raise InputError(
            f"{path} line {number}: {fields[0][:40]!r} is no time; give numbers, whose unit a header or "
            "--time-unit names, or dates"
        )
    named = names[chosen[0]] if names else header
    by_header = None if len(chosen) > 1 else _unit_in(named)
    values = [value for value, _ in columns[chosen[0]]]
    if len(chosen) > 1:
        values = [a + b / 10**9 for a, (b, _) in zip(values, columns[chosen[1]], strict=True)]
        by_header = "s"
    is_date = all(kind == "date" for _, kind in columns[chosen[0]])
    found = _in_ns(str(path), values, unit, by_header, rate_hz, is_date)
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
    dates = [_date(name) for name in names]
    known = [date for date in dates if date is not None]
    if len(known) == len(names):
        return _in_ns(str(folder), known, unit, None, rate_hz, is_date=True)
    columns = [column for column in _numbers_of(names) if len({*column}) > 1 or len(names) == 1]
    if len(columns) == 2 and _are_parts(columns[0], columns[1]):
        digits = len(str(max(columns[1])))
        parts = zip(columns[0], columns[1], strict=True)
        values = [a + b / 10 ** (6 if digits <= 6 else 9) for a, b in parts]
        return _in_ns(str(folder), values, unit, "s", rate_hz)
    if unit is None:
        columns = [each for each in columns if max(map(abs, each)) >= LEAST_OF_NAME and not _counts(each)]
    elif len(columns) > 1:
        columns = [each for each in columns if not _counts(each)]
    if len(columns) != 1:
        return None
    return _in_ns(str(folder), columns[0], unit, None, rate_hz)


def numbers_of_names(names: Sequence[str]) -> list[int] | None:
    """The number (n,) of each file by its name, that which varies; None: some have none."""
    columns = [
        column
        for column in _numbers_of(names)
        if all(value.denominator == 1 and value < 10**9 for value in column)
    ]
    varying = [column for column in columns if len({*column}) == len(names)] or columns
    return [int(value) for value in varying[-1]] if varying else None


def require_increasing(
    source: Path | str, stamps_ns: "Ints | np.ndarray[tuple[int], np.dtype[np.object_]]"
) -> None:
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
        # a blank within a date does not end a column
        fields = re.split(r"\s*[,;]\s*|\s+", re.sub(r"(\d\d) (\d\d:\d\d)", r"\1T\2", text))
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


def _date(text: str) -> Fraction | None:
    """Seconds since 1970 of the date and time of day in a text; a time zone is not looked at."""
    if (found := _DATE.search(text)) is None:
        return None
    year, month, day, hour, minute, second = (int(found[k]) for k in (1, 3, 4, 5, 7, 8))
    if not (1 <= month <= 12 and hour < 24 and minute < 60 and second < 61):
        return None
    if not (year >= 1990 and 1 <= day <= calendar.monthrange(year, month)[1]):
        return None
    part = found[9] or found[10] or "0"
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


def _time_column(names: Sequence[str], columns: dict[int, list[tuple[Fraction, str]]]) -> list[int] | None:
    """The column of the times, or those of whole seconds and of nanoseconds; None: there is none."""
    if not columns:
        return None
    values = {index: [value for value, _ in column] for index, column in columns.items()}
    for index in columns:
        after = index + 1
        if after in columns and _are_parts(values[index], values[after]):
            return [index, after]
    named = [k for k in columns if names and re.search(_TIME_COLUMN, names[k].lower())]
    counted = [k for k in columns if k not in named and _counts(values[k])]
    left = named or [k for k in columns if k not in counted] or list(columns)
    return left[:1]


def _are_parts(seconds: Sequence[Fraction], parts: Sequence[Fraction]) -> bool:
    """Whether two columns are whole seconds since 1970 and the rest, in nanoseconds or microseconds."""
    if any(value.denominator != 1 for value in (*seconds, *parts)):
        return False
    if any(not _is_within(float(value) * 1e9, SINCE_1970_S) for value in seconds):
        return False
    return all(0 <= value < 10**9 for value in parts) and max(parts) >= 1000


def _counts(values: Sequence[Fraction]) -> bool:
    """Whether values count images: whole numbers, each one more than the one before."""
    ordered = sorted(values)
    return all(value.denominator == 1 for value in ordered) and all(b - a == 1 for a, b in pairwise(ordered))


def _numbers_of(names: Sequence[str]) -> list[list[Fraction]]:
    """The numbers in names, by their place; empty: the names have different numbers of them."""
    found = [re.findall(r"\d+(?:\.\d+)?", name, re.ASCII) for name in names]
    if len({len(each) for each in found}) != 1 or any(
        len(word) > _MOST_DIGITS for word in chain.from_iterable(found)
    ):
        return []
    return [[Fraction(word) for word in column] for column in zip(*found, strict=True)]


def _unit_in(text: str) -> TimeUnit | None:
    """The unit that a header names."""
    return next((unit for unit, pattern in _NAMES_OF_UNITS if re.search(pattern, text.lower())), None)
