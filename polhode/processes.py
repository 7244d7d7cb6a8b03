"""One function applied to many items by parallel processes: results in order, memory bounded.

The processes end with their parent, leave Ctrl-C to it, and use one thread each.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as wait_for_end
from multiprocessing.context import BaseContext
from typing import Any, TypeVar

from polhode.errors import RunFailure
from polhode.threads import limit_threads, limited_threads

T = TypeVar("T")
U = TypeVar("U")

WAITING_PER_WORKER = 3
"""Items per process that are submitted or whose results are not yet taken."""


def worker_count(workers: int) -> int:
    """Parallel processes for ``runtime.workers``: 0 means one per core that this process may use."""
    return workers or len(os.sched_getaffinity(0))


def in_order(
    work: Callable[[T], U], items: Sequence[T], workers: int, preload: Sequence[str] = ()
) -> Iterator[U]:
    """Yield ``work(item)`` for each item, in the order of the items, whatever the number of workers.

    ``work`` must be picklable; every process receives it once. With one worker or one item, no process is
    started. ``preload`` names modules that every process will need. Raises what ``work`` raises, after the
    results of the items before, and RunFailure when a process is killed. After an error or an interrupt,
    items in progress are finished and no others are started.
    """
    if workers <= 1 or len(items) <= 1:
        for item in items:
            with limited_threads(1):
                result = work(item)
            yield result
    else:
        yield from _results(work, items, workers, preload, ordered=True)


def as_finished(work: Callable[[T], U], items: Sequence[T], workers: int) -> Iterator[U]:
    """Yield ``work(item)`` for each item as soon as it is finished; always in processes. See ``in_order``."""
    return _results(work, items, workers, (), ordered=False)


def _results(
    work: Callable[[T], U], items: Sequence[T], workers: int, preload: Sequence[str], ordered: bool
) -> Iterator[U]:
    waiting: deque[Future[U]] = deque()
    pool = ProcessPoolExecutor(min(workers, max(len(items), 1)), _context(preload), _begin, (work,))
    try:
        for item in items:
            with _interrupts_blocked():
                waiting.append(pool.submit(_call, item))
            if len(waiting) > WAITING_PER_WORKER * workers:
                yield from _take(waiting, ordered)
        while waiting:
            yield from _take(waiting, ordered)
    except BrokenProcessPool:
        raise RunFailure(
            "a worker process was killed, perhaps for lack of memory: use fewer --runtime.workers"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _take(waiting: deque[Future[U]], ordered: bool) -> Iterable[U]:
    """Remove the first result, or those that are finished (at least one), from the queue."""
    if ordered:
        return [waiting.popleft().result()]
    finished = wait(waiting, return_when=FIRST_COMPLETED).done
    for future in finished:
        waiting.remove(future)
    return [future.result() for future in finished]


def _context(preload: Sequence[str]) -> BaseContext:
    """Forks of a server that has imported the libraries and does nothing else, where that is supported.

    A plain fork beside the threads of torch or embree can hang, and a spawned process spends seconds on its
    imports, at each stage of a run.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    if preload:
        # Takes effect until the server starts; later calls change nothing.
        context.set_forkserver_preload(["__main__", *preload])
    return context


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes that are started in the block do not see Ctrl-C; this one sees it when the block ends."""
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


_work: Callable[[Any], Any] | None = None
"""The function that this process applies to each item."""


def _begin(work: Callable[[Any], Any]) -> None:
    global _work
    _work = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _call(item: Any) -> Any:
    assert _work is not None
    return _work(item)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_end([parent.sentinel])
        os._exit(1)
