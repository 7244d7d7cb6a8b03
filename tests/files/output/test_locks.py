"""One process at a time works in a folder; one that it made is gone if nothing came of it."""

from pathlib import Path

import pytest

from polhode.files.output.locks import at_work, locked, occupied
from polhode.runtime.errors import InputError


def test_a_folder_that_is_there_is_locked_and_stays(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    for lock in (at_work, occupied):
        with (
            lock(tmp_path / "mine", tmp_path),
            pytest.raises(InputError, match="another polhode"),
            at_work(tmp_path / "mine", tmp_path),
        ):
            pass
    assert (tmp_path / "mine").is_dir()


def test_a_folder_that_is_missing_is_made_and_stays_if_something_is_in_it(tmp_path: Path) -> None:
    place = tmp_path / "a" / "b"
    with occupied(place, place):
        assert place.is_dir()
        with pytest.raises(InputError, match="another polhode"), occupied(place, place):
            pass
        assert place.is_dir()
    assert list(tmp_path.iterdir()) == []
    with occupied(place, place):
        (place / "one.csv").write_text("1")
    assert (place / "one.csv").read_text() == "1"


def test_a_folder_whose_parents_another_process_removes_meanwhile_is_made_again(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b", tmp_path):
        assert (tmp_path / "a" / "b").is_dir()
