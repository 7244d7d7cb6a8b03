"""Just-in-time compilation, kept on disk between runs, typed."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile to machine code at the first call; later processes load it from numba's cache."""
    return cast(Callable[P, T], numba.njit(cache=True)(function))


def fused(function: Callable[P, T]) -> Callable[P, T]:
    """The same, products added without rounding between: for loops that do nothing else."""
    return cast(Callable[P, T], numba.njit(cache=True, fastmath={"contract"})(function))
