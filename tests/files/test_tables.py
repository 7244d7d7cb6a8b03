"""Tables of timestamps: what a number is, what a row is, and a limit to each."""

from pathlib import Path

import numpy as np
import pytest

from polhode.files import tables
from polhode.files.tables import numbers_at, read_listing, read_table
from polhode.runtime.errors import InputError

NS = 1_600_000_000_000_000_000


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "data.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_any_end_of_line_a_byte_order_mark_comments_and_a_header(tmp_path: Path, end: str, mark: str) -> None:
    path = write(
        tmp_path, mark + end.join(["timestamp,x", "", "# note", f"{NS}, 1.5 ,9", f"{NS + 1},-2e-3,9"])
    )
    table = read_table(path, 1)
    np.testing.assert_array_equal(table.timestamps_ns, [NS, NS + 1])
    np.testing.assert_array_equal(table.values, [[1.5], [-2e-3]])
    np.testing.assert_array_equal(table.lines, [4, 5])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("# nothing\n\n", "is empty"),
        ("1,2", "line 1: 2 columns, expected 3"),
        ("1,2,nan", "line 1: NaN or infinity"),
        ("1,2,3\n2,3,1e400", "line 2: NaN or infinity"),
        ("1,2,1_0", "line 1: not a number in '1,2,1_0'"),
        ("1,2,٣", "line 1: not a number"),
        ("1,2,0x10", "line 1: not a number"),
        ("1,2,", "line 1: not a number"),
        ("1_0,2,3", "line 1: timestamp '1_0' is not a whole number"),
        ("٣,2,3", "line 1: timestamp '٣' is not a whole number"),
        ("1.5,2,3", "is not a whole number of nanoseconds"),
        ("1e9,2,3\n", "is empty"),
        ("\n1e9,2,3\n", "line 2: timestamp '1e9' is not a whole number"),
        (f"{2**64},2,3", "is beyond 146 years"),
        (f"-{2**63},2,3", "is beyond 146 years"),
        ("9" * 5000 + ",2,3", "line 1: longer than 4096 characters"),
        ("9" * 4000 + ",2,3", r"line 1: timestamp '9{57}\.\.\.' is not a whole number"),
        ("2,2,3\n1,2,3", "line 2: timestamp 1 goes back from 2"),
        ("2,2,3\n2,2,3", "line 2: timestamp 2 repeats 2"),
        ('"1","2","3"', "line 1: timestamp '\"1\"' is not a whole number"),
        ("1;2;3", "line 1: timestamp '1;2;3' is not a whole number"),
        ("1,2,3".encode("utf-16"), "not UTF-8 text after line 0; save it as UTF-8"),
        ("1,2,3".encode("utf-16-le"), "line 1: a zero byte"),
        (b"1,2,3\n2,3,\xff4", "not UTF-8 text after line"),
        ("1,2,3\n2,3,\x004", "line 2: a zero byte"),
        ("x" * 10_000_000, "line 1: longer than 4096 characters"),
    ],
    ids=lambda content: repr(content)[:20],
)
def test_a_wrong_row_is_named(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_table(write(tmp_path, content), 2)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_more_rows_than_any_recording_has_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "MAX_ROWS", 10)
    path = write(tmp_path, "".join(f"{k},{k}\n" for k in range(11)))
    for read in (lambda: read_table(path, 1), lambda: read_listing(path)):
        with pytest.raises(InputError, match="line 11: more than 10 rows"):
            read()


def test_a_huge_table_and_a_device_are_refused_unread(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a device: give a regular file"):
        read_listing(Path("/dev/zero"))
    path = tmp_path / "data.csv"
    with path.open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(InputError, match=r"more than the 536\.9 MB that a table may have"):
        read_table(path, 1)


def test_names_default_to_the_timestamp(tmp_path: Path) -> None:
    path = write(tmp_path, "#t,name\n1\n2,\n3,left 3.png\n4,a/ü.png\n")
    assert read_listing(path) == {1: "1.png", 2: "2.png", 3: "left 3.png", 4: "a/ü.png"}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/etc/passwd", "line 2: the name '/etc/passwd' leads out of the dataset"),
        ("../../x.png", "leads out of the dataset"),
        ("a/../../x.png", "leads out of the dataset"),
        ("..\\x.png", "leads out of the dataset"),
        ("C:\\x.png", "leads out of the dataset"),
        ('"2.png"', "has quotes or control characters"),
        ("a\x1b[31m.png", "has quotes or control characters"),
        ("1.png", "line 2: '1.png' is listed twice"),
    ],
)
def test_a_name_is_that_of_one_file_of_the_dataset(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read_listing(write(tmp_path, f"1,1.png\n2,{name}\n"))
    assert message in str(error.value) and error.value.args[0].isprintable()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1, "2_0"], "expected a list of numbers"),
        ([1, True], "expected a list of numbers"),
        ([1, None], "expected a list of numbers"),
        ([1, {}], "expected a list of numbers"),
        ("٣", "expected a list of numbers"),
        (None, "0 numbers, expected 2"),
        ({"rows": 2}, "0 numbers, expected 2"),
        ([[1], [2, 3]], "3 numbers, expected 2"),
        ([1, "nan"], "contains NaN or infinity"),
        ([1, 10**60], None),
        ([[1], "2e5"], None),
    ],
)
def test_numbers_of_a_calibration(value: object, message: str | None) -> None:
    if message is None:
        assert len(numbers_at(Path("sensor.yaml"), {"key": value}, "key", (2,))) == 2
    else:
        with pytest.raises(InputError, match=f"^sensor.yaml key 'key': {message}"):
            numbers_at(Path("sensor.yaml"), {"key": value}, "key", (2,))
