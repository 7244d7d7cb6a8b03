"""One function applied to many items: by parallel processes, in order and with bounded memory, or by one
process beside this one.

The processes end with their parent, even if it is killed and whatever they are doing; they leave interrupts
to it and use one thread each. They do not import the caller's script, so that it needs no guard
(``if __name__ == "__main__"``), unless the work itself is defined there.
"""

import contextlib
import logging
import multiprocessing
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache, partial
from multiprocessing.connection import wait as wait_for_end
from multiprocessing.context import BaseContext
from types import ModuleType
from typing import Any, Generic, TypeVar

from polhode.runtime import parent_death
from polhode.runtime.errors import RunFailure
from polhode.runtime.interrupts import SIGNALS, interrupts_delayed, interrupts_kept
from polhode.runtime.threads import limit_threads, limited_threads

T = TypeVar("T")
U = TypeVar("U")

WAITING_PER_WORKER = 3
"""Items per process that are submitted or whose results are not yet taken."""
BACKGROUND_NICENESS = 10
"""Of a process beside this one: it leaves the processor to what is waited for."""

_log = logging.getLogger(__name__)
_pools: list[ProcessPoolExecutor] = []
"""Those at work."""


def worker_count(workers: int) -> int:
    """Parallel processes for ``runtime.workers``: 0 means one per core that this process may use."""
    return workers or len(os.sched_getaffinity(0))


def in_order(
    work: Callable[[T], U], items: Sequence[T], workers: int, preload: Sequence[str] = ()
) -> Iterator[U]:
    """Yield ``work(item)`` for each item, in the order of the items, whatever the number of workers.

    ``work`` must be picklable; every process receives it once. With one worker or one item, or where no
    process can be started, as in a worker process of the caller (a warning says so), it is called here.
    ``preload`` names modules that every process will need. Raises what ``work`` raises, after the results of
    the items before, and RunFailure when a process is killed. After an error, items in progress are finished
    and no others are started; an interrupt ends all.
    """
    if workers > 1 and len(items) > 1:
        try:
            pool, first = _begun(work, items[0], min(workers, len(items)), preload)
        except OSError as error:
            log_without_processes(error)
        else:
            yield from _results(pool, first, items[1:], workers)
            return
    for item in items:
        with limited_threads(1):
            result = work(item)
        yield result


def start_server(modules: Sequence[str], workers: int) -> None:
    """Let the server of the workers import ``modules`` while this process goes on; workers then need not.

    For the beginning of a command that takes seconds. Does nothing where there will be no workers, where the
    system has no such server, or after it has started.
    """
    if workers > 1 and not multiprocessing.current_process().daemon:
        # Where it cannot be started, the first work says so.
        with contextlib.suppress(OSError), _signals_blocked(), _script_hidden(start_server):
            if _context(modules).get_start_method() == "forkserver":
                multiprocessing.forkserver.ensure_running()


class Background(Generic[T, U]):
    """One process beside this one that works on items in their order, at a low priority.

    ``work`` is called in that process alone, and may therefore keep there what it has found.
    """

    def __init__(
        self, work: Callable[[T], U], preload: Sequence[str] = (), niceness: int = BACKGROUND_NICENESS
    ) -> None:
        """Raises OSError where there can be no process."""
        self._pool: ProcessPoolExecutor | None = _pool(work, 1, preload, niceness)
        self._submitted: list[Future[U]] = []
        _pools.append(self._pool)

    def submit(self, item: T) -> "Future[U] | None":
        """What will be the result; None: the process is gone, and nothing more will be done."""
        if self._pool is None:
            return None
        try:
            # the process is started by the first item, which signals must not interrupt
            submit = self._pool.submit if self._submitted else None
            future = submit(_call, item) if submit is not None else _submitted(self._pool, item)
        except (_ServerLost, BrokenProcessPool):
            self.close()
            return None
        self._submitted.append(future)
        return future

    def close(self, kill: bool = False) -> None:
        """Give up what has not begun. What has begun ends soon, or with this process; ``kill``: at once."""
        if self._pool is not None:
            _pools.remove(self._pool)
            if kill:
                _kill(self._pool)
            # Not by cancel_futures alone: the pool forgets that when nothing refers to it any more.
            for future in self._submitted:
                future.cancel()
            self._submitted.clear()
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def worker_killed(what: str = "a worker process") -> RunFailure:
    """What a run ends with when a process that works for it is killed."""
    return RunFailure(f"{what} was killed, perhaps for lack of memory: use fewer --runtime.workers")


@cache
def _warn_once(warning: str) -> None:
    _log.warning(warning)


def log_without_processes(error: OSError) -> None:
    """Say, once, that the work is done by this process alone, because no other can be started."""
    _warn_once(f"no parallel processes can be started ({error}): the work is done by one, more slowly")


def kill_workers() -> None:
    """End all workers of this process at once; what waits for them then ends with an error."""
    for pool in list(_pools):
        _kill(pool)


def _kill(pool: ProcessPoolExecutor) -> None:
    for process in list((pool._processes or {}).values()):
        process.kill()


