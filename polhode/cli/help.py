"""Help as plain text: the commands by topic; of a command its options, and with ``--help`` the settings."""

import inspect
import shutil
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from polhode.cli.options import Command, ConfiguredCommand, GeneralOptions, Option, options_of, settings_of


def overview(description: str, topics: Mapping[str, Mapping[str, type]]) -> str:
    """The text of ``polhode --help``: each command with the first sentence of its docstring."""
    indent = 17
    more = "polhode COMMAND -h shows the options of a command, polhode COMMAND --help also the configuration."
    lines = ["usage: polhode COMMAND [OPTIONS]", "", _filled(description), _filled(more)]
    for title, commands in topics.items():
        lines += ["", f"{title}:"]
        for name, command in commands.items():
            summary = (command.__doc__ or "").strip().partition("\n")[0]
            lines.append(_filled(f"  {name}".ljust(indent) + summary, indent))
    lines += ["", "for every command:", *_rows(options_of(GeneralOptions).values())]
    return "\n".join([*lines, "  --version", "      The version of polhode."])


def command_help(name: str, command: type[Command], everything: bool) -> str:
    """The help of a command; ``everything``: with the settings of its configuration."""
    options = options_of(command).values()
    arguments = [each for each in options if each.is_positional]
    words = [each.metavar if each.required else f"[{each.metavar}]" for each in arguments]
    words += [each.invocation for each in options if each.required and not each.is_positional]
    blocks = [_filled(" ".join([f"usage: polhode {name}", *words, "[OPTIONS]"]), 8)]
    blocks += [
        _filled(" ".join(each.split())) for each in inspect.cleandoc(command.__doc__ or "").split("\n\n")
    ]
    is_configured = issubclass(command, ConfiguredCommand)
    if is_configured and not everything:
        blocks.append(_filled(f"polhode {name} --help also shows the settings of the configuration."))
    if arguments:
        blocks.append("\n".join(["arguments:", *_rows(arguments)]))
    rows = _rows(each for each in options if not each.is_positional)
    blocks.append("\n".join(["options:", "  -h, --help  show this help and exit", *rows]))
    blocks.append("\n".join(["general options:", *_rows(options_of(GeneralOptions).values())]))
    if everything and is_configured:
        values = command.model_fields["values"].default
        sections: dict[str, list[Option]] = {}
        for section, option in settings_of(values):
            sections.setdefault(section, []).append(option)
        for section, settings in sections.items():
            about: Any = values
            for step in filter(None, section.split(".")):
                about = getattr(about, step)
            title = (
                f"{section.replace('_', '-') or 'configuration'} options: {' '.join(about.__doc__.split())}"
            )
            blocks.append("\n".join([_filled(title), *_rows(settings)]))
    return "\n\n".join(blocks)


def _rows(options: Iterable[Option]) -> list[str]:
    """How each option is given, and below it what it is."""
    lines = []
    for option in options:
        value = f" {option.metavar}" if option.metavar and not option.is_positional else ""
        names = [option.metavar] if option.is_positional else sorted(option.names, key=len)
        default = option.default
        if isinstance(default, tuple | list):
            default = " ".join(map(str, default)) or "none"
        state = "required" if option.required else f"default: {default}"
        lines.append(f"  {', '.join(each + value for each in names)}")
        lines.append(_filled(f"      {option.description} ({state})", 6))
    return lines


def _filled(text: str, indent: int = 0) -> str:
    """Wrapped at the width of the terminal, the lines after the first indented."""
    width = max(40, shutil.get_terminal_size().columns)
    return textwrap.fill(
        text, width, subsequent_indent=" " * indent, break_on_hyphens=False, break_long_words=False
    )
