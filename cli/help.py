"""Help: the commands in groups; of a command the common options first, then the others by topic.

``-h`` shows the common options, ``--help`` all of them with the keys of the configuration. tyro draws the
help of a command; it makes a group of every nested dataclass, so the classes here, which are made for their
help alone, put the fields of a command into nested ones.
"""

import dataclasses
import inspect
import re
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, cast

from tyro.conf import OmitArgPrefixes, Suppress, arg

from polhode.cli.options import (
    Command,
    ConfigValues,
    GeneralOptions,
    examples_of,
    field_names,
    groups_of,
    options_of,
)

MIN_WIDTH, MAX_WIDTH = 40, 100
"""Of the overview [columns]; the help of a command is as wide as the terminal, and no narrower"""
HIDDEN: Any = Suppress[str]
"""Type of a field that the help does not show"""
USAGE = "usage: polhode COMMAND [OPTIONS]"
MORE = "polhode COMMAND -h shows the common options of a command, polhode COMMAND --help all of them."


def overview(description: str, groups: Mapping[str, Sequence[str]], commands: Mapping[str, type]) -> str:
    """The text of ``polhode --help``: each command with the first sentence of its docstring."""
    width = min(_columns(), MAX_WIDTH)
    lines = [USAGE, "", *textwrap.wrap(description, width), *textwrap.wrap(MORE, width)]
    indent = 2 + max(map(len, commands)) + 2
    for title, names in groups.items():
        lines += ["", f"{title}:"]
        for name in names:
            summary = (commands[name].__doc__ or "").strip().partition("\n")[0]
            start = f"  {name}".ljust(indent)
            lines += textwrap.wrap(summary, width, initial_indent=start, subsequent_indent=" " * indent)
    lines += ["", "for every command:"]
    lines += ["  --quiet, -q   the last line only        --json   one JSON object on standard output"]
    lines += ["  --verbose, -v the log on standard error --debug  the traceback of an error"]
    lines += ["  --version     the version of polhode"]
    return "\n".join(lines)


def introduction(name: str, command: type[Command], everything: bool) -> str:
    """What stands above the options: usage, description and examples, as wide as the terminal."""
    width, usage = _columns(), f"usage: polhode {name} "
    paragraphs = [
        textwrap.fill(_usage_words(command), width, initial_indent=usage, subsequent_indent=8 * " ")
    ]
    description = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    if not everything and (groups_of(command) or _values_of(command) is not None):
        also = "" if _values_of(command) is None else ", and the configuration"
        description.append(f"These are the common options; polhode {name} --help shows all{also}.")
    paragraphs += [textwrap.fill(" ".join(each.split()), width) for each in description]
    if examples_of(command):
        lines = ["examples:"]
        for line, effect in examples_of(command):
            lines += [
                f"  {line}",
                textwrap.fill(effect, width, initial_indent=6 * " ", subsequent_indent=6 * " "),
            ]
        paragraphs.append("\n".join(lines))
    return "\n\n".join(paragraphs)


def _usage_words(command: type[Command]) -> str:
    """Arguments and required options, in brackets what may be left out."""
    options = options_of(command)
    arguments = [each for each in options if each.is_positional]
    words = [each.metavar if each.required else f"[{each.metavar}]" for each in arguments]
    words += [each.invocation for each in options if each.required and not each.is_positional]
    return " ".join([*words, "[OPTIONS]"])


def _columns() -> int:
    return max(MIN_WIDTH, shutil.get_terminal_size().columns)


def class_for_help(name: str, command: type[Command], everything: bool) -> type:
    """A class whose help, drawn by tyro, is that of the command; only with its common options unless
    ``everything``."""
    groups = groups_of(command)
    rare = {field for names in groups.values() for field in names}
    common = [each for each in field_names(command) if each not in rare]
    values = _values_of(command)
    parts = [_group("general", GeneralOptions)]
    if everything:
        parts = [*(_group(title, _restricted(command, names)) for title, names in groups.items()), *parts]
        if values is not None:
            # under another name, as a field of the command would keep its place before the groups
            parts.append(
                ("configuration", ConfigValues, dataclasses.field(default_factory=values.default_factory))
            )
    bases = (_restricted(command, common),)
    made = dataclasses.make_dataclass(name, parts, bases=bases, frozen=True, kw_only=True)
    made.__doc__ = ""
    return made


def _values_of(command: type[Command]) -> "dataclasses.Field[Any] | None":
    """The field of the configuration; None: the command reads none."""
    return {each.name: each for each in dataclasses.fields(cast(Any, command))}.get("values")


def _group(title: str, of: type) -> tuple[str, Any, Any]:
    """A field that tyro shows as a group of options, their names without the group's."""
    annotation = Annotated[OmitArgPrefixes[of], arg(name=title)]  # type: ignore[valid-type]
    return ("group_" + re.sub(r"\W", "_", title).lower(), annotation, dataclasses.field(kw_only=True))


def _restricted(command: type[Command], shown: Sequence[str]) -> type[Command]:
    """The command with only some of its fields in the help."""
    hidden = [each.name for each in dataclasses.fields(cast(Any, command)) if each.name not in shown]
    body: dict[str, Any] = {"__annotations__": dict.fromkeys(hidden, HIDDEN), "__doc__": ""}
    body |= {name: dataclasses.field(default=None, kw_only=True) for name in hidden}
    return dataclasses.dataclass(type(command.__name__, (command,), body), frozen=True, kw_only=True)
