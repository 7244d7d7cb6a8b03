"""Help: the commands in groups; of a command the common options first, then the others by topic.

``-h`` shows the common options, ``--help`` all of them with the keys of the configuration.
"""

import inspect
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console, Group
from rich.padding import Padding
from rich.panel import Panel
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from polhode.cli.options import Command, ConfiguredCommand, GeneralOptions, Option, options_of, settings_of

MIN_WIDTH, MAX_WIDTH = 40, 100
"""Of the overview [columns]; the help of a command is as wide as the terminal, and no narrower"""


def overview(description: str, groups: Mapping[str, Sequence[str]], commands: Mapping[str, type]) -> str:
    """The text of ``polhode --help``: each command with the first sentence of its docstring."""
    width = min(_columns(), MAX_WIDTH)
    more = "polhode COMMAND -h shows the common options of a command, polhode COMMAND --help all of them."
    lines = [
        "usage: polhode COMMAND [OPTIONS]",
        "",
        *textwrap.wrap(description, width),
        *textwrap.wrap(more, width),
    ]
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


def print_help(name: str, command: type[Command], everything: bool) -> None:
    """Print the help of a command: its common options, or ``everything``."""
    print(_introduction(name, command, everything), end="\n\n")
    console = Console(file=sys.stdout, width=_columns(), highlight=False)
    for panel in _panels(command, everything):
        console.print(panel)


def _introduction(name: str, command: type[Command], everything: bool) -> str:
    """What stands above the options: usage, description and examples, as wide as the terminal."""
    width, usage = _columns(), f"usage: polhode {name} "
    paragraphs = [
        textwrap.fill(_usage_words(command), width, initial_indent=usage, subsequent_indent=8 * " ")
    ]
    description = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    is_configured = issubclass(command, ConfiguredCommand)
    if not everything and (command.GROUPS or is_configured):
        also = ", and the configuration" if is_configured else ""
        description.append(f"These are the common options; polhode {name} --help shows all{also}.")
    paragraphs += [textwrap.fill(" ".join(each.split()), width) for each in description]
    if command.EXAMPLES:
        lines = ["examples:"]
        for line, effect in command.EXAMPLES:
            indent = 6 * " "
            lines += [
                f"  {line}",
                textwrap.fill(effect, width, initial_indent=indent, subsequent_indent=indent),
            ]
        paragraphs.append("\n".join(lines))
    return "\n\n".join(paragraphs)


def _usage_words(command: type[Command]) -> str:
    """Arguments and required options, in brackets what may be left out."""
    options = options_of(command).values()
    words = [each.metavar if each.required else f"[{each.metavar}]" for each in options if each.is_positional]
    words += [each.invocation for each in options if each.required and not each.is_positional]
    return " ".join([*words, "[OPTIONS]"])


def _columns() -> int:
    return max(MIN_WIDTH, shutil.get_terminal_size().columns)


def _panels(command: type[Command], everything: bool) -> Iterator[Panel]:
    """The options in boxes."""
    options = options_of(command)
    rare = {field for fields in command.GROUPS.values() for field in fields}
    arguments = [each for each in options.values() if each.is_positional]
    if arguments:
        yield _panel("positional arguments", [_row(each) for each in arguments])
    common = [each for field, each in options.items() if field not in rare and not each.is_positional]
    of_help = (Text("-h, --help", "bold"), "show this help message and exit")
    yield _panel("options", [of_help, *(_row(each) for each in common)])
    if everything:
        for title, fields in command.GROUPS.items():
            yield _panel(f"{title} options", [_row(options[field]) for field in fields])
    general = [_row(each) for each in options_of(GeneralOptions).values()]
    yield _panel("general options", general, GeneralOptions.__doc__)
    if everything and issubclass(command, ConfiguredCommand):
        values = command.model_fields["values"].default
        sections: dict[str, list[Option]] = {}
        for section, option in settings_of(values):
            sections.setdefault(section, []).append(option)
        for section, settings in sections.items():
            about: Any = values
            for step in filter(None, section.split(".")):
                about = getattr(about, step)
            title = f"{section.replace('_', '-') or 'configuration'} options"
            yield _panel(title, [_row(each) for each in settings], about.__doc__ if section else None, 6)


def _row(option: Option) -> tuple[Text, str]:
    """How an option is given, and what it is."""
    value = f" {option.metavar}" if option.metavar and not option.is_positional else ""
    names = [option.metavar] if option.is_positional else sorted(option.names, key=len)
    invocation = Text(", ").join(Text.assemble((each, "bold"), value) for each in names)
    default = option.default
    if isinstance(default, tuple | list):
        default = " ".join(map(str, default)) or "none"
    return invocation, f"{option.description} ({'required' if option.required else f'default: {default}'})"


def _panel(
    title: str, rows: Sequence[tuple[Text, str]], about: str | None = None, indent: int | None = None
) -> Panel:
    """A box of options; one that is longer than the indentation stands on a line of its own."""
    indent = indent or 2 + max((len(each) for each, _ in rows if len(each) <= 20), default=4)
    lines: list[Any] = [] if about is None else [Text(" ".join(about.split())), Rule(style="dim")]
    for invocation, description in rows:
        if len(invocation) + 2 > indent:
            lines += [invocation, Padding(Text(description), (0, 0, 0, indent))]
        else:
            table = Table.grid()
            table.add_column(width=indent)
            table.add_column()
            table.add_row(invocation, Text(description))
            lines.append(table)
    return Panel(Group(*lines), title=title, title_align="left", border_style="dim", padding=(0, 1))
