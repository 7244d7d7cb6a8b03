"""One process at a time works in a folder; one that it made is gone if nothing came of it."""

from pathlib import Path

import pytest

from polhode.files.output.locks import at_work, locked, occupied
from polhode.runtime.errors import InputError


def test_a_folder_is_locked_and_stays_if_it_was_there_or_has_something_in_it(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    place = tmp_path / "a" / "b"
    for lock, folder in ((at_work, tmp_path / "mine"), (occupied, tmp_path / "mine"), (occupied, place)):
        with lock(folder, tmp_path):
            assert folder.is_dir()
            with pytest.raises(InputError, match="another polhode"), occupied(folder, tmp_path):
                pass
            assert folder.is_dir()
    assert list(tmp_path.iterdir()) == [tmp_path / "mine"]
    with occupied(place, place):
        (place / "one.csv").write_text("1")
    assert (place / "one.csv").read_text() == "1"
    with locked(tmp_path / "c" / "d", tmp_path):
        assert (tmp_path / "c" / "d").is_dir()
