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
    start = ["#compdef polhode", "autoload -U +X bashcompinit && bashcompinit"] if shell == "zsh" else []
    return "\n".join([*start, *_bash(commands)])


def configuration_options() -> list[Option]:
    """The keys of the configuration as options."""
    return [option for _, option in settings_of(Config(scene=Scene(), train=Train()))]


def _bash(commands: Mapping[str, type[Command]]) -> Iterator[str]:
    general, keys = options_of(GeneralOptions).values(), configuration_options()
    yield "_polhode() {"
    yield '  local cur="${COMP_WORDS[COMP_CWORD]}" prev="${COMP_WORDS[COMP_CWORD-1]}" words="" keys=""'
    yield "  COMPREPLY=()"
    yield "  if (( COMP_CWORD == 1 )); then"
    yield f'    words="{" ".join([*commands, "--help", "--version"])}"'
    yield "  else"
    yield '    case "${COMP_WORDS[1]} $prev" in'
    for name, command in commands.items():
        for option in options_of(command).values():
            if option.choices and not option.is_positional:
                pattern = "|".join(f'"{name} {each}"' for each in option.names)
                yield f'      {pattern}) words="{" ".join(option.choices)}" ;;'
            if option.choices and option.is_positional:
                yield f'      "{name} {name}") words="{" ".join(option.choices)}" ;;'
    for option in keys:
        if option.choices:
            yield f'      *" {option.names[0]}") words="{" ".join(option.choices)}" ;;'
    yield "    esac"
    yield '    if [[ -z "$words" && "$cur" == -* ]]; then'
    yield f'      keys="{_words(keys)}"'
    yield '      case "${COMP_WORDS[1]}" in'
    for name, command in commands.items():
        more = " $keys" if issubclass(command, ConfiguredCommand) else ""
        words = _words([*options_of(command).values(), *general])
        yield f'        {name}) words="{words} -h --help{more}" ;;'
    yield "      esac"
    yield "    fi"
    yield "  fi"
    yield '  [[ -n "$words" ]] && COMPREPLY=($(compgen -W "$words" -- "$cur"))'
    yield "}"
    # where there is no word to offer, the shell completes file names
    yield "complete -o default -F _polhode polhode"


def _fish(commands: Mapping[str, type[Command]]) -> Iterator[str]:
    yield f'complete -c polhode -f -n __fish_use_subcommand -a "{" ".join(commands)}"'
    for option in options_of(GeneralOptions).values():
        yield _fish_line("", option)
    for name, command in commands.items():
        condition = f'-n "__fish_seen_subcommand_from {name}"'
        for option in options_of(command).values():
            yield _fish_line(condition, option)
    configured = " ".join(
        name for name, command in commands.items() if issubclass(command, ConfiguredCommand)
    )
    for option in configuration_options():
        yield _fish_line(f'-n "__fish_seen_subcommand_from {configured}"', option)


def _fish_line(condition: str, option: Option) -> str:
    words = ["complete -c polhode", condition]
    if not option.is_positional:
        words += [f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in option.names]
    if not option.is_flag and not option.is_positional:
        words.append("-r")
    if option.choices:
        words.append(f'-f -a "{" ".join(option.choices)}"')
    return " ".join(filter(None, words))


def _words(options: Iterable[Option]) -> str:
    return " ".join(name for option in options if not option.is_positional for name in option.names)
