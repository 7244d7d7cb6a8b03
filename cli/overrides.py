"""Configuration keys on a command line (``--backend.inertia ratios_axes``), split from a command's options.

tyro lists these options in the help; their values go through the config loader, so that a wrong one is
reported like one in a file: the option, the key, the valid values.
"""

import re
from collections.abc import Sequence
from typing import Any

from polhode.config import Config
from polhode.config.keys import annotation_at, arrange, count_of, dotted, is_structured, leaves, options_of
from polhode.errors import InputError
from polhode.yaml_files import MAX_DEPTH, MAX_KEY_LENGTH, parse_yaml

_NUMBER = re.compile(r"-(\d|\.\d|inf|nan)", re.IGNORECASE)
_NULL = ("none", "null")


def split_overrides(words: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Command-line words -> (words that are not overrides, dotted key -> value).

    Values stay text, or lists of text, which the config's types convert; lists of sections and mappings
    are one word of YAML. Dashes and underscores are the
    same in a key. Raises InputError when a value is missing.
    """
    own: list[str] = []
    overrides: dict[str, Any] = {}
    rest = list(words)
    while rest:
        word = rest.pop(0)
        path = _key_of(word)
        if path is None:
            own.append(word)
            continue
        given = [word.partition("=")[2]] if "=" in word else _take_values(path, rest)
        if not given:
            raise InputError(f"command line: {word}: a value is missing; see --help for what it takes")
        overrides[dotted(path)] = _value(path, given)
    return own, overrides


def option_names() -> list[str]:
    """Every override as it is written on the command line."""
    return ["--" + dotted(path).replace("_", "-") for path, _ in leaves(Config)]


def _key_of(word: str) -> tuple[str, ...] | None:
    if not word.startswith("--"):
        return None
    path = tuple(word[2:].partition("=")[0].replace("-", "_").split("."))
    if path[0] not in Config.model_fields:
        return None
    if len(path) > MAX_DEPTH or len(word.partition("=")[0]) > MAX_KEY_LENGTH:
        raise InputError(
            f"command line: {word[:60]}...: a key of {len(word)} characters; see --help for the keys"
        )
    return path


def _take_values(path: tuple[str, ...], rest: list[str]) -> list[str]:
    """Take the words of one value off ``rest``: as many as the type has, never another option."""
    annotation = annotation_at(Config, path)
    # A mistyped key takes all its values with it, so that the error names the key.
    count = None if annotation is None else count_of(annotation)
    given: list[str] = []
    while rest and (not rest[0].startswith("-") or _NUMBER.match(rest[0])) and len(given) != count:
        given.append(rest.pop(0))
        if given[0].lower() in _NULL or given[0].startswith("["):
            break
    return given


def _value(path: tuple[str, ...], given: list[str]) -> Any:
    annotation = annotation_at(Config, path)
    if is_structured(annotation):
        return parse_yaml(given[0], f"command line: --{dotted(path)}")
    if len(given) == 1:
        if given[0].lower() in _NULL and type(None) in options_of(annotation):
            return None
        if count_of(annotation) != 1:
            # One word for many values: '[1, 2, 3]' or '1,2,3'.
            if given[0].count("[") != given[0].count("]"):
                raise InputError(
                    f"command line: --{dotted(path)}: the brackets of {given[0][:40]!r} do not match"
                )
            given = [part for part in re.split(r"[\s,\[\]]+", given[0]) if part]
    return arrange(annotation, given)
