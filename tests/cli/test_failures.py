"""Errors that nothing else has explained: whose fault they are, in one line that a terminal shows safely."""

import errno
import os
import re
from pathlib import Path

import pytest

from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.failures import EXHAUSTED, LESS_MEMORY, REFUSED, explained
from polhode.cli.main import main
from polhode.runtime.console import Lines, show_warnings
from polhode.runtime.errors import InputError, RunFailure, one_line

Capture = pytest.CaptureFixture[str]


def broken_text() -> Exception:
    try:
        b"ab\xff".decode()
    except UnicodeDecodeError as error:
        return error
    raise AssertionError


def broken_name() -> Exception:
    try:
        "a\udcff".encode()
    except UnicodeEncodeError as error:
        return error
    raise AssertionError


CASES: dict[str, tuple[Exception, int, str]] = {
    "full": (OSError(errno.ENOSPC, "No space", "R/a.npz"), 1, "R/a.npz: No space: free some space"),
    "full, two names": (OSError(errno.ENOSPC, "No space", "a", None, "b"), 1, "a -> b: No space: free"),
    "limit of files": (OSError(errno.EMFILE, "Too many files", "x"), 1, "x: Too many files: raise the"),
    "broken disk": (OSError(errno.EIO, "I/O error", "x"), 1, "x: I/O error: the device fails"),
    "read-only": (OSError(errno.EROFS, "Read-only", "x"), 2, "x: Read-only: choose"),
    "permission": (PermissionError(errno.EACCES, "Permission denied", "x"), 2, "x: Permission denied: chan"),
    "long name": (OSError(errno.ENAMETOOLONG, "Too long", "x"), 2, "x: Too long: choose"),
    "no name": (OSError(errno.EPIPE, "Broken pipe"), 2, "a file or process: Broken pipe: check"),
    "memory": (MemoryError(), 1, "the memory is exhausted (MemoryError): close other"),
    "memory of torch": (RuntimeError("can't allocate memory: 8 bytes"), 1, "the memory is exhausted"),
    "memory of the loader": (ImportError("cv2.so: failed to map segment from"), 1, "the memory is exhaus"),
    "threads": (RuntimeError("can't start new thread"), 1, "no more threads can be started"),
    "nesting": (RecursionError("maximum"), 2, "nested too deeply"),
    "bytes": (broken_text(), 2, "a text is not UTF-8 (byte 0xff at position 2)"),
    "name": (broken_name(), 2, r"'a\udcff' cannot be written as UTF-8"),
    "package": (ModuleNotFoundError("No module named 'x'"), 1, "the installation is incomplete"),
    "users": (InputError("a\x1b[31mb"), 2, r"a\x1b[31mb"),
    "run": (RunFailure("it failed"), 1, "it failed"),
    "ours": (KeyError("x"), 1, "unexpected KeyError: 'x'; this is a defect of polhode"),
}


@pytest.mark.parametrize("name", CASES)
def test_each_error_says_whose_fault_it_is(name: str) -> None:
    error, code, expected = CASES[name]
    found, line = explained(error, working=False)
    assert (found, line.count("\n")) == (code, 0)
    assert expected in line
    assert ("defect" in line) == (name == "ours")


def test_a_path_that_fails_amid_the_work_is_a_failed_run() -> None:
    with show_warnings(), Lines().stage("matching", 0):
        assert explained(FileNotFoundError(errno.ENOENT, "gone", "x"), working=True)[0] == 1
        assert explained(RecursionError("maximum"), working=True)[1].endswith("--debug shows where")


@pytest.mark.parametrize("command", [*LESS_MEMORY, "evaluate", "report"])
def test_where_the_machine_ends_only_options_that_the_command_has_are_advised(
    command: str, capsys: Capture
) -> None:
    assert main([command, "--help"]) == 0
    help_text = capsys.readouterr().out
    ends = [OSError(number, "none left", "x") for number in EXHAUSTED]
    for error in (MemoryError(), RuntimeError("can't start new thread"), *ends):
        code, line = explained(error, True, command)
        assert (code, line.count("\n")) == (1, 0) and "{" not in line
        for option in re.findall(r"--[a-z.-]+", line):
            assert option in help_text


def test_no_error_number_has_two_meanings() -> None:
    assert not EXHAUSTED.keys() & REFUSED.keys()


def test_the_exit_code_tells_whether_the_work_had_begun(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def fail(command: EvaluateCommand) -> int:
        with Lines().stage("reading", 1):
            raise FileNotFoundError(errno.ENOENT, "gone", "x")

    def fail_later(command: EvaluateCommand) -> int:
        with Lines().stage("reading", 1) as advance:
            advance()
        raise FileNotFoundError(errno.ENOENT, "gone", "x")

    for execute, code in ((fail, 2), (fail_later, 1), (fail, 2)):
        monkeypatch.setattr(EvaluateCommand, "execute", execute)
        assert main(["evaluate", "R", "S"]) == code
        assert capsys.readouterr().err.startswith("polhode: error: x: gone: check the path")


HOSTILE = "a\x1b]0;owned\x07\x1b[2J\x9b\u202e\udcff\nb"
ESCAPED = r"a\x1b]0;owned\x07\x1b[2J\x9b\u202e\udcff b"


def test_control_characters_are_shown_escaped() -> None:
    assert one_line(HOSTILE) == ESCAPED
    assert one_line("5 ± 1 m, 表, é") == "5 ± 1 m, 表, é"


def test_hostile_names_do_not_reach_the_terminal(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "a\x1b[31m\udcff"
    assert main(["evaluate", str(folder), str(folder)]) == 2
    assert main(["--debug", "evaluate", str(folder), str(folder)]) == 2
    captured = capsys.readouterr()
    assert r"a\x1b[31m\udcff" in captured.err
    assert "Traceback" in captured.err
    assert "\x1b" not in captured.out + captured.err


def test_hostile_titles_and_warnings_do_not_reach_the_terminal(capsys: Capture) -> None:
    import logging

    # A surrogate in the log that pytest keeps could not be passed on by its parallel processes.
    text = HOSTILE.replace("\udcff", "")
    with show_warnings(), Lines().stage(HOSTILE, 0):
        logging.getLogger("polhode.test").warning("%s", text)
    out = capsys.readouterr().out
    assert out.splitlines()[0] == f"warning: {ESCAPED.replace(chr(92) + 'udcff', '')}"
    assert all(character.isprintable() or character == "\n" for character in out)


def test_names_that_are_no_text_are_shown(tmp_path: Path) -> None:
    code, line = explained(OSError(errno.ENOENT, "No such file or directory", os.fsencode("b\udcff")), False)
    assert (code, line.split(":")[0]) == (2, r"b\udcff")
