"""Files appear whole or not at all."""

import os
from pathlib import Path

import pytest

from polhode.files.atomic import replaced, write_bytes, write_text
from polhode.runtime.errors import InputError


def write_half(path: Path) -> None:
    with replaced(path) as partial:
        partial.write_text("ne")
        assert path.read_text() == "old"
        raise KeyboardInterrupt


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt):
        write_half(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_new_file_takes_the_place_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.csv"
    write_bytes(path, b"old")
    with replaced(path) as partial:
        # The suffix stays: some writers choose their format by it.
        assert partial.suffix == ".csv" and partial.parent == tmp_path
        partial.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_line_feeds_are_written_as_given_and_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "ω\n")
    assert (tmp_path / "a").read_bytes() == b"\xcf\x89\n"
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="is a device or a pipe"):
        write_text(pipe, "words")
    assert pipe.is_fifo() and len(list(tmp_path.iterdir())) == 2
