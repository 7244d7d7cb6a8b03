"""The words of a command line as a command: tyro parses them, mistakes become one line."""

import contextlib
import io
import operator
from collections.abc import Sequence
from itertools import dropwhile, takewhile
from typing import Any, cast

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from polhode.cli.help import class_for_help
from polhode.cli.options import Command, is_configured, options_of
from polhode.cli.overrides import option_names
from polhode.config.keys import is_structured, suggestion
from polhode.errors import InputError


def parse(name: str, command: type[Command], words: Sequence[str]) -> Command:
    """The command with its options. Raises InputError for words that it does not understand.

    tyro 1.0 has no public access to the text of an error: it draws it in a box on standard error and exits.
    """
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr):
            parsed, unknown = tyro.cli(
                cast(Any, command),
                prog=f"polhode {name}",
                args=words,
                return_unknown_args=True,
                registry=_registry(),
            )
    except SystemExit:
        # What an option that does not exist leaves for the others, tyro's message is about.
        mistaken = next((word for word in words if _is_no_option(command, word)), None)
        if mistaken is not None:
            raise InputError(_unknown_option(name, command, mistaken)) from None
        raise InputError(f"{squash(stderr.getvalue())}; see polhode {name} --help") from None
    if unknown:
        raise InputError(_unknown_option(name, command, unknown[0]))
    return cast(Command, parsed)


def print_help(name: str, command: type[Command], everything: bool) -> None:
    """Print the help of a command: its common options, or ``everything``."""
    with contextlib.suppress(SystemExit):
        tyro.cli(
            class_for_help(name, command, everything),
            prog=f"polhode {name}",
            args=["--help"],
            registry=_registry(),
        )


def _registry() -> ConstructorRegistry:
    """Tell tyro that lists of sections, and mappings, are one word of YAML, which ``overrides`` reads."""
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


def _own_options(command: type[Command]) -> list[str]:
    """Options of a command beside the keys of the configuration; its positional arguments are among them."""
    return [name for option in options_of(command) for name in option.names]


def _is_no_option(command: type[Command], word: str) -> bool:
    name = word.partition("=")[0].replace("_", "-")
    return name.startswith("--") and name not in _own_options(command)


def _unknown_option(name: str, command: type[Command], word: str) -> str:
    if not word.startswith("-"):
        return f"unexpected argument '{word}'; see polhode {name} --help"
    option = word.partition("=")[0]
    configured = option_names() if is_configured(command) else []
    hint = suggestion(option, [*_own_options(command), *configured])
    return f"unknown option '{option}';{hint} see polhode {name} --help"


def squash(text: str) -> str:
    """A message that tyro drew as a title and a box, as one line: the title and the text above the next rule.

    Where standard output is not UTF-8, tyro underlines the title with hyphens instead of drawing a box.
    """
    lines = [line.strip("│╭╮╰╯─ ") for line in text.splitlines()]
    rows = iter(line if line.strip("-") else "" for line in lines)
    title = next(filter(None, rows), "this command line cannot be read")
    body = " ".join(takewhile(bool, dropwhile(operator.not_, rows)))
    return " ".join((f"{title}: {body}" if body else title).split())
