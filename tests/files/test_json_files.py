"""JSON of others: valid, unambiguous, and of limited size and depth."""

from pathlib import Path

import pytest

from polhode.files.foreign_files import MissingFile
from polhode.files.json_files import read_json
from polhode.runtime.errors import InputError


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "summary.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_values_are_read(tmp_path: Path) -> None:
    text = '\ufeff{"a": [1, -2.5e3, null, true, "\\u00fc ü"], "b": {}}'
    assert read_json(write(tmp_path, text), "a summary") == {"a": [1, -2500.0, None, True, "ü ü"], "b": {}}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "line 1: not valid JSON"),
        ('{\n"a": 1,}', "line 2: not valid JSON"),
        ('{"a": NaN}', "NaN is no number of JSON; write null"),
        ('{"a": -Infinity}', "-Infinity is no number of JSON"),
        ('{"a": 1e999}', "1e999 is beyond the range of numbers"),
        ('{"a": ' + "9" * 5000 + "}", "a number of 5000 digits; give at most 64"),
        ('{"a": 1, "b": 2, "a": 3}', "key 'a' is given twice"),
        ("[" * 100_000, "nested more than 32 deep"),
        ("[" * 100 + "]" * 100, "nested more than 32 deep"),
        ('{"a": ' * 100_000, "nested more than 32 deep"),
        ('{"a": 1}'.encode("utf-16"), "is UTF-16 text: save it as UTF-8"),
        ('{"a": 1}'.encode("utf-32-le"), "a zero byte|UTF-16"),
        (b'{"a": "\xff"}', "line 1: byte 0xff is not UTF-8"),
        ('{"a": "' + "x" * 5_000_000 + '"}', r"has 5 MB, more than the 4\.2 MB that a summary may have"),
    ],
    ids=lambda content: repr(content)[:16],
)
def test_what_is_wrong_is_one_line(tmp_path: Path, content: str | bytes, message: str) -> None:
    path = write(tmp_path, content)
    with pytest.raises(InputError, match=message) as error:
        read_json(path, "a summary")
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_devices_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a device: give a regular file"):
        read_json(Path("/dev/zero"), "a summary")
    with pytest.raises(MissingFile):
        read_json(tmp_path / "none", "a summary")
