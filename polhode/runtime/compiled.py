"""Just-in-time compilation by numba, cached on disk between runs, with constants taken into account.

Numba freezes the global constants that a function reads into the machine code, but decides by the function's
own file alone whether the copy on disk is stale: after a change of a constant that is imported from another
module, it would keep using the old value. Here, the name under which a function is stored ends with a digest
of every constant and compiled function that it reads, so that a changed constant leads to a new compilation.

The cache is a pickle with machine code, so it is kept only where no other user can write (``code_cache``).

The first function that is compiled because no copy is stored says so, once: the first run takes longer.

The variants differ in the floating-point rules that the compiler may apply; they give different bytes.
"""

import hashlib
import logging
import multiprocessing
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

from polhode.runtime.code_cache import code_cache, require_no_settings_of_numba
from polhode.runtime.progress import NOTE

require_no_settings_of_numba()

_log = logging.getLogger(__name__)
P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile at the first call; every operation is rounded, and a division by zero raises an error."""
    return _compile(function)


def compiled_inline(function: Callable[P, T]) -> Callable[P, T]:
    """As ``compiled``; the body is inserted wherever another compiled function calls it."""
    return _compile(function, inline="always")


def compiled_fused(function: Callable[P, T]) -> Callable[P, T]:
    """As ``compiled``; a product and the sum that it enters may become one fused multiply-add."""
    return _compile(function, fastmath={"contract"})


def compiled_ieee(function: Callable[P, T]) -> Callable[P, T]:
    """As ``compiled``; a division by zero gives inf or NaN (IEEE 754), so that loops need no check for it."""
    return _compile(function, error_model="numpy")


def compiled_fused_ieee(function: Callable[P, T]) -> Callable[P, T]:
    """With fused multiply-adds and with IEEE 754 division: see ``compiled_fused`` and ``compiled_ieee``."""
    return _compile(function, fastmath={"contract"}, error_model="numpy")


def compiled_reordered(function: Callable[P, T]) -> Callable[P, T]:
    """As ``compiled_fused_ieee``; sums may be taken in another order, so that loops use vector instructions.

    The order is that of the processor's vectors: the last digits differ between processors.
    """
    return _compile(function, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")


def _compile(function: Callable[P, T], **flags: Any) -> Callable[P, T]:
    plain = cast(FunctionType, function)
    plain.__qualname__ = f"{plain.__qualname__}-{_digest_of_constants(plain)}"
    source = Path(plain.__code__.co_filename)
    folder = code_cache(source)
    settings: Any = numba.config
    before = settings.CACHE_DIR
    # without a folder of its own, numba takes the one beside the module
    beside = folder == source.parent.absolute() / "__pycache__"
    settings.CACHE_DIR = "" if folder is None or beside else str(folder)
    try:
        dispatcher: Any = numba.njit(cache=folder is not None, **flags)(plain)
    finally:
        settings.CACHE_DIR = before
    if folder is not None:
        dispatcher._cache = _DispensableCache(dispatcher._cache)
    return cast(Callable[P, T], dispatcher)


class _DispensableCache:
    """Numba's cache of a function, whose failure, on a full disk for instance, costs time and not the run."""

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function that is stored; None: compile it."""
        try:
            stored = self._cache.load_overload(sig, target_context)
        except Exception:  # noqa: BLE001  whatever a damaged file leads to
            with suppress(OSError):
                self._cache.flush()
            stored = None
        if stored is None:
            _say_that_it_compiles()
        return stored

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled function, where that is possible."""
        with suppress(OSError):
            self._cache.save_overload(sig, data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)


@cache
def _say_that_it_compiles() -> None:
    # Workers would repeat it.
    if multiprocessing.parent_process() is None:
        _log.log(NOTE, "some functions are compiled now, once on this machine; it takes some seconds in all")


def _digest_of_constants(function: FunctionType) -> str:
    """Digest of the globals that the function reads, directly or as attributes of imported modules."""
    names = function.__code__.co_names
    contents = []
    for name in names:
        value = function.__globals__.get(name)
        contents.append(f"{name}={_content(value)}")
        if isinstance(value, ModuleType):
            contents += [f"{name}.{a}={_content(getattr(value, a))}" for a in names if hasattr(value, a)]
    return hashlib.sha256("\n".join(contents).encode()).hexdigest()[:12]


def _content(value: object) -> str:
    """Text that changes when the frozen value would; empty for modules, types and Python's own functions."""
    if isinstance(value, (bool, int, float, str, np.generic)):
        return repr(value)
    if isinstance(value, tuple):
        return f"({','.join(_content(part) for part in value)})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    inner = getattr(value, "py_func", None)
    if isinstance(inner, FunctionType):
        # Its qualified name ends with the digest of the constants that it reads itself.
        code = inner.__code__
        constants = [repr(part) for part in code.co_consts if not isinstance(part, CodeType)]
        return f"{inner.__qualname__}{code.co_code.hex()}{constants}"
    return ""
