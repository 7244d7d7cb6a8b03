"""``polhode completion``: a script that lets the shell complete commands, options and their values.

The script holds all words, so that a press of TAB starts no Python.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Literal

from polhode.cli.answer import Answer
from polhode.cli.options import (
    Command,
    ConfiguredCommand,
    GeneralOptions,
    Option,
    Positional,
    options_of,
    settings_of,
)
from polhode.config import Config, Scene, Train

Shell = Literal["bash", "zsh", "fish"]


class CompletionCommand(Command):
    """Print a script that completes commands, options and values in the shell (docs/command_line.md).

    In ~/.bashrc or ~/.zshrc: source <(polhode completion bash), or zsh. In ~/.config/fish/config.fish: source
    (polhode completion fish | psub).
    """

    shell: Annotated[Shell, Positional("bash|zsh|fish")]
    """For which shell."""

    def execute(self) -> Answer:
        """Make the script."""
        from polhode.cli.main import COMMANDS

        return Answer(completion_script(self.shell, COMMANDS))


def completion_script(shell: Shell, commands: Mapping[str, type[Command]]) -> str:
    """The script for these commands."""
    if shell == "fish":
        return "\n".join(_fish(commands))
    start = "#compdef polhode\nautoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    return start + _bash(commands)


def configuration_options() -> list[Option]:
    """The keys of the configuration as options."""
    return [option for _, option in settings_of(Config(scene=Scene(), train=Train()))]


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


def _bash(commands: Mapping[str, type[Command]]) -> str:
    general, keys = options_of(GeneralOptions).values(), configuration_options()
    values, options = [], []
    for name, command in commands.items():
        own = options_of(command).values()
        for option in own:
            if option.choices:
                before = [name] if option.is_positional else option.names
                pattern = "|".join(f'"{name} {each}"' for each in before)
                values.append(f'      {pattern}) words="{" ".join(option.choices)}" ;;')
        more = " $keys" if issubclass(command, ConfiguredCommand) else ""
        options.append(f'        {name}) words="{_words([*own, *general])} -h --help{more}" ;;')
    for option in keys:
        if option.choices:
            values.append(f'      *" {option.names[0]}") words="{" ".join(option.choices)}" ;;')
    found = {"commands": " ".join(commands), "keys": _words(keys)}
    return BASH.format(**found, values="\n".join(values), options="\n".join(options))


def _fish(commands: Mapping[str, type[Command]]) -> Iterator[str]:
    yield f'complete -c polhode -f -n __fish_use_subcommand -a "{" ".join(commands)}"'
    configured = [name for name, command in commands.items() if issubclass(command, ConfiguredCommand)]
    for names, options in (
        ([], options_of(GeneralOptions).values()),
        *(([name], options_of(command).values()) for name, command in commands.items()),
        (configured, configuration_options()),
    ):
        condition = f'-n "__fish_seen_subcommand_from {" ".join(names)}"' if names else ""
        for option in options:
            words = ["complete -c polhode", condition]
            if not option.is_positional:
                words += [
                    f"-l {each[2:]}" if each.startswith("--") else f"-s {each[1:]}" for each in option.names
                ]
                words += [] if option.is_flag else ["-r"]
            if option.choices:
                words.append(f'-f -a "{" ".join(option.choices)}"')
            yield " ".join(filter(None, words))


def _words(options: Iterable[Option]) -> str:
    return " ".join(name for option in options if not option.is_positional for name in option.names)
