"""Whether a command can be what it says: its program, its options and what it names exist. Nothing is run."""

import contextlib
import functools
import importlib
import importlib.util
import io
import re
import tomllib
from collections.abc import Callable
from typing import Any

import pytest
import tyro

from polhode.cli.main import COMMANDS, main
from tests.docs.page_code import ROOT

_PLACEHOLDER = re.compile(r"^(?:\.\.\.|\[.*|.*\]|NAME)$")
"""Words of usage lines that stand for others"""


def check(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """Raises AssertionError, with what is wrong, for a command that cannot be run as it stands."""
    checks: dict[str, Callable[[list[str], pytest.MonkeyPatch], None]] = {
        "polhode": _check_polhode,
        "python": _check_python,
        "python3": _check_python,
        "make": _check_make,
        "pip": _check_pip,
        "pytest": _check_pytest,
    }
    if words[0] in checks:
        checks[words[0]](words[1:], patch)


def _check_polhode(words: list[str], patch: pytest.MonkeyPatch) -> None:
    assert words[0] in (*COMMANDS, "--version", "--help"), f"polhode {words[0]}: no such command"
    if len(words) == 1 or words[0] not in COMMANDS:
        return
    stderr = io.StringIO()
    # only here: what the page runs after it must do its work
    with (
        patch.context() as idle,
        contextlib.redirect_stderr(stderr),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        for command in COMMANDS.values():
            idle.setattr(command, "execute", _end)
        try:
            main(words)
        except Understood:
            return
    raise AssertionError(stderr.getvalue())


class Understood(BaseException):
    """Ends a command whose line was read; the program reports every exception of another kind."""


def _end(command: object) -> int:
    raise Understood(command)


def _check_python(words: list[str], patch: pytest.MonkeyPatch) -> None:
    words = words[next((n for n, word in enumerate(words) if word == "-m" or word[0] != "-"), len(words)) :]
    if not words:
        return
    if words[0] != "-m":
        assert (ROOT / words[0]).is_file(), f"{words[0]}: no such file"
        return
    module, arguments = words[1], words[2:]
    if module == "pytest":
        _check_pytest(arguments, patch)
        return
    assert importlib.util.find_spec(module) is not None, f"{module}: no such module"
    if module == "benchmarks" or module.startswith("benchmarks."):
        _check_benchmark(module, arguments)


def _check_benchmark(module: str, words: list[str]) -> None:
    """Its options, as its own command line reads them."""
    found = importlib.import_module(module)
    if hasattr(found, "__path__"):
        found = importlib.import_module(f"{module}.__main__")
    function = found.main

    @functools.wraps(function)
    def stub(*_: Any, **__: Any) -> None:
        return None

    stderr, code = io.StringIO(), 0
    try:
        with contextlib.redirect_stderr(stderr), contextlib.redirect_stdout(io.StringIO()):
            tyro.cli(stub, args=words, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as stop:
        code = int(stop.code or 0)
    assert code == 0, f"{module} {' '.join(words)}: {stderr.getvalue()}"


def _check_make(words: list[str], patch: pytest.MonkeyPatch) -> None:
    del patch
    from benchmarks.registry import BENCHMARKS

    text = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z][\w-]*):", text, re.MULTILINE))
    targets |= {f"bench-{word}" for each in BENCHMARKS for word in (each.name, each.topic, each.also) if word}
    missing = [word for word in words if "=" not in word and word not in targets]
    assert not missing, f"make has no target {missing}"


def _check_pip(words: list[str], patch: pytest.MonkeyPatch) -> None:
    del patch
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {each for word in words for found in re.findall(r"\[(.*)\]", word) for each in found.split(",")}
    assert named <= set(extras), f"no such extra: {named - set(extras)}"


def _check_pytest(words: list[str], patch: pytest.MonkeyPatch) -> None:
    del patch
    missing = [
        word for word in words if word.startswith("tests/") and not (ROOT / word.split("::")[0]).exists()
    ]
    assert not missing, f"no such tests: {missing}"


def check_mention(words: list[str], patch: pytest.MonkeyPatch) -> None:
    """The same for what running text mentions, which may leave out arguments or name a placeholder."""
    words = [word for word in words if not _PLACEHOLDER.match(word)]
    if words[0] == "polhode" and len(words) > 1:
        assert words[1] in (*COMMANDS, "--version", "--help"), f"polhode {words[1]}: no such command"
        named = {word.strip("[]").partition("=")[0] for word in words[2:]}
        known = {*options_of(words[1]), "--help", "--version", "--debug"}
        missing = {word for word in named if word.startswith("--")} - known
        assert not missing, f"{' '.join(words)}: no such option: {missing}"
    else:
        check(words, patch)


@functools.cache
def options_of(command: str) -> frozenset[str]:
    """Options of a command of the program, those of the configuration among them."""
    if command not in COMMANDS:
        return frozenset()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main([command, "--help"])
    return frozenset(re.findall(r"--[a-z][\w.-]*", printed.getvalue()))
