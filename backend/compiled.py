"""Just-in-time compilation, kept on disk between runs, typed."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

from polhode.cache_name import named_by_constants

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile to machine code at the first call; later processes load it from numba's cache."""
    return cast(Callable[P, T], numba.njit(cache=True)(named_by_constants(function)))


def fused(function: Callable[P, T]) -> Callable[P, T]:
    """The same, products added without rounding between: for loops that do nothing else."""
    return cast(Callable[P, T], numba.njit(cache=True, fastmath={"contract"})(named_by_constants(function)))
