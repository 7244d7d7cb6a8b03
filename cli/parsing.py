"""The words of a command line as a command: tyro parses them, mistakes become one line."""

import contextlib
import dataclasses
import io
import operator
import re
import sys
from collections.abc import Callable, Sequence
from functools import cache
from itertools import dropwhile, takewhile
from typing import Any, cast, get_args, get_origin

import tyro
from tyro.conf import Fixed
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructTypeInfo,
)

from polhode.cli.help import class_for_help, introduction
from polhode.cli.options import Command, Option, is_configured, options_of
from polhode.cli.overrides import option_names
from polhode.config.keys import is_structured, suggestion
from polhode.errors import InputError

FIXED: Any = Fixed[str]
"""Type of a field that is no option"""


def parse(name: str, command: type[Command], words: Sequence[str]) -> Command:
    """The command with its options. Raises InputError for words that it does not understand.

    tyro 1.0 has no public access to the text of an error: it draws it in a box on standard error and exits.
    """
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr):
            parsed, unknown = tyro.cli(
                cast(Any, _own(command)),
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
        drawn = squash(stderr.getvalue())
        message = _missing(drawn, command) or _wrong_value(drawn, command, words) or drawn
        raise InputError(f"{message}; see polhode {name} --help") from None
    if unknown:
        raise InputError(_unknown_option(name, command, unknown[0]))
    own = {each.name for each in dataclasses.fields(parsed)} - {"values"}
    return command(**{name: getattr(parsed, name) for name in own})


@cache
def _own(command: type[Command]) -> type[Command]:
    """The command without the keys of the configuration, which ``overrides`` has read: tyro would look at
    each of them, for a quarter of a second."""
    if not is_configured(command):
        return command
    body = {"__annotations__": {"values": FIXED}, "values": None}
    return dataclasses.dataclass(type(command.__name__, (command,), body), frozen=True)


def print_help(name: str, command: type[Command], everything: bool) -> None:
    """Print the help of a command: its common options, or ``everything``. tyro draws the options."""
    drawn = _Drawing(sys.stdout)
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(drawn):
        tyro.cli(
            class_for_help(name, command, everything),
            prog=f"polhode {name}",
            description="",
            args=["--help"],
            registry=_registry(),
        )
    _, _, options = drawn.getvalue().partition("\n\n")
    print(f"{introduction(name, command, everything)}\n\n{options.strip(chr(10))}")


class _Drawing(io.StringIO):
    """Takes what is drawn for a stream, with the characters and the colours that the stream can show."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream

    @property
    def encoding(self) -> str | None:  # type: ignore[override]
        """That of the stream."""
        return getattr(self._stream, "encoding", None)

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return bool(self._stream.isatty())


def _registry() -> ConstructorRegistry:
    """Tell tyro that lists of sections, and mappings, are one word of YAML, which ``overrides`` reads; and
    that descriptions are wrapped where the terminal ends, and not also where the source does."""
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

    described: list[type] = []

    @registry.struct_rule
    def unbroken(info: StructTypeInfo) -> StructConstructorSpec | None:
        # the other rules are asked for the type, this one not again
        if info.type in described:
            return None
        described.append(info.type)
        try:
            spec = ConstructorRegistry.get_struct_spec(info)
        finally:
            described.pop()
        if not isinstance(spec, StructConstructorSpec):
            return None
        fields = (dataclasses.replace(each, helptext=_unbroken(each.helptext)) for each in spec.fields)
        return dataclasses.replace(spec, fields=tuple(fields))

    return registry


def _unbroken(help_text: "str | Callable[[], str | None] | None") -> Callable[[], str | None]:
    """The description of a field as one line; found when it is asked for, as tyro does."""

    def found() -> str | None:
        text = help_text() if callable(help_text) else help_text
        return text and " ".join(text.split())

    return found


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


def _missing(message: str, command: type[Command]) -> str | None:
    """What is missing, and what each of it is; None: the message is about something else."""
    title, _, listed = message.partition(": Missing from ")
    if title != "Required options":
        return None
    lacking = []
    for part in listed.partition(": ")[2].split("(required)"):
        option = next((each for each in options_of(command) if _is_about(part.strip(), each)), None)
        if option is not None:
            lacking.append(f"{option.invocation} ({_described(part.strip(), option)})")
    if not lacking:
        return None
    *others, last = lacking
    return f"{', '.join(others)} and {last} are missing" if others else f"{last} is missing"


def _is_about(text: str, option: Option) -> bool:
    starts = [option.metavar] if option.is_positional else option.names
    return text.partition(" ")[0].rstrip(",") in starts


def _described(text: str, option: Option) -> str:
    """What an option is: the beginning of its description, before which the help has put its names."""
    value = re.escape(option.metavar)
    names = value if option.is_positional else rf"(?:--?[\w-]+ {value}(?:, )?)+"
    description = re.sub(rf"^{names}\s*", "", text)
    beginning = re.split(r"\.(?:\s|$)|:\s|\s\(", description)[0]
    is_abbreviation = beginning[:2].isupper()
    return beginning if is_abbreviation else beginning[:1].lower() + beginning[1:]


def _wrong_value(message: str, command: type[Command], words: Sequence[str]) -> str | None:
    """What was given for an option and what it takes; None: the message is about something else."""
    about = re.search(
        r"^(?:Value error|Missing argument|Invalid choice): .*?(?:parsing|argument) '?(--?[\w-]+)", message
    )
    option = next((each for each in options_of(command) if about and about[1] in each.names), None)
    wanted = option and _wanted(option)
    if option is None or not wanted:
        return None
    name, given = _given(option, words)
    return (
        f"{' '.join([name, *given])}: give {wanted}"
        if given
        else f"{name}: a value is missing; give {wanted}"
    )


def _given(option: Option, words: Sequence[str]) -> tuple[str, list[str]]:
    """The name by which an option was given, and the words after it up to the next option."""
    for k, word in enumerate(words):
        name, _, joined = word.partition("=")
        if name.replace("_", "-") in option.names:
            rest = takewhile(lambda each: not re.match(r"--?[a-zA-Z]", each), words[k + 1 :])
            return name, [joined] if joined else list(rest)
    return option.names[0], []


def _wanted(option: Option) -> str:
    """The value that an option takes; empty: any."""
    if option.choices:
        return f"one of {', '.join(option.choices)}"
    for kind in option.kinds:
        numbers = [each for each in get_args(kind) if each in (int, float)]
        if get_origin(kind) is tuple and len(numbers) == len(get_args(kind)):
            return f"{len(numbers)} numbers: {option.metavar}"
        if kind in (int, float):
            return "a whole number" if kind is int else "a number"
    return option.metavar


def squash(text: str) -> str:
    """A message that tyro drew as a title and a box, as one line: the title and the text above the next rule.

    Where standard output is not UTF-8, tyro underlines the title with hyphens instead of drawing a box.
    """
    lines = [line.strip("│╭╮╰╯─ ") for line in text.splitlines()]
    rows = iter(line if line.strip("-") else "" for line in lines)
    title = next(filter(None, rows), "this command line cannot be read")
    body = " ".join(takewhile(bool, dropwhile(operator.not_, rows)))
    return " ".join((f"{title}: {body}" if body else title).split())
