"""Errors of the library name its arguments, where those of the program name the options of a command.

Both come from the same code, which writes ``--horizon 0: give ...`` for the command line. A caller of the
library reads ``horizon=0: give ...``; a setting such as ``--runtime.workers`` is ``runtime.workers``.
"""

import functools
import inspect
import re
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import ParamSpec, TypeVar

from polhode.runtime.errors import InputError, RunFailure

P = ParamSpec("P")
T = TypeVar("T")

_OPTION = re.compile(
    r"(?<![\w-])(?P<option>--[a-z][a-z0-9_.-]*[a-z0-9]|-o\b)"
    r"(?: (?P<value>[-+]?(?:\d[\d.]*(?:e[-+]?\d+)?|inf|nan)|\w+)(?=[\s,;:.)]|$))?"
)


def errors_name_arguments(
    options: Mapping[str, str] | None = None,
    words: Mapping[str, str] | None = None,
    further: Collection[str] = (),
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function of the library: its errors name its arguments.

    Args:
        options: arguments by the options that are called otherwise ({"-o": "output"}).
        words: texts in Python by the values of options that stand for them ({"inertial": "N"}).
        further: arguments that the signature does not list, as they are passed on.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        parameters = inspect.signature(function).parameters
        flags = {name for name, each in parameters.items() if each.default is False}
        arguments = {f"--{name.replace('_', '-')}": name for name in (*parameters, *further)}
        arguments |= {"-o": "output"} | dict(options or {})

        @functools.wraps(function)
        def named(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return function(*args, **kwargs)
            except (InputError, RunFailure) as error:
                changed = in_words_of_python(str(error), arguments, flags, words or {})
                if changed == str(error):
                    raise
                raise type(error)(changed) from error

        return named

    return decorate


def in_words_of_python(
    text: str, arguments: Mapping[str, str], flags: Collection[str], words: Mapping[str, str]
) -> str:
    """The text with every option that has an argument, or is a setting, called by that name.

    arguments: by option; flags: those that are True where the option is given; words: values of options.
    """

    def renamed(match: re.Match[str]) -> str:
        option, value = match["option"], match["value"]
        after = "" if value is None else f" {value}"
        if "." in option:
            return option[2:].replace("-", "_") + after
        name = arguments.get(option)
        if name is None:
            return match[0]
        if value in words:
            return f"{name}={words[value]!r}"
        with suppress(TypeError, ValueError):
            float(value)
            return f"{name}={value}"
        return f"{name}=True{after}" if name in flags else name + after

    return _OPTION.sub(renamed, text)
