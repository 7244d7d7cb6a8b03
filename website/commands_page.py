"""The page of the commands: what ``polhode COMMAND --help`` prints."""

import contextlib
import io
import os
import re
from unittest.mock import patch

from polhode.cli.main import COMMANDS, CONFIGURED, main
from polhode.config import Config

WIDTH = 96
"""Columns of the help"""


def commands_page() -> str:
    """Markdown."""
    text = (
        "# Commands\n\n"
        "What `polhode COMMAND --help` prints, made from the same types as the program itself. Every command "
        "ends with exit code 0 when its work is done, 2 after a mistake of the user, 1 when a run failed; "
        "an error is one line on standard error, and `--debug` adds the traceback.\n\n"
        "| command | what it does |\n|---|---|\n"
    )
    for name, command in COMMANDS.items():
        text += f"| [`polhode {name}`](#{name}) | {_first_sentence(command)} |\n"
    for name, command in COMMANDS.items():
        configured = issubclass(command, CONFIGURED)
        text += f"\n## {name}\n\n```text\n{_own_help(help_of(name), configured)}\n```\n"
        if configured:
            text += (
                f"\n`polhode {name} --help` also lists every key of the "
                "[configuration](configuration.md), each of which is an option.\n"
            )
    return text


def help_of(command: str) -> str:
    """The help of a command in WIDTH columns, as it is printed where standard output is no terminal."""
    printed = io.StringIO()
    with patch.dict(os.environ, {"COLUMNS": str(WIDTH)}), contextlib.redirect_stdout(printed):
        main([command, "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().rstrip().splitlines())


def _own_help(text: str, configured: bool) -> str:
    """The help without the options of the configuration."""
    if not configured:
        return text
    groups = re.split(r"\n(?= \S[^\n]*\n -{9})", text)
    own = [group for group in groups if _section_of(group) not in Config.model_fields]
    # that of no section stands among the options of the command, at their end
    return "\n\n".join(group.partition("\n  --seed ")[0].rstrip() for group in own)


def _section_of(group: str) -> str:
    """The section of the configuration that a group of options has in its title, if it is one."""
    return group.split()[0].partition(".")[0].replace("-", "_")


def _first_sentence(command: type) -> str:
    paragraph = " ".join((command.__doc__ or "").split("\n\n")[0].split())
    return paragraph.partition(". ")[0].rstrip(".") + "."
