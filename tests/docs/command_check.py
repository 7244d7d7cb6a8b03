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


class Understood(BaseException):
    """Ends a command whose line was read; the program reports every exception of another kind."""


def _end(command: object) -> int:
    raise Understood(command)


def check(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """Raises AssertionError, with what is wrong, for a command that cannot be run as it stands."""
    program, arguments = words[0], words[1:]
    missing: list[str] = []
    if program == "polhode":
        _check_polhode(arguments, patch)
    elif program in ("python", "python3"):
        # options of the laboratory's commands are checked by lab/pages.py
        rest = [word for n, word in enumerate(arguments) if "-m" in arguments[: n + 1] or word[0] != "-"]
        if rest and rest[0] != "-m":
            missing = [] if (ROOT / rest[0]).is_file() else rest[:1]
        elif rest:
            path = ROOT / rest[1].replace(".", "/")
            found = path.is_dir() or path.with_suffix(".py").is_file() or find_spec(rest[1]) is not None
            missing = [] if found else rest[1:2]
    elif program == "make":
        targets = re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        # those of the laboratory are checked by lab/pages.py
        missing = [word for word in arguments if not re.match(r"bench-|\w+=", word) and word not in targets]
    elif program == "pip":
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        named = [
            each for word in arguments for name in re.findall(r"\[(.*)\]", word) for each in name.split(",")
        ]
        missing = [name for name in named if name not in extras]
    elif program == "pytest":
        files = [word.split("::")[0] for word in arguments if word.startswith("tests/")]
        missing = [file for file in files if not (ROOT / file).exists()]
    assert not missing, f"{' '.join(words)}: there is no {missing}"


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
    printed = io.StringIO()
    if command in COMMANDS:
        with contextlib.redirect_stdout(printed):
            main([command, "--help"])
    return frozenset(re.findall(r"--[a-z][\w.-]*", printed.getvalue()))
