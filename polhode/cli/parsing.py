"""The words of a command line as a command and the keys of the configuration; mistakes become one line.

Values of keys go through the loader of the configuration, so that a wrong one is reported as in a file.
"""

import re
from collections.abc import Sequence
from typing import Any, TypeVar, get_args, get_origin

from pydantic import ValidationError

from polhode.cli.options import Command, ConfiguredCommand, Option, all_settings, options_of
from polhode.config import Config
from polhode.config.keys import annotation_at, arrange, count_of, dotted, is_structured, suggestion
from polhode.config.keys import options_of as union_members
from polhode.files.yaml_files import MAX_DEPTH, MAX_KEY_LENGTH, parse_yaml
from polhode.runtime.errors import InputError

C = TypeVar("C", bound=Command)

_NUMBER = re.compile(r"-(\d|\.\d|inf|nan)", re.IGNORECASE)
_NULL = ("none", "null")


def parse(name: str, command: type[C], words: Sequence[str]) -> tuple[C, dict[str, Any]]:
    """The command with its options, and dotted key -> value of the configuration.

    Raises InputError for words that it does not understand, naming the option and what it takes.
    """
    try:
        return _parsed(command, words)
    except _Misunderstood as error:
        raise InputError(f"{error}; see polhode {name} --help") from None


class _Misunderstood(Exception):
    """What is wrong with the words."""


def _parsed(command: type[C], words: Sequence[str]) -> tuple[C, dict[str, Any]]:
    options = options_of(command)
    fields = {
        each: field for field, option in options.items() if not option.is_positional for each in option.names
    }
    given: dict[str, list[str]] = {}
    names: dict[str, str] = {}
    settings: dict[str, Any] = {}
    loose: list[str] = []
    rest = list(words)
    while rest:
        word = rest.pop(0)
        if not _is_option(word):
            loose.append(word)
            continue
        if word == "--":
            loose += rest
            break
        name, equals, joined = word.partition("=")
        field = fields.get(name.replace("_", "-")) or fields.get(word[:2])
        path = _key_of(name)
        if field is not None:
            option = options[field]
            if name.replace("_", "-") not in fields:  # -oDIR
                name, equals, joined = word[:2], "=", word[2:]
            names[field] = name
            given[field] = [joined] if equals else _take_values(option, rest)
            if not given[field] and not option.is_flag:
                raise _Misunderstood(f"{name}: a value is missing; give {option.wanted}")
        elif path is not None:
            of_key = [joined] if equals else _take_setting(path, rest)
            if not of_key:
                raise _Misunderstood(f"{name}: a value is missing")
            settings[dotted(path)] = _setting(path, of_key)
        else:
            known = list(fields)
            if issubclass(command, ConfiguredCommand):
                known += [each.names[0] for each in all_settings()]
            raise _Misunderstood(f"unknown option '{name}';{suggestion(name, known)}".rstrip(";"))
    for field, option in options.items():
        if option.is_positional and (option.takes_many or loose):
            count = len(loose) if option.takes_many else 1
            given[field], loose = loose[:count], loose[count:]
    if loose:
        raise _Misunderstood(f"unexpected argument '{loose[0]}'")
    lacking = [option for field, option in options.items() if option.required and field not in given]
    if lacking:
        words = [f"{each.invocation} ({_beginning(each.description)})" for each in lacking]
        raise _Misunderstood(f"{' and '.join(words)} {'is' if len(words) == 1 else 'are'} missing")
    values: dict[str, Any] = {}
    for field, found in given.items():
        values[field] = found if options[field].takes_many else found[0] if found else True
    try:
        return command.model_validate(values), settings
    except ValidationError as error:
        field = str(error.errors()[0]["loc"][0])
        wrong = " ".join([names.get(field, options[field].metavar), *given[field]])
        raise _Misunderstood(f"{wrong}: give {options[field].wanted}") from None


def _is_option(word: str) -> bool:
    return word.startswith("-") and word != "-" and not _NUMBER.match(word)


def _take_values(option: Option, rest: list[str]) -> list[str]:
    """Take the words of an option's value off ``rest``, never another option."""
    if option.is_flag:
        return []
    kinds = [kind for kind in option.kinds if get_origin(kind) is tuple]
    is_vector = any(union_members(get_args(kind)[-1]) == (float,) for kind in kinds)
    taken: list[str] = []
    while rest and not _is_option(rest[0]) and (kinds or not taken):
        # of numbers, one too many is taken as well, so that the error names the option
        if is_vector and len(taken) >= len(get_args(kinds[0])):
            try:
                float(rest[0])
            except ValueError:
                break
        taken.append(rest.pop(0))
    return taken


def _beginning(description: str) -> str:
    """What an option is, for a sentence: its description up to the first full stop, colon or bracket."""
    beginning = re.split(r"\.(?:\s|$)|:\s|\s\(", description)[0]
    is_abbreviation = beginning[:2].isupper()
    return beginning if is_abbreviation else beginning[:1].lower() + beginning[1:]


def _key_of(word: str) -> tuple[str, ...] | None:
    """The key of the configuration that an option is meant as; None: none."""
    path = tuple(word.removeprefix("--").replace("-", "_").split("."))
    if not word.startswith("--") or path[0] not in Config.model_fields:
        return None
    if len(path) > MAX_DEPTH or len(word) > MAX_KEY_LENGTH:
        raise _Misunderstood(f"{word[:60]}...: a key of {len(word)} characters")
    return path


def _take_setting(path: tuple[str, ...], rest: list[str]) -> list[str]:
    """Take the words of one value off ``rest``: as many as the type has, never another option."""
    annotation = annotation_at(Config, path)
    # A mistyped key takes all its values with it, so that the error names the key.
    count = None if annotation is None else count_of(annotation)
    given: list[str] = []
    while rest and not _is_option(rest[0]) and len(given) != count:
        given.append(rest.pop(0))
        if given[0].lower() in _NULL or given[0].startswith("["):
            break
    return given


def _setting(path: tuple[str, ...], given: list[str]) -> Any:
    """A value for the loader: text, lists of text, or None; a list of sections or a mapping is YAML."""
    annotation = annotation_at(Config, path)
    if is_structured(annotation):
        return parse_yaml(given[0], f"command line: --{dotted(path)}")
    if len(given) == 1:
        if given[0].lower() in _NULL and type(None) in union_members(annotation):
            return None
        if count_of(annotation) != 1:
            # One word for many values: '[1, 2, 3]' or '1,2,3'.
            if given[0].count("[") != given[0].count("]"):
                raise _Misunderstood(f"--{dotted(path)}: the brackets of {given[0][:40]!r} do not match")
            given = [part for part in re.split(r"[\s,\[\]]+", given[0]) if part]
    return arrange(annotation, given)
