"""``polhode completion``: a script that lets the shell complete commands, options and their values.

The script holds all words, so that a press of TAB starts no Python.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from polhode.cli.answer import Answer
from polhode.cli.options import (
    Command,
    ConfiguredCommand,
    GeneralOptions,
    Option,
    Positional,
    all_settings,
    options_of,
)

Shell = Literal["bash", "zsh"]


class CompletionCommand(Command):
    """Print a script that completes commands, options and values in the shell (docs/command_line.md).

    In ~/.bashrc or ~/.zshrc: source <(polhode completion bash), or zsh.
    """

    shell: Annotated[Shell, Positional("bash|zsh")]
    """For which shell."""

    def execute(self) -> Answer:
        """Make the script."""
        from polhode.cli.main import COMMANDS

        return Answer(completion_script(self.shell, COMMANDS))


BASH = """\
_polhode() {{
  local cur="${{COMP_WORDS[COMP_CWORD]}}" prev="${{COMP_WORDS[COMP_CWORD-1]}}" words="" keys=""
  COMPREPLY=()
  if (( COMP_CWORD == 1 )); then
    words="{commands} --help --version"
  else
    case "${{COMP_WORDS[1]}} $prev" in
{values}
    esac
    if [[ -z "$words" && "$cur" == -* ]]; then
      keys="{keys}"
      case "${{COMP_WORDS[1]}}" in
{options}
      esac
    fi
  fi
  [[ -n "$words" ]] && COMPREPLY=($(compgen -W "$words" -- "$cur"))
}}
complete -o default -F _polhode polhode"""
"""Where there is no word to offer, the shell completes file names."""


def completion_script(shell: Shell, commands: Mapping[str, type[Command]]) -> str:
    """The script for these commands."""
    values, options = [], []
    for name, command in commands.items():
        own = options_of(command).values()
        for option in own:
            if option.choices:
                before = [name] if option.is_positional else option.names
                pattern = "|".join(f'"{name} {each}"' for each in before)
                values.append(f'      {pattern}) words="{" ".join(option.choices)}" ;;')
        more = " $keys" if issubclass(command, ConfiguredCommand) else ""
        words = _words([*own, *options_of(GeneralOptions).values()])
        options.append(f'        {name}) words="{words} -h --help{more}" ;;')
    for option in all_settings():
        if option.choices:
            values.append(f'      *" {option.names[0]}") words="{" ".join(option.choices)}" ;;')
    lines = {"values": "\n".join(values), "options": "\n".join(options)}
    start = "#compdef polhode\nautoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return start + BASH.format(commands=" ".join(commands), keys=_words(all_settings()), **lines)


def _words(options: Iterable[Option]) -> str:
    return " ".join(name for option in options if not option.is_positional for name in option.names)
