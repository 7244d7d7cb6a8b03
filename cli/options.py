"""What several commands have in common: the type of a command, and the types of shared options."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, cast, get_args, get_origin, get_type_hints

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.cli.answer import Answer
from polhode.config import Config
from polhode.config.keys import options_of as union_members
from polhode.errors import InputError

ConfigFile = Annotated[Positional[Path], arg(metavar="CONFIG")]
OptionalConfigFile = Annotated[Positional[Path | None], arg(metavar="CONFIG")]
ConfigValues = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]
"""The configuration itself: the help lists its keys as options, which ``overrides`` reads."""
Flag = FlagCreatePairsOff[bool]


class Command(Protocol):
    """What the command line is parsed into.

    A command may have ``GROUPS``, the groups of its less common options: title -> names of its fields; and
    ``EXAMPLES``: pairs of a command line and what it does.
    """

    def execute(self) -> Answer:
        """Run the command."""
        ...


@dataclass(frozen=True)
class GeneralOptions:
    """Of every command, wherever they stand on the line."""

    quiet: Annotated[Flag, arg(aliases=["-q"])] = False
    """Print the last line only: no progress, no tables, no warnings."""
    verbose: Annotated[Flag, arg(aliases=["-v"])] = False
    """Show what the program logs (RUN/log.txt) on standard error."""
    json: Flag = False
    """Answer with one JSON object on standard output (docs/command_line.md); all else goes to standard
    error."""
    debug: Flag = False
    """Show the traceback of an error."""


_WORDS = {"-q": "quiet", "-v": "verbose"} | {f"--{each.name}": each.name for each in fields(GeneralOptions)}


def split_general(words: Sequence[str]) -> tuple[GeneralOptions, list[str]]:
    """The general options of a command line, and its other words. Raises InputError: they contradict."""
    given = GeneralOptions(**{_WORDS[word]: True for word in words if word in _WORDS})
    return given, [word for word in words if word not in _WORDS]


@dataclass(frozen=True)
class Option:
    """An option or argument of a command, as it stands on the command line."""

    names: tuple[str, ...]
    """With their dashes, the usual one first"""
    is_positional: bool
    takes_value: bool
    choices: tuple[str, ...]
    """Empty: any value"""
    required: bool = False
    metavar: str = ""
    """What stands for the value in the help; empty: it has none of its own"""
    kinds: tuple[Any, ...] = ()
    """Types of its value: the members of a union"""

    @property
    def invocation(self) -> str:
        """The shortest name with what stands for the value, as people write it."""
        if self.is_positional:
            return self.metavar
        return f"{min(self.names, key=len)} {self.metavar}".rstrip()


def options_of(command: type[Any]) -> list[Option]:
    """The options of a command beside those of the configuration, and its positional arguments."""
    hints = get_type_hints(command, include_extras=True)
    required = {
        each.name for each in fields(command) if each.default is MISSING and each.default_factory is MISSING
    }
    return [_option(name, hints[name], name in required) for name in field_names(command)]


def _option(field: str, annotation: Any, required: bool) -> Option:
    markers = getattr(annotation, "__metadata__", ())
    aliases = [alias for marker in markers for alias in getattr(marker, "aliases", None) or ()]
    metavar = next((each.metavar for each in markers if getattr(each, "metavar", None)), "")
    kinds = union_members(annotation)
    choices = [str(value) for kind in kinds if get_origin(kind) is Literal for value in get_args(kind)]
    if not choices and str in kinds and re.fullmatch(r"\w+(\|\w+)+", metavar):
        choices = metavar.split("|")
    return Option(
        (f"--{field.replace('_', '-')}", *aliases),
        is_positional=_POSITIONAL in markers,
        takes_value=bool not in kinds,
        choices=tuple(choices),
        required=required,
        metavar=metavar,
        kinds=kinds,
    )


_POSITIONAL = get_args(Positional[int])[1]


def is_configured(command: type[Command]) -> bool:
    """Whether the keys of the configuration are options of the command."""
    return "values" in {each.name for each in fields(cast(Any, command))}


def groups_of(command: type[Command]) -> Mapping[str, Sequence[str]]:
    """Titles of the groups of a command's less common options, and the fields in each."""
    return cast(Mapping[str, Sequence[str]], getattr(command, "GROUPS", {}))


def examples_of(command: type[Command]) -> Sequence[tuple[str, str]]:
    """Command lines that show how a command is used, each with what it does."""
    return cast(Sequence[tuple[str, str]], getattr(command, "EXAMPLES", ()))


def field_names(command: type[Command]) -> list[str]:
    """Fields of a command, in order, beside what ``main`` fills in."""
    return [each.name for each in fields(cast(Any, command)) if each.name not in ("values", "commands")]


def require_positive(command: object, *names: str, most: float = 1e12) -> None:
    """Raises InputError for an option that is not a number above 0 and at most ``most``."""
    for name in names:
        value = getattr(command, name)
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number above 0")
        if not 1.0 / 1e12 <= value <= most:
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number from 1e-12 to {most:g}")
