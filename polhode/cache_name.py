"""Names for compiled functions that are kept on disk: other constants, another name.

Numba freezes a module's constants into the machine code, but looks only at the function's own file to tell
whether what it kept is stale. A constant that comes from another module would stay as it was.
"""

import hashlib
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import ParamSpec, TypeVar, cast

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


def named_by_constants(function: Callable[P, T]) -> Callable[P, T]:
    """The same function; its qualified name, and so its file in the cache, ends with a digest of what
    it reads of its module: numbers, strings, tuples of them, arrays, and other compiled functions.

    Constants read as attributes of a module (``blocks.EDGE``) are not seen: import them by name.
    """
    plain = cast(FunctionType, function)
    read = [
        f"{name}={_content(plain.__globals__[name])}"
        for name in plain.__code__.co_names
        if name in plain.__globals__
    ]
    digest = hashlib.sha256("\n".join(read).encode()).hexdigest()[:12]
    plain.__qualname__ = f"{plain.__qualname__}-{digest}"
    return function


def _content(value: object) -> str:
    """What a frozen global means to the machine code; modules and types do not change."""
    if isinstance(value, (bool, int, float, str, np.generic)):
        return repr(value)
    if isinstance(value, tuple):
        return f"({','.join(_content(part) for part in value)})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    inner = getattr(value, "py_func", None)
    if isinstance(inner, FunctionType):
        code = inner.__code__
        constants = [repr(part) for part in code.co_consts if not isinstance(part, CodeType)]
        return f"{inner.__qualname__}{code.co_code.hex()}{constants}"
    return ""
