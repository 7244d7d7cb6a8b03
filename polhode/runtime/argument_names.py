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
        arguments = {f"--{name.replace('_', '-')}": name for name in (*parameters, *further)}
        arguments |= {"-o": "output"} | dict(options or {})

        def renamed(match: re.Match[str]) -> str:
            option, value = match["option"], match["value"]
            after = "" if value is None else f" {value}"
            if "." in option:
                return option[2:].replace("-", "_") + after
            name = arguments.get(option)
            if name is None:
                return match[0]
            if words is not None and value in words:
                return f"{name}={words[value]!r}"
            with suppress(TypeError, ValueError):
                float(value)
                return f"{name}={value}"
            # a flag is True where the option is given
            is_flag = name in parameters and parameters[name].default is False
            return f"{name}=True{after}" if is_flag else name + after

        @functools.wraps(function)
        def named(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return function(*args, **kwargs)
            except (InputError, RunFailure) as error:
                changed = _OPTION.sub(renamed, str(error))
                if changed == str(error):
                    raise
                raise type(error)(changed) from error

        return named

    return decorate