def _pool(work: Any, workers: int, preload: Sequence[str], niceness: int = 0) -> ProcessPoolExecutor:
    """Processes that will call ``work``. Raises OSError where there can be none."""
    if multiprocessing.current_process().daemon:
        raise OSError("a worker process may have none of its own")
    modules = {getattr(part, "__module__", None) or type(part).__module__ for part in _parts(work)}
    # The tracker of shared resources, which starts here, must not end by SIGHUP.
    with _signals_blocked():
        context = _context((*preload, *(modules - {"__main__", "builtins"})))
        return ProcessPoolExecutor(workers, context, _begin, (work, niceness))


def _parts(work: Any) -> list[Any]:
    """A function and what it is given."""
    if not isinstance(work, partial):
        return [work]
    return [part for each in (work.func, *work.args, *work.keywords.values()) for part in _parts(each)]


def _begun(
    work: Callable[[T], U], item: T, workers: int, preload: Sequence[str]
) -> tuple[ProcessPoolExecutor, Future[Any]]:
    """A pool that works on the first item. Raises OSError where there can be none, and RunFailure.

    If the fork server was killed during earlier work, and its end is noticed only now, another is started.
    A process that is being killed refuses connections before the system reports its end: hence the pauses.
    """
    for pause_s in (0.02, 0.1, 0.5):
        pool = _pool(work, workers, preload)
        try:
            return pool, _submitted(pool, item)
        except _ServerLost:
            pool.shutdown(cancel_futures=True)
        time.sleep(pause_s)
    raise worker_killed("the process that starts the workers")


def _results(
    pool: ProcessPoolExecutor, first: Future[Any], items: Sequence[T], workers: int
) -> Iterator[Any]:
    """Results of the first item, which is submitted, and of the others, in order."""
    waiting: deque[Future[Any]] = deque([first])
    _pools.append(pool)
    try:
        for item in items:
            waiting.append(_submitted(pool, item))
            if len(waiting) > WAITING_PER_WORKER * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except (BrokenProcessPool, _ServerLost) as error:
        # The others ignore the signal by which the pool would end them.
        _kill(pool)
        is_server = isinstance(error, _ServerLost)
        raise worker_killed(*(["the process that starts the workers"] if is_server else [])) from None
    except KeyboardInterrupt:
        _kill(pool)
        raise
    except GeneratorExit:
        # Python may call this itself, when nobody asks for more: an interrupt would be printed, and lost.
        with interrupts_kept():
            pool.shutdown(cancel_futures=True)
        raise
    finally:
        _pools.remove(pool)
        pool.shutdown(cancel_futures=True)


class _ServerLost(Exception):
    """The fork server ended while it was to start a worker."""


def _submitted(pool: ProcessPoolExecutor, item: Any) -> Future[Any]:
    """Submit an item; a worker is started where one is missing. Raises _ServerLost."""
    try:
        with _signals_blocked(), _script_hidden(pool._initargs[0]):
            return pool.submit(_call, item)
    except (EOFError, ConnectionError) as error:
        raise _ServerLost from error


def _context(preload: Sequence[str]) -> BaseContext:
    """Forks of a server that has imported the libraries and does nothing else, where that is supported.

    A plain fork beside the threads of torch or embree can hang, and a spawned process spends seconds on its
    imports, at each stage of a run.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    # Takes effect until the server starts; later calls change nothing.
    context.set_forkserver_preload([parent_death.__name__, "__main__", *preload])
    return context


@contextlib.contextmanager
def _script_hidden(work: Callable[..., Any]) -> Iterator[None]:
    """Processes that are started in the block do not import the caller's script, unless the work needs it."""
    script = sys.modules["__main__"]
    if not _needs_script(work):
        sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _needs_script(work: Any) -> bool:
    """Whether a function, or what it is given, is defined in the caller's script."""
    held = [each for part in _parts(work) for each in (part, *getattr(part, "__dict__", {}).values())]
    return any("__main__" in (getattr(each, "__module__", ""), type(each).__module__) for each in held)


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Processes that are started in the block see no interrupts; this one sees them when the block ends.

    Nor do they look for modules in the current folder, which may be another person's: Python starts them as
    ``python -c``, which would put that folder first.
    """
    safe_path = os.environ.get("PYTHONSAFEPATH")
    with interrupts_delayed():
        os.environ["PYTHONSAFEPATH"] = "1"
        previous = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        # The tracker of shared resources lets interrupts through again when it has started: hence before the
        # server of the workers, which would print a traceback if one came while it imports.
        multiprocessing.resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        if threading.current_thread() is threading.main_thread():
            os.environ[parent_death.PARENT] = str(os.getpid())
        try:
            yield
        finally:
            os.environ.pop(parent_death.PARENT, None)
            os.environ.pop("PYTHONSAFEPATH")
            if safe_path is not None:
                os.environ["PYTHONSAFEPATH"] = safe_path
            signal.pthread_sigmask(signal.SIG_SETMASK, previous)


_work: Callable[[Any], Any] | None = None
"""The function that this process applies to each item."""


def _begin(work: Callable[[Any], Any], niceness: int) -> None:
    global _work
    _work = work
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    limit_threads(1)
    os.nice(niceness)
    parent_death.end_with_parent(os.getppid())
    threading.Thread(target=_end_with_main_process, daemon=True).start()


def _call(item: Any) -> Any:
    assert _work is not None
    return _work(item)


def _end_with_main_process() -> None:
    """For what ``end_with_parent`` does not cover: other systems, and a fork server that outlives its own."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_end([parent.sentinel])
        os._exit(1)
