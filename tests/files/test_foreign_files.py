"""Files that others made are opened only when they are regular, small enough and UTF-8."""

import os
import socket
from pathlib import Path

import pytest

from polhode.files.foreign_files import MissingFile, amount, open_regular, read_bytes, read_text
from polhode.runtime.errors import InputError


def test_content_up_to_the_limit_is_read_also_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("there")
    assert read_bytes(tmp_path / "link", 5, "a table") == b"12345"
    with open_regular(tmp_path / "there", 5, "a table") as stream:
        assert stream.read(2) == b"12"


def test_larger_files_are_refused_without_reading_them(tmp_path: Path) -> None:
    path = tmp_path / "huge"
    path.touch()
    os.truncate(path, 2**40)
    with pytest.raises(InputError, match=r"has 1,099\.5 GB, more than the 1 kB that a configuration may"):
        read_bytes(path, 1000, "a configuration")
    # Files of /proc have the size 0.
    with pytest.raises(InputError, match="more than the 10 bytes that a table may have"):
        read_bytes(Path("/proc/self/status"), 10, "a table")
    assert [amount(size) for size in (17, 2048, 3_500_000)] == ["17 bytes", "2 kB", "3.5 MB"]


def test_only_regular_files_are_opened_and_nothing_waits_for_a_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("folder").mkdir()
    kinds = {"/dev/zero": "a device", "/dev/null": "a device", "pipe": "a pipe", "folder": "a folder"}
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("door")
        for name, kind in (*kinds.items(), ("door", "a socket")):
            with pytest.raises(InputError, match=f"{name} is {kind}: give a regular file"):
                read_bytes(Path(name), 100, "a table")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x" * 5000, "File name too long"),
        ("a\0b", "null"),
        ("file/below", "Not a directory"),
        ("circle", "symbolic links"),
        ("nothing", "nothing is missing: give an existing file"),
    ],
)
def test_names_that_no_file_has_are_one_short_line(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(InputError, match=message) as error:
        read_bytes(tmp_path / name, 100, "a table")
    assert len(str(error.value)) < 500
    assert isinstance(error.value, MissingFile) == (name == "nothing")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("seed: 1\n".encode("utf-16"), "is UTF-16 text: save it as UTF-8"),
        ("seed: 1\n".encode("utf-16-le"), "line 1: a zero byte"),
        (b"a\nb\0c", "line 2: a zero byte"),
        (b"a\nb\nc\xff", "line 3: byte 0xff is not UTF-8"),
        ("größe".encode("latin-1"), "line 1: byte 0xf6 is not UTF-8"),
    ],
)
def test_other_encodings_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_text(path, 1000, "a table")
    path.write_bytes("\ufeffgröße\n".encode())
    assert read_text(path, 1000, "a table") == "größe\n", "a byte order mark is no content"
