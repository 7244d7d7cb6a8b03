"""The program ``polhode``.

Exit code 0: done; 2: the user's mistake, one line on standard error; 1: the run failed.
"""

import contextlib
import io
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, Any, Union, cast

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from polhode.cli.commands import COMMANDS, Command, Configured, with_values
from polhode.cli.console import show_warnings
from polhode.cli.overrides import option_names, split_overrides
from polhode.config.keys import is_structured, suggestion
from polhode.config.loader import load_config
from polhode.errors import InputError, RunFailure
from polhode.threads import limit_threads

DESCRIPTION = "Motion, mass properties and shape of a tumbling target, from a stereo camera."
INTERRUPTED = 130
CLOSED = 141
"""As a program that SIGPIPE ends."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (default: the process's own); the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    # Nothing imported so far loads NumPy (tests/pipeline/test_cli.py); the configuration may raise the limit.
    limit_threads(1)
    try:
        with show_warnings():
            return _dispatch([word for word in words if word != "--debug"])
    except InputError as error:
        return _fail(InputError.exit_code, str(error), debug)
    except RunFailure as error:
        return _fail(RunFailure.exit_code, str(error), debug)
    except KeyboardInterrupt as stop:
        return _fail(INTERRUPTED, str(stop) or "interrupted", debug)
    except BrokenPipeError:
        # Whoever read the output (head, less) has enough; nothing more can be told there.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED
    except Exception as error:  # noqa: BLE001  the last resort: one line instead of a traceback
        message = (
            f"unexpected {type(error).__name__}: {error}; this is a fault of polhode, --debug shows where"
        )
        return _fail(RunFailure.exit_code, message, debug)


def _dispatch(words: list[str]) -> int:
    if words == ["--version"]:
        from importlib.metadata import version

        print(f"polhode {version('polhode')}")
        return 0
    asks_help = any(word in ("-h", "--help") for word in words)
    if not asks_help:
        _require_command(words)
    elif words[0] in COMMANDS:
        # Whatever else stands on the line, help is what was asked for.
        words = [words[0], "--help"]
    own, overrides = split_overrides(words)
    command = _parse(own)
    if command is None:
        return 0
    if isinstance(command, Configured):
        command = with_values(command, load_config(command.config, overrides))
    elif overrides:
        raise InputError(f"'{words[0]}' reads no configuration: remove --{next(iter(overrides))}")
    return command.execute()


def _require_command(words: list[str]) -> None:
    names = ", ".join(COMMANDS)
    if not words:
        raise InputError(f"a command is missing: {names}; see polhode --help")
    if words[0] not in COMMANDS:
        hint = suggestion(words[0], list(COMMANDS))
        raise InputError(f"unknown command '{words[0]}';{hint} commands: {names}; see polhode --help")


def _parse(words: list[str]) -> Command | None:
    """The command that the words ask for; None when they asked for help, which tyro has printed."""
    options = [Annotated[cls, tyro.conf.subcommand(name)] for name, cls in COMMANDS.items()]
    union = cast(Any, Union)[tuple(options)]
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr):
            command, unknown = tyro.cli(
                union,
                prog="polhode",
                description=DESCRIPTION,
                args=words,
                return_unknown_args=True,
                registry=_registry(),
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            return None
        raise InputError(f"{squash(stderr.getvalue())}; see polhode {words[0]} --help") from None
    if unknown:
        raise InputError(_unknown_option(words[0], unknown[0]))
    return cast(Command, command)


def _registry() -> ConstructorRegistry:
    """Tells tyro that lists of sections, and mappings, are one word of YAML: ``overrides`` reads it."""
    registry = ConstructorRegistry()

    @registry.primitive_rule
    def structured(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if not is_structured(info.type):
            return None
        return PrimitiveConstructorSpec(
            nargs=1,
            metavar="YAML",
            instance_from_str=lambda words: words[0],
            is_instance=lambda value: isinstance(value, tuple | dict),
            str_from_instance=lambda value: ["{}" if isinstance(value, dict) else "[]"],
        )

    return registry


def _unknown_option(command: str, word: str) -> str:
    if not word.startswith("-"):
        return f"unexpected argument '{word}'; see polhode {command} --help"
    name = word.partition("=")[0]
    hint = suggestion(name, [*option_names(), "--data", "--output", "--overwrite", "--debug"])
    return f"unknown option '{name}';{hint} see polhode {command} --help"


def squash(text: str) -> str:
    """A message that tyro drew in a box, as one line: its title and the words above the first rule."""
    words: list[str] = []
    for line in text.splitlines():
        content = line.strip("│╭╮╰╯─ \n")
        if words and not content:
            break
        words += content.split()
        if line.startswith("╭"):
            words[-1:] = [words[-1] + ":"] if words else []
    return " ".join(words) or "this command line cannot be read"


def _fail(code: int, message: str, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    print(f"polhode: error: {' '.join(message.split())}", file=sys.stderr)
    return code
