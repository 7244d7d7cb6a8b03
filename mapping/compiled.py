"""Loops compiled by numba: voxels are visited in place, which arrays cannot say."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile to machine code at the first call; later processes load it from numba's cache."""
    return cast(Callable[P, T], numba.njit(cache=True, fastmath={"contract"}, error_model="numpy")(function))
