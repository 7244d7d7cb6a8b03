"""A folder takes its place when it is complete; a kill at any moment leaves the old or the new one whole."""

import fcntl
import multiprocessing
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import polhode.files.output.exchange as exchange_module
from polhode.files.output.staged_folder import StagedFolder, staged_folder
from polhode.runtime.errors import InputError

NAMES = ("one.csv", "two.csv")


def is_own(name: str) -> bool:
    return name in NAMES


def is_whole(folder: Path) -> bool:
    return all((folder / name).is_file() for name in NAMES)


@contextmanager
def staged(place: Path) -> Iterator[StagedFolder]:
    with staged_folder(place, place, is_own, is_whole) as found:
        yield found


def write(place: Path, content: str) -> None:
    """What a command does."""
    with staged(place) as folder:
        folder.claim()
        for name in NAMES:
            (folder.path / name).write_text(content)
        folder.publish()


def contents(place: Path) -> set[str]:
    return {(place / name).read_text() for name in NAMES}


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


KILLS = ("carry", "exchange", "between", "remove", "end")


def killed_at(place: Path, moment: str) -> None:
    """A child process that dies in the middle of a replacement."""

    def die_before(name: str) -> Callable[..., object]:
        real = getattr(exchange_module, name)
        return lambda *words: os._exit(9) if name == moment else real(*words)

    for name in ("carry", "exchange", "remove"):
        setattr(exchange_module, name, die_before(name))
    if moment == "between":
        exchange_module._renameat2 = lambda *_: False
        real = Path.rename

        def rename(self: Path, target: Path) -> Path:
            moved = real(self, target)
            if target.name.endswith(".old"):
                os._exit(9)
            return moved

        Path.rename = rename  # type: ignore[method-assign, assignment]
    write(place, "new")
    os._exit(9)


@pytest.mark.parametrize("moment", KILLS)
def test_a_kill_leaves_one_of_the_two_whole_and_the_next_command_mends_the_rest(
    moment: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    place = tmp_path / "R"
    write(place, "old")
    (place / "mine").mkdir()
    (place / "mine" / "notes.txt").write_text("mine")
    process = multiprocessing.get_context("fork").Process(target=killed_at, args=(place, moment))
    process.start()
    process.join()
    assert process.exitcode == 9
    if moment != "between":
        assert contents(place) == {"old" if moment in ("carry", "exchange") else "new"}
        assert (place / "mine" / "notes.txt").read_text() == "mine"
    with staged(place) as folder:
        # what was interrupted is mended before anything else is looked at
        assert contents(place) in ({"old"}, {"new"})
        assert (place / "mine" / "notes.txt").read_text() == "mine"
        folder.claim()
    assert hidden(tmp_path) == []
    assert [path.name for path in tmp_path.iterdir()] == ["R"]
    named = [each.getMessage() for each in caplog.records]
    assert len(named) == (0 if moment == "end" else 2 if moment == "between" else 1), named


def test_what_is_not_ours_in_a_hidden_folder_is_never_removed(tmp_path: Path) -> None:
    left = tmp_path / ".R.partial"
    left.mkdir()
    (left / "one.csv").write_text("half")
    (left / "diary.txt").write_text("mine")
    with (
        pytest.raises(InputError, match=r"contains diary.txt, which polhode did not write"),
        staged(tmp_path / "R") as folder,
    ):
        folder.claim()
    assert (left / "diary.txt").read_text() == "mine"


def test_an_error_before_the_claim_leaves_what_can_be_resumed(tmp_path: Path) -> None:
    left = tmp_path / ".R.partial"
    left.mkdir()
    (left / "one.csv").write_text("half")
    with pytest.raises(InputError), staged(tmp_path / "R"):
        raise InputError("bad input")
    assert (left / "one.csv").read_text() == "half"


def test_a_file_that_comes_during_the_exchange_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "R"
    write(place, "old")
    real = exchange_module.exchange

    def late(new: Path, old: Path) -> Path:
        (old / "late.txt").write_text("mine")
        return real(new, old)

    monkeypatch.setattr(exchange_module, "exchange", late)
    write(place, "new")
    assert contents(place) == {"new"} and (place / "late.txt").read_text() == "mine"
    assert hidden(tmp_path) == []


def test_the_root_of_a_file_system_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "R").mkdir()
    monkeypatch.setattr(os.path, "ismount", lambda path: path == tmp_path / "R")
    with pytest.raises(InputError, match="give a folder inside it"), staged(tmp_path / "R"):
        pass


def test_a_file_system_without_locks_is_used_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", refuse)
    write(tmp_path / "R", "new")
    assert contents(tmp_path / "R") == {"new"}
