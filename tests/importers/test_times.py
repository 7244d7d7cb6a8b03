"""Times as people write them: the unit is recognized or stated, and what is not plain is refused."""

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polhode.importers.times import (
    IN_NS,
    USUAL_S,
    TimeUnit,
    numbers_of_names,
    read_times,
    times_of_names,
)
from polhode.runtime.errors import InputError

HALF_S = 500_000_000
START_S = 1_705_314_659
"""2024-01-15 10:30:59 UTC"""


def table(folder: Path, rows: Sequence[object], header: str = "") -> Path:
    path = folder / "times.txt"
    path.write_text(header + "".join(f"{row}\n" for row in rows))
    return path


def halves(unit: TimeUnit, start_s: int = 0) -> list[int]:
    return [(start_s * 10**9 + k * HALF_S) // IN_NS[unit] for k in range(6)]


TABLES: dict[str, tuple[Sequence[object], str, str]] = {
    "whole milliseconds": (halves("ms"), "", "milliseconds, by their intervals"),
    "whole microseconds": (halves("us"), "", "microseconds, by their intervals"),
    "whole nanoseconds": (halves("ns"), "", "nanoseconds, by their intervals"),
    "milliseconds since 1970": (halves("ms", START_S), "", "milliseconds, by their size, since 1970"),
    "microseconds since 1970": (halves("us", START_S), "", "microseconds, by their size, since 1970"),
    "nanoseconds since 1970": (halves("ns", START_S), "", "nanoseconds, by their size, since 1970"),
    "seconds with a point": ([f"{k / 2:.3f}" for k in range(6)], "", "seconds, by their intervals"),
    "seconds as powers of ten": ([f"{k / 2:.6e}" for k in range(6)], "", "seconds, by their intervals"),
    "seconds since 1970": (
        [f"{START_S + k / 2:.6f}" for k in range(6)], "", "seconds, by their size, since 1970",
    ),
    "frame and time": (
        [f"{k},{k / 2}" for k in range(6)], "frame,timestamp\n", "seconds, by their intervals",
    ),
    "number and time, without a header": ([f"{k} {500 * k}" for k in range(6)], "", "milliseconds"),
    "time codes of mkvtoolnix": (
        [f"{500 * k}.0" for k in range(6)], "# timecode format v2\n", "milliseconds, as they are named",
    ),
    "a unit in brackets": (halves("us"), "#timestamp [us]\n", "microseconds, as they are named"),
    "a unit at the end of a name": (
        [f"{500 * k};img{k}.png" for k in range(6)], "t_ms;file\n", "milliseconds, as they are named",
    ),
    "dates of KITTI": (
        [f"2024-01-15 10:31:{k // 2:02d}.{(k % 2) * HALF_S:09d}" for k in range(6)],
        "", "dates",
    ),
    "dates of ISO 8601": ([f"2024-01-15T10:31:{k // 2:02d}.{5 * (k % 2)}Z" for k in range(6)], "", "dates"),
    "seconds and nanoseconds": (
        [f"{START_S + k // 2} {(k % 2) * HALF_S}" for k in range(6)], "", "seconds, as they are named",
    ),
    "clock of a film": ([f"00:00:{k // 2:02d}.{5 * (k % 2)}00" for k in range(6)], "", "dates"),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_the_unit_of_a_table_is_recognized(name: str, tmp_path: Path) -> None:
    rows, header, origin = TABLES[name]
    found = read_times(table(tmp_path, rows, header))
    assert np.diff(found.stamps_ns).tolist() == 5 * [HALF_S] and found.origin.startswith(origin)


OTHER_TABLES: dict[str, tuple[str, Callable[[int], str]]] = {
    "ticks of .NET": ("", lambda k: str(638_409_474_590_000_000 + 5_000_000 * k)),
    "seconds and nanoseconds of a simulation": ("sec,nanosec\n", lambda k: f"{k // 2},{(k % 2) * HALF_S}"),
    "an exposure beside": (
        "frame,exposure_time_us,timestamp\n",
        lambda k: f"{k},{5000 + 20_000 * k},{0.5 * k}",
    ),
    "numbers in steps beside": ("frame_id,ms\n", lambda k: f"{20 * k},{500 * k}"),
    "a comma before milliseconds": ("", lambda k: f"2024-01-15 10:31:{k // 2:02d},{500 * (k % 2):03d}"),
    "a colon before them": ("", lambda k: f"2024-01-15 10:31:{k // 2:02d}:{500 * (k % 2):03d}"),
    "date and clock in two columns": (
        "date,time\n",
        lambda k: f"2024-01-15,10:31:{k // 2:02d}.{5 * (k % 2)}",
    ),
}


@pytest.mark.parametrize("name", OTHER_TABLES)
def test_other_tables(name: str, tmp_path: Path) -> None:
    header, row = OTHER_TABLES[name]
    found = read_times(table(tmp_path, [row(k) for k in range(6)], header))
    assert np.diff(found.stamps_ns).tolist() == 5 * [HALF_S]


def test_names_that_only_seem_to_be_times(tmp_path: Path) -> None:
    session = "2024-01-15_10-30-59"
    for name in ("20240115_103059_{:03d}", f"rec_{session}_frame{{:06d}}", "20240115_103059_{:04d}"):
        names = [name.format(k) for k in range(6)]
        assert times_of_names(tmp_path, names) is None and numbers_of_names(names) == list(range(6))
    clock = [f"1031{k:02d}" for k in range(0, 60, 20)]
    assert times_of_names(tmp_path, clock) is None and numbers_of_names(clock) is None
    assert times_of_names(tmp_path, [f"1031{k:02d}000" for k in range(0, 60, 20)]) is None
    with pytest.raises(InputError, match="may be a fraction of a second or a number; give --stamps"):
        times_of_names(tmp_path, [f"20240115_1031{k:02d}_{7 * k % 10}{k}" for k in range(6)])
    milliseconds = times_of_names(tmp_path, [f"{START_S + k // 2}_{500 * (k % 2):03d}" for k in range(6)])
    assert milliseconds is not None and np.diff(milliseconds.stamps_ns).tolist() == 5 * [HALF_S]


NAMES: dict[str, Callable[[int], str]] = {
    "date": lambda k: f"202401151031{k // 2:02d}_{(k % 2) * 500:03d}",
    "date with milliseconds": lambda k: f"20240115_1031{k // 2:02d}_{(k % 2) * 500:03d}",
    "date in words": lambda k: f"cam_2024-01-15_10-31-{k // 2:02d}.{(k % 2) * 5}",
    "nanoseconds of 10 digits": lambda k: str(10**9 + k * HALF_S),
    "nanoseconds of 13 digits": lambda k: str(10**12 + k * HALF_S),
    "nanoseconds since 1970": lambda k: str(START_S * 10**9 + k * HALF_S),
    "milliseconds since 1970": lambda k: f"left_{START_S * 1000 + k * 500}",
    "seconds with a point": lambda k: f"left_{START_S + k // 2}.{(k % 2) * 500000:06d}",
    "seconds and nanoseconds": lambda k: f"{START_S + k // 2}_{(k % 2) * HALF_S:09d}",
    "number, then time": lambda k: f"{k:04d}_{START_S * 10**9 + k * HALF_S}",
}


@pytest.mark.parametrize("name", NAMES)
def test_the_unit_of_names_is_recognized(name: str, tmp_path: Path) -> None:
    found = times_of_names(tmp_path, [NAMES[name](k) for k in range(6)])
    assert found is not None and np.diff(found.stamps_ns).tolist() == 5 * [HALF_S]


def test_numbers_of_frames_are_no_times(tmp_path: Path) -> None:
    for name in ("{:010d}", "{:04d}_cam0", "img{}", "left_{:06d}"):
        names = [name.format(k) for k in range(6)]
        assert times_of_names(tmp_path, names) is None and numbers_of_names(names) == list(range(6))
    # whose unit the user states
    found = times_of_names(tmp_path, [f"{500 * k:06d}" for k in range(6)], "ms")
    assert found is not None and np.diff(found.stamps_ns).tolist() == 5 * [HALF_S]
    assert found.origin == "milliseconds (--time-unit)"


REFUSED: dict[str, tuple[Sequence[object], str, str]] = {
    "numbers or seconds": (range(6), "", "are numbers of frames, or whole units of time; give --rate-hz"),
    "every tenth, or 10 ms, or 10 s": (range(0, 60, 10), "", "--time-unit ms (10 ms apart) or s (10 s "
    "apart)"),
    "a unit in which no camera records": ([k * 10**17 for k in range(6)], "", "plausible intervals in no "
    "unit"),
    "a header that contradicts": (halves("ns", START_S), "timestamp [ms]\n", "beyond 146 years"),
    "a header that is a thousand off": (halves("us"), "time_s\n", "where 1 ms to 1 h are plausible"),
    "an unknown unit": (halves("us"), "time_100ns\n", "the unit of 'time_100ns' is not known"),
    "minutes": ([k / 120 for k in range(6)], "elapsed time (minutes)\n", "is not known; convert the times"),
    "two columns": ([f"{k},{10**8 * k}" for k in range(6)], "", "two columns may be the times"),
    "a word": (["1.5", "2.5", "soon"], "", "line 3: 'soon' is no time"),
    "twice the same": ([START_S, START_S, START_S + 1], "", "two images have the time"),
    "backwards": (["3.5", "2.5", "1.5"], "", "does not come after"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_plain_is_refused(name: str, tmp_path: Path) -> None:
    rows, header, words = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read_times(table(tmp_path, rows, header))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_rate_settles_the_unit_and_contradictions_are_refused(tmp_path: Path) -> None:
    path = table(tmp_path, range(0, 60, 10))
    assert read_times(path, rate_hz=100.0).stamps_ns[1] == 10_000_000
    assert read_times(path, rate_hz=0.1).stamps_ns[1] == 10 * 10**9
    assert read_times(path, "us").stamps_ns[1] == 10_000
    with pytest.raises(InputError, match=r"but --rate-hz 10 says 0\.1 s"):
        read_times(path, "ms", rate_hz=10.0)
    with pytest.raises(InputError, match=r"but --rate-hz 20 says 0\.05 s"):
        times_of_names(tmp_path, [str(START_S * 1000 + 500 * k) for k in range(6)], rate_hz=20.0)


@pytest.fixture(scope="module")
def one_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("times")


@settings(max_examples=60, deadline=None)
@given(
    interval_s=st.floats(16e-3, 7.5),
    start_s=st.integers(10**9, 4 * 10**9),
    unit=st.sampled_from(("ns", "us", "ms")),
    relative=st.booleans(),
)
def test_times_of_usual_cameras_are_never_a_factor_off(
    interval_s: float, start_s: int, unit: TimeUnit, relative: bool, one_folder: Path
) -> None:
    """Relative times, and times since 1970; rounding to the unit is all that is lost."""
    begin_ns = 0 if relative else start_s * 10**9
    stamps_ns = [begin_ns + round(k * interval_s * 1e9) for k in range(5)]
    rows = [stamp // IN_NS[unit] for stamp in stamps_ns]
    found = read_times(table(one_folder, rows)).stamps_ns
    assert np.abs(found - stamps_ns).max() <= IN_NS[unit]


@settings(max_examples=60, deadline=None)
@given(
    step=st.floats(1e-6, 1e6),
    start=st.integers(0, 4 * 10**9),
    unit=st.sampled_from(("ns", "us", "ms", "s")),
)
def test_whatever_is_accepted_unstated_has_intervals_of_a_camera(
    step: float, start: int, unit: TimeUnit, one_folder: Path
) -> None:
    rows = [round((start + k * step) * 1e9 / IN_NS[unit]) for k in range(5)]
    path, words = table(one_folder, rows), []
    found = np.zeros(0, dtype=np.int64)
    try:
        found = read_times(path).stamps_ns
    except InputError as error:
        words = [word for word in ("--time-unit", "--rate-hz", "does not come after") if word in str(error)]
    assert len(found) or words
    if words:
        return
    usual_s = 1e-9 * float(np.median(np.diff(found)))
    since_1970 = found[0] > 6e8 * 1e9
    assert USUAL_S[0] * 0.99 <= usual_s <= USUAL_S[1] * 1.01 or (since_1970 and usual_s <= 3600.0)


def test_a_date_is_that_of_the_calendar(tmp_path: Path) -> None:
    days = ((2, 28, 23, 59, 59), (2, 29, 0, 0, 0), (2, 29, 0, 0, 1))
    found = times_of_names(tmp_path, ["20240228235959", "20240229000000", "20240229000001"])
    assert found is not None
    for stamp, (month, day, hour, minute, second) in zip(found.stamps_ns, days, strict=True):
        moment = datetime.datetime(2024, month, day, hour, minute, second, tzinfo=datetime.UTC)
        assert stamp == round(moment.timestamp()) * 10**9
