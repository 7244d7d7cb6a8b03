"""Pairs at their pace, in a bounded queue.

A thread reads the source ahead of the estimate. Pairs of a folder that fills wait there, on the disk. A
recorded sequence is replayed at a rate: its own speed is 1, at which it says which pairs it drops, always the
oldest that wait; 0 is as fast as it is processed, when nothing is dropped.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter, time

from polhode.pipeline.live.folder_source import Passed, SourcePair

QUEUE_PAIRS = 4
"""Pairs that wait at most."""
READ_AHEAD = 2
"""Pairs that are read ahead where the feed waits for the estimate."""
WAIT_S = 0.05


@dataclass(frozen=True)
class Arrived:
    """A pair and the time at which it came, by ``perf_counter``."""

    pair: SourcePair
    at: float


@dataclass(frozen=True)
class Dropped:
    """The time [ns] of a pair that left the full queue."""

    timestamp_ns: int


Item = Arrived | Dropped | Passed


class Feed:
    """The queue between a source and the estimate."""

    def __init__(
        self, source: Callable[[Callable[[], bool]], Iterator[SourcePair | Passed]], rate: float | None
    ) -> None:
        """source: its items until it is stopped; rate: of the replay, 0 as fast as it is processed, None: a
        folder that fills."""
        self._source, self._rate = source, rate
        self._waiting: deque[Item] = deque()
        self._changed = threading.Condition()
        self._stopped = self._ended = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="polhode-feed", daemon=True)
        self._start = perf_counter()

    def __enter__(self) -> "Feed":
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()
        self._thread.join()

    def stop(self) -> None:
        """End the reading; what waits stays."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def next(self, wait_s: float = WAIT_S) -> Item | None:
        """The next item; None: there is none yet. Raises what the source has raised."""
        with self._changed:
            if not self._waiting and not self._ended:
                self._changed.wait(wait_s)
            if self._waiting:
                item = self._waiting.popleft()
                self._changed.notify_all()
                return item
            if self._error is not None:
                raise self._error
            return None

    @property
    def ended(self) -> bool:
        """Whether nothing waits and nothing will come."""
        with self._changed:
            return self._ended and not self._waiting and self._error is None

    def _read(self) -> None:
        start, first_ns = perf_counter(), None
        try:
            for item in self._source(lambda: self._stopped):
                if isinstance(item, SourcePair) and self._rate:
                    if first_ns is None:
                        start, first_ns = perf_counter(), item.stamps_ns[0]
                    self._wait_until(start + (item.stamps_ns[0] - first_ns) * 1e-9 / self._rate)
                self._put(item)
                if self._stopped:
                    break
        except Exception as error:  # noqa: BLE001  raised where the pairs are taken
            self._error = error
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _wait_until(self, when: float) -> None:
        with self._changed:
            while not self._stopped and (left := when - perf_counter()) > 0.0:
                self._changed.wait(left)

    def _put(self, item: SourcePair | Passed) -> None:
        with self._changed:
            while not self._rate and len(self._waiting) >= READ_AHEAD and not self._stopped:
                self._changed.wait()
            if self._stopped:
                return
            self._waiting.append(item if isinstance(item, Passed) else Arrived(item, self._came_at(item)))
            pairs = [(n, each) for n, each in enumerate(self._waiting) if isinstance(each, Arrived)]
            if self._rate and len(pairs) > QUEUE_PAIRS:
                n, oldest = pairs[0]
                self._waiting[n] = Dropped(oldest.pair.stamps_ns[0])
            self._changed.notify_all()

    def _came_at(self, pair: SourcePair) -> float:
        """When a pair was there; what was before the start counts from the start."""
        if self._rate is not None:
            return perf_counter()
        return max(perf_counter() - max(time() - pair.written_s, 0.0), self._start)
