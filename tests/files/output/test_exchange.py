"""Folders change places; what is not ours goes along; nothing is removed but what is ours by name."""

import os
import shutil
from pathlib import Path

import pytest

import polhode.files.output.exchange as exchange_module
from polhode.files.output.exchange import carry, empty, exchange, foreign, move, remove


def ours(name: str) -> bool:
    return name in ("a.csv", "sub/b.csv")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two files of ours; of the user: files, a link to elsewhere, a pipe, an empty folder."""
    folder = tmp_path / "old"
    (folder / "sub").mkdir(parents=True)
    (folder / "empty").mkdir()
    for name in ("a.csv", "sub/b.csv", "notes.txt", "sub/notes.txt"):
        (folder / name).write_text(f"old {name}")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.csv").write_text("theirs")
    (folder / "link").symlink_to(tmp_path / "elsewhere")
    os.mkfifo(folder / "pipe")
    return folder


FOREIGN = ["empty", "link", "notes.txt", "pipe", "sub/notes.txt"]


def test_what_is_not_ours_is_named_also_our_name_on_a_link_or_a_folder(folder: Path, tmp_path: Path) -> None:
    assert foreign(folder, ours) == FOREIGN
    other = tmp_path / "other"
    (other / "sub" / "b.csv").mkdir(parents=True)
    (other / "a.csv").symlink_to(folder)
    assert foreign(other, ours) == ["a.csv", "sub/b.csv"]


def test_only_what_is_ours_is_removed_and_links_are_not_followed(folder: Path, tmp_path: Path) -> None:
    assert remove(folder, ours) == ["link", "notes.txt", "pipe", "sub/notes.txt"]
    assert sorted(path.name for path in folder.iterdir()) == ["link", "notes.txt", "pipe", "sub"]
    assert (tmp_path / "elsewhere" / "a.csv").read_text() == "theirs"


@pytest.mark.parametrize("can_link", [True, False])
def test_what_is_not_ours_goes_along_as_links_or_copies(
    folder: Path, tmp_path: Path, can_link: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "sub").chmod(0o700)
    new = tmp_path / "new"
    new.mkdir()
    if not can_link:

        def refuse(*_: object, **__: object) -> None:
            raise OSError(1, "Operation not permitted")

        monkeypatch.setattr(os, "link", refuse)
        (folder / "pipe").unlink()
    names = foreign(folder, ours)
    carry(names, folder, new)
    assert foreign(new, ours) == names
    assert (new / "sub" / "notes.txt").read_text() == "old sub/notes.txt"
    assert (new / "sub").stat().st_mode == (folder / "sub").stat().st_mode
    assert (new / "link").readlink() == tmp_path / "elsewhere"
    # the old folder can now be removed: what is not ours has a twin
    assert empty(folder, ours, new) == []


def test_another_file_of_the_same_name_is_no_twin_and_never_replaced(folder: Path, tmp_path: Path) -> None:
    twin = tmp_path / "twin"
    shutil.copytree(folder, twin, symlinks=True, ignore=shutil.ignore_patterns("pipe"))
    (twin / "notes.txt").write_text("another one")
    with pytest.raises(FileExistsError):
        carry(["notes.txt"], folder, twin)
    assert (twin / "notes.txt").read_text() == "another one"
    assert empty(folder, ours, twin) == ["notes.txt", "pipe"]


@pytest.mark.parametrize("in_one_step", [True, False])
def test_two_folders_change_places(
    folder: Path, tmp_path: Path, in_one_step: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not in_one_step:
        monkeypatch.setattr(exchange_module, "_renameat2", lambda *_: False)
    new = tmp_path / ".old.partial"
    new.mkdir()
    (new / "a.csv").write_text("new")
    aside = exchange(new, folder)
    assert (folder / "a.csv").read_text() == "new"
    assert (aside / "a.csv").read_text() == "old a.csv" and aside.name.startswith(".old.")


def test_the_old_folder_is_back_when_the_new_one_cannot_take_its_place(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange_module, "_renameat2", lambda *_: False)
    with pytest.raises(FileNotFoundError):
        exchange(tmp_path / "missing", folder)
    assert (folder / "a.csv").read_text() == "old a.csv"


def test_what_came_since_is_moved_unless_the_name_is_taken(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    (place / "notes.txt").write_text("new")
    move(["notes.txt", "sub/notes.txt"], folder, place)
    assert (place / "sub" / "notes.txt").read_text() == "old sub/notes.txt"
    assert (place / "notes.txt").read_text() == "new" and (folder / "notes.txt").is_file()
