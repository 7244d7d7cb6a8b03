"""Number of threads of BLAS, OpenMP, OpenCV and torch: one, unless the configuration sets more.

More than one thread each was 5-8 times slower on problems of this size, and workers are processes anyway. The
number also decides the rounding of large products, and so the last digits of a result.

Environment variables act on libraries that are imported later, and on processes that are started later;
threadpoolctl acts on those that are loaded already.
"""

import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)

_count = 1
"""Threads of ``single_threaded`` functions; ``limit_threads`` sets it."""
_limited = False
"""Whether a ``single_threaded`` function is running, so that those it calls need not limit again."""


def limit_threads(count: int) -> None:
    """Let each library use ``count`` threads from now on, here and in processes that this one starts."""
    global _count
    _count = count
    for variable in VARIABLES:
        os.environ[variable] = str(count)
    threadpool_limits(count)
    _limit_others(count, count)


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Let the libraries that are loaded use ``count`` threads within the block, then as many as before."""
    before = _threads_of_others()
    with threadpool_limits(count):
        _limit_others(count, count)
        try:
            yield
        finally:
            _limit_others(*before)


def single_threaded(function: Callable[P, T]) -> Callable[P, T]:
    """Run the function with one thread for each library, or with the number that ``limit_threads`` set.

    For the entry points: time and digits of the result are then independent of what was imported before this
    package, and of the environment.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        global _limited
        if _limited:
            return function(*args, **kwargs)
        _limited = True
        try:
            with limited_threads(_count):
                return function(*args, **kwargs)
        finally:
            _limited = False

    return limited


def _threads_of_others() -> tuple[int, int]:
    """Threads of OpenCV and of torch, which threadpoolctl does not know; 1 for one that is not loaded."""
    opencv, torch = sys.modules.get("cv2"), sys.modules.get("torch")
    return opencv.getNumThreads() if opencv else 1, torch.get_num_threads() if torch else 1


def _limit_others(opencv_count: int, torch_count: int) -> None:
    opencv, torch = sys.modules.get("cv2"), sys.modules.get("torch")
    if opencv and hasattr(opencv, "setNumThreads"):
        opencv.setNumThreads(opencv_count)
    if torch and hasattr(torch, "set_num_threads"):
        torch.set_num_threads(torch_count)
