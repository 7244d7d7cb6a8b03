"""The same job on many frames, over processes, results in order and memory bounded."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.context import BaseContext
from typing import Any, TypeVar

import cv2

Result = TypeVar("Result")

PRELOADED = (
    "__main__",
    "polhode.frontend.extract",
    "polhode.frontend.matching.pairs",
    "polhode.frontend.tracks.track_refinement",
    "polhode.frontend.features.surface_features",
    "polhode.frontend.matching.softmax_matcher",
    "polhode.frontend.disparity.network",
)
"""Modules that the frames' jobs need."""

_job: Callable[[int], Any] | None = None


def in_order(job: Callable[[int], Result], count: int, workers: int) -> Iterator[Result]:
    """Yield job(0), job(1), ..., job(count - 1); at most a few results wait in memory.

    ``job`` must be picklable; each worker receives it once. One worker: no process is started.
    """
    if workers <= 1 or count <= 1:
        _one_thread_each()
        yield from (job(k) for k in range(count))
        return
    waiting: deque[Future[Result]] = deque()
    with ProcessPoolExecutor(workers, _context(), _install, (job,)) as pool:
        for k in range(count):
            waiting.append(pool.submit(_call, k))
            if len(waiting) > 3 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _context() -> BaseContext:
    """Forks of a server that has imported the libraries and does nothing else, where there are any: a fork
    beside torch's threads can hang, and a spawned process imports for seconds, at each of a run's stages."""
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    # Before the server starts; later calls change nothing.
    context.set_forkserver_preload([*PRELOADED])
    return context


def _install(job: Callable[[int], object]) -> None:
    global _job
    _job = job
    _one_thread_each()


def _one_thread_each() -> None:
    """The frames are spread over the cores already."""
    cv2.setNumThreads(1)


def _call(k: int) -> Any:
    assert _job is not None
    return _job(k)
