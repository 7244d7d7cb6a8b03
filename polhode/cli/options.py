"""The options of a command as data, read off its fields: parsing, help and completion all work on these."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from polhode.cli.answer import Answer
from polhode.config import Config, Scene, Train
from polhode.config.keys import dotted, is_structured, section_of
from polhode.config.keys import options_of as union_members


@dataclass(frozen=True)
class Positional:
    """A field that is an argument without a name; in the help it is called ``metavar``."""

    metavar: str


@dataclass(frozen=True)
class Named:
    """A field that is an option: what stands for its value in the help, and its other names."""

    metavar: str = ""
    other_name: str = ""


Positive = Field(ge=1e-12, le=1e12, allow_inf_nan=False)
"""Of a number above 0 by which the command divides"""


class Command(BaseModel):
    """What the command line is parsed into: each field is an option, its docstring the help."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)

    def execute(self) -> Answer:
        """Run the command."""
        raise NotImplementedError


class ConfiguredCommand(Command):
    """A command that reads a configuration, whose keys are options, too."""

    config: Annotated[Path | None, Positional("CONFIG")] = None
    """Configuration, YAML. If it is left out the defaults apply, which fit any calibrated sequence."""
    values: Config = Config()
    """The content of the configuration, with the options laid over it."""


class GeneralOptions(BaseModel):
    """Of every command, wherever they stand on the line."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True)

    quiet: Annotated[bool, Named(other_name="-q")] = False
    """Print the last line only: no progress, no tables, no warnings."""
    verbose: Annotated[bool, Named(other_name="-v")] = False
    """Show what the program logs (RUN/log.txt) on standard error."""
    json_answer: Annotated[bool, Field(alias="json")] = False
    """Answer with one JSON object on standard output (docs/command_line.md); all else goes to standard
    error."""
    debug: bool = False
    """Show the traceback of an error."""


@dataclass(frozen=True)
class Option:
    """An option or argument of a command, as it stands on the command line."""

    names: tuple[str, ...]
    """With their dashes, the usual one first"""
    field: FieldInfo
    metavar: str
    """What stands for the value in the help; empty: it takes none"""
    default: Any
    is_positional: bool = False
    is_flag: bool = False
    """Whether no value follows it"""

    @property
    def kinds(self) -> tuple[Any, ...]:
        """Types of its value: the members of a union."""
        return union_members(self.field.annotation)

    @property
    def takes_many(self) -> bool:
        """Whether several words are its value."""
        return any(get_origin(kind) is tuple for kind in self.kinds)

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.field.is_required()

    @property
    def choices(self) -> tuple[str, ...]:
        """Empty: any value."""
        choices = [str(each) for kind in self.kinds if get_origin(kind) is Literal for each in get_args(kind)]
        if bool in self.kinds and not self.is_flag:
            choices += ["true", "false"]
        if not choices and str in self.kinds and re.fullmatch(r"\w+(\|\w+)+", self.metavar):
            return tuple(self.metavar.split("|"))
        return tuple(choices)

    @property
    def description(self) -> str:
        """One line, however it was wrapped in the source."""
        return " ".join((self.field.description or "").split())

    @property
    def invocation(self) -> str:
        """The shortest name with what stands for the value, as people write it."""
        if self.is_positional:
            return self.metavar
        return f"{min(self.names, key=len)} {self.metavar}".rstrip()

    @property
    def wanted(self) -> str:
        """The value that it takes, for an error."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        for kind in self.kinds:
            if kind in (int, float):
                return ("a whole number" if kind is int else "a number") + _limits(self.field.metadata)
            number, *more = get_args(kind) or (None,)
            if float in union_members(number):
                each = _limits(get_args(number)[1].metadata) if get_origin(number) is Annotated else ""
                return f"{1 + len(more)} numbers: {self.metavar}{each and f', each{each}'}"
        return self.metavar


def _limits(metadata: Sequence[Any]) -> str:
    """The range of a number, as words that follow it; empty: any."""
    words = (("ge", "from"), ("gt", "above"), ("le", "to"), ("lt", "below"))
    found = {
        word: f"{getattr(each, name):g}" for name, word in words for each in metadata if hasattr(each, name)
    }
    if found.keys() == {"from"}:
        return f" of at least {found['from']}"
    return "".join(f" {word} {value}" for word, value in found.items())


def options_of(command: type[BaseModel]) -> dict[str, Option]:
    """The options of a command by field, beside those of the configuration, and its positional arguments."""
    options = {}
    for name, field in command.model_fields.items():
        if name == "values":
            continue
        names: tuple[str, ...] = (f"--{(field.alias or name).replace('_', '-')}",)
        shown = next((each for each in field.metadata if isinstance(each, Named | Positional)), Named())
        if isinstance(shown, Named) and shown.other_name:
            names += (shown.other_name,)
        is_flag = field.annotation is bool
        metavar = shown.metavar or ("" if is_flag else _metavar(field.annotation))
        options[name] = Option(names, field, metavar, field.default, isinstance(shown, Positional), is_flag)
    return options


def all_settings() -> list[Option]:
    """Every key of the configuration as an option."""
    return [option for _, option in settings_of(Config(scene=Scene(), train=Train()))]


def settings_of(values: BaseModel, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Option]]:
    """The keys of a configuration as options, each with its section, and with ``values`` as the defaults.

    A section that is None is left out.
    """
    sections = []
    for name, field in type(values).model_fields.items():
        here, value = (*path, name), getattr(values, name)
        if isinstance(value, BaseModel):
            sections.append((value, here))
        elif section_of(field.annotation) is None:
            spelled = f"--{dotted(here).replace('_', '-')}"
            yield dotted(path), Option((spelled,), field, _metavar(field.annotation), value)
    for section, here in sections:
        yield from settings_of(section, here)


def _metavar(annotation: Any) -> str:
    """The words of a value of this type."""
    if is_structured(annotation):
        return "YAML"
    words = []
    for kind in union_members(annotation):
        arguments = get_args(kind)
        if get_origin(kind) is Literal:
            words.append("{" + ",".join(map(str, arguments)) + "}")
        elif get_origin(kind) is tuple and arguments[-1:] == (...,):
            words.append(f"[{_metavar(arguments[0])} ...]")
        elif get_origin(kind) is tuple:
            words.append(" ".join(map(_metavar, arguments)))
        else:
            names = {type(None): "null", bool: "{true,false}"}
            words.append(names.get(kind) or getattr(kind, "__name__", str(kind)).upper())
    return "|".join(words)


_GENERAL = {name: field for field, option in options_of(GeneralOptions).items() for name in option.names}


def split_general(words: Sequence[str]) -> tuple[GeneralOptions, list[str]]:
    """The general options of a command line, and its other words."""
    given = {_GENERAL[word]: True for word in words if word in _GENERAL}
    return GeneralOptions.model_construct(None, **given), [word for word in words if word not in _GENERAL]
