"""Whether a command can be what it says: its program, its options and what it names exist. Nothing is run."""

import contextlib
import functools
import io
import re
import tomllib
from importlib.util import find_spec

import pytest

from polhode.cli.main import COMMANDS, main
from tests.docs.page_code import ROOT

_PLACEHOLDER = re.compile(r"^(?:\.\.\.|\[.*|.*\]|NAME)$")
"""Words of usage lines that stand for others"""


def check(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """Raises AssertionError, with what is wrong, for a command that cannot be run as it stands."""
    program, arguments = words[0], words[1:]
    if program == "polhode":
        _check_polhode(arguments, patch)
    elif program in ("python", "python3"):
        _check_python(arguments)
    elif program == "make":
        text = (ROOT / "Makefile").read_text()
        targets = set(re.findall(r"^([a-z][\w-]*):", text, re.MULTILINE))
        # those of the laboratory are checked by lab/pages.py
        missing = [word for word in arguments if not re.match(r"bench-|\w+=", word) and word not in targets]
        assert not missing, f"make has no target {missing}"
    elif program == "pip":
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        found = (name for word in arguments for name in re.findall(r"\[(.*)\]", word))
        named = {each for name in found for each in name.split(",")}
        assert named <= set(extras), f"no such extra: {named - set(extras)}"
    elif program == "pytest":
        files = [word.split("::")[0] for word in arguments if word.startswith("tests/")]
        missing = [file for file in files if not (ROOT / file).exists()]
        assert not missing, f"no such tests: {missing}"


def _check_polhode(words: list[str], patch: pytest.MonkeyPatch) -> None:
    assert words[0] in (*COMMANDS, "--version", "--help"), f"polhode {words[0]}: no such command"
    if len(words) == 1 or words[0] not in COMMANDS:
        return
    stderr = io.StringIO()
    # only here: what the page runs after it must do its work
    with patch.context() as idle, contextlib.redirect_stderr(stderr):
        for command in COMMANDS.values():
            idle.setattr(command, "execute", _end)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                main(words)
        except Understood:
            return
    raise AssertionError(stderr.getvalue())


class Understood(BaseException):
    """Ends a command whose line was read; the program reports every exception of another kind."""


def _end(command: object) -> int:
    raise Understood(command)


def _check_python(words: list[str]) -> None:
    words = words[next((n for n, word in enumerate(words) if word == "-m" or word[0] != "-"), len(words)) :]
    if not words:
        return
    if words[0] != "-m":
        assert (ROOT / words[0]).is_file(), f"{words[0]}: no such file"
        return
    path = ROOT / words[1].replace(".", "/")
    # options of the laboratory's commands are checked by lab/pages.py
    found = path.is_dir() or path.with_suffix(".py").is_file() or find_spec(words[1]) is not None
    assert found, f"{words[1]}: no such module"


def check_mention(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """The same for what running text mentions, which may leave out arguments or name a placeholder."""
    words = [word for word in words if not _PLACEHOLDER.match(word)]
    if words[0] != "polhode" or len(words) == 1:
        check(words, patch)
        return
    assert words[1] in (*COMMANDS, "--version", "--help"), f"polhode {words[1]}: no such command"
    named = {word.strip("[]").partition("=")[0] for word in words[2:] if word.startswith("--")}
    missing = named - {*options_of(words[1]), "--help", "--version", "--debug"}
    assert not missing, f"{' '.join(words)}: no such option: {missing}"


@functools.cache
def options_of(command: str) -> frozenset[str]:
    """Options of a command of the program, those of the configuration among them."""
    if command not in COMMANDS:
        return frozenset()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main([command, "--help"])
    return frozenset(re.findall(r"--[a-z][\w.-]*", printed.getvalue()))
