"""Work spread over processes that end with their parent and leave Ctrl-C to it."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import TypeVar

from polhode.errors import RunFailure

T = TypeVar("T")
U = TypeVar("U")


def in_processes(
    work: Callable[[T], U],
    items: Sequence[T],
    workers: int,
    done: Callable[[U], None],
    prepare: Callable[..., None] | None = None,
    arguments: tuple[object, ...] = (),
) -> None:
    """Call ``done(work(item))`` for each item, in order; ``work`` runs in one of ``workers`` processes.

    ``prepare(*arguments)`` is called once in each. Raises what ``work`` raises, and RunFailure when a process
    is killed. After an error or an interrupt, what has begun is finished and the rest is not begun.
    """
    # Spawned, not forked: embree's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(items)), context, _begin, (prepare, arguments))
    try:
        with _interrupts_held():
            results = pool.map(work, items)
        for result in results:
            done(result)
    except BrokenProcessPool:
        raise RunFailure(
            "a process was killed, perhaps for want of memory: use fewer --runtime.workers"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes that are started in the block never see Ctrl-C; this one sees it when the block ends."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _begin(prepare: Callable[..., None] | None, arguments: tuple[object, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare(*arguments)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
