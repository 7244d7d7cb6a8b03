"""Loops compiled by numba: the cells of a field are visited in place, which arrays cannot say."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

from polhode.cache_name import named_by_constants

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile to machine code at the first call; later processes load it from numba's cache."""
    named = named_by_constants(function)
    return cast(Callable[P, T], numba.njit(cache=True, error_model="numpy")(named))
