"""A mark tells which files of a folder are ours; a mark that lies removes nothing else."""

import json
from pathlib import Path

import pytest

from polhode.files.output.marked_folder import MARK, SCHEMA, marked_place, read_mark, write_files
from polhode.runtime.errors import InputError

NAMES = ("a.csv", "b.png")


def is_name(name: str) -> bool:
    return name in NAMES


def write(folder: Path, **files: str) -> None:
    place = marked_place(folder, "plan", is_name)
    contents = {name.replace("_", "."): text.encode() for name, text in files.items()}
    write_files(place, "plan", contents, is_name)


def mark(folder: Path, content: object) -> None:
    (folder / MARK).write_text(json.dumps(content))


def test_files_of_an_earlier_call_are_replaced_or_removed_and_others_stay(tmp_path: Path) -> None:
    write(tmp_path / "D", a_csv="1", b_png="2")
    (tmp_path / "D" / "notes.txt").write_text("mine")
    write(tmp_path / "D", a_csv="3")
    assert sorted(path.name for path in (tmp_path / "D").iterdir()) == [MARK, "a.csv", "notes.txt"]
    assert (tmp_path / "D" / "a.csv").read_text() == "3"
    assert read_mark(tmp_path / "D") == {"plan": ["a.csv"]}


def test_two_commands_share_a_folder(tmp_path: Path) -> None:
    write(tmp_path / "D", a_csv="1")
    place = marked_place(tmp_path / "D", "observability", lambda name: name == "c.csv")
    write_files(place, "observability", {"c.csv": b"2"}, lambda name: name == "c.csv")
    assert read_mark(place) == {"plan": ["a.csv"], "observability": ["c.csv"]}
    with pytest.raises(InputError, match=r"a.csv was not written by polhode observability"):
        marked_place(place, "observability", is_name)


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        {"schema": "polhode-output/0", "files": {}},
        {"schema": SCHEMA, "files": ["a.csv"]},
        {"schema": SCHEMA, "files": {"plan": 3}},
        {"schema": SCHEMA},
    ],
)
def test_a_mark_of_something_else_is_none(content: object, tmp_path: Path) -> None:
    mark(tmp_path, content)
    assert read_mark(tmp_path) is None
    with pytest.raises(InputError, match="did not write"):
        marked_place(tmp_path, "plan", is_name)


def test_a_mark_that_lies_removes_nothing_but_names_of_the_command(tmp_path: Path) -> None:
    folder, outside = tmp_path / "D", tmp_path / "outside.txt"
    (folder / "sub").mkdir(parents=True)
    outside.write_text("mine")
    for name in ("notes.txt", "sub/a.csv"):
        (folder / name).write_text("mine")
    listed = ["notes.txt", "../outside.txt", str(outside), "sub/a.csv", "", ".", "b.png"]
    mark(folder, {"schema": SCHEMA, "files": {"plan": listed}})
    (folder / "b.png").symlink_to(outside)
    with pytest.raises(InputError, match=r"b.png was not written"):
        write(folder, a_csv="1")
    (folder / "b.png").unlink()
    write(folder, a_csv="1")
    assert outside.read_text() == "mine"
    assert {(folder / name).read_text() for name in ("notes.txt", "sub/a.csv")} == {"mine"}


def test_a_mark_without_end_is_not_read(tmp_path: Path) -> None:
    (tmp_path / MARK).write_text("[" * 2**21)
    assert read_mark(tmp_path) is None
    (tmp_path / MARK).write_text("[" * 2**19)
    assert read_mark(tmp_path) is None
