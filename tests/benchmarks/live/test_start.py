"""The benchmark of the start counts what numba compiles, once each."""

from typing import Any

import numba
from numba.core import event

from benchmarks.live.start import CompileTimes


def test_nested_compilations_count_in_the_outer_one() -> None:
    njit: Any = numba.njit

    def inner(x: float) -> float:
        return x + 1.0

    inner_compiled = njit(inner)

    def outer(x: float) -> float:
        return 2.0 * float(inner_compiled(x))

    outer_compiled = njit(outer)
    times = CompileTimes()
    with event.install_listener("numba:compile", times):
        assert outer_compiled(1.0) == 4.0
        assert outer_compiled(2.0) == 6.0
    (name,) = times.seconds
    assert name.endswith("outer")
    assert times.seconds[name] > 0.0
