"""The queue: at the pace that was asked for, bounded, and it says what it drops."""

from collections.abc import Callable, Iterator
from time import sleep

import numpy as np
import pytest

from polhode.pipeline.live.feed import QUEUE_PAIRS, Arrived, Dropped, Feed, Item
from polhode.pipeline.live.folder_source import Passed, SourcePair
from polhode.runtime.errors import InputError

STEP_NS = 100_000_000
GREY = np.zeros((2, 2), dtype=np.uint8)


def source(count: int) -> Callable[[Callable[[], bool]], Iterator[SourcePair | Passed]]:
    def pairs(stopped: Callable[[], bool]) -> Iterator[SourcePair | Passed]:
        for k in range(count):
            if stopped():
                return
            yield SourcePair((k * STEP_NS, k * STEP_NS), ("a", "b"), GREY, GREY, (None, None), None)

    return pairs


def drain(feed: Feed) -> list[Item]:
    found = []
    while not feed.ended:
        if (item := feed.next()) is not None:
            found.append(item)
    return found


def numbers(found: list[Item], kind: type) -> list[int]:
    return [
        (each.pair.stamps_ns[0] if isinstance(each, Arrived) else each.timestamp_ns) // STEP_NS
        for each in found
        if isinstance(each, kind) and not isinstance(each, Passed)
    ]


def test_without_a_pace_nothing_is_dropped() -> None:
    with Feed(source(30), 0.0) as feed:
        sleep(0.1)
        found = drain(feed)
    assert numbers(found, Arrived) == list(range(30)) and not numbers(found, Dropped)


def test_a_replay_keeps_its_pace() -> None:
    with Feed(source(5), 2.0) as feed:
        found = drain(feed)
    arrived = [each.at for each in found if isinstance(each, Arrived)]
    assert len(arrived) == 5
    # four steps of 0.1 s at twice the speed; a busy machine may add to them
    assert arrived[-1] - arrived[0] >= 0.19


def test_the_oldest_that_waits_is_dropped_and_named() -> None:
    with Feed(source(QUEUE_PAIRS + 3), None) as feed:
        sleep(0.5)
        found = drain(feed)
    assert numbers(found, Dropped) == [0, 1, 2]
    assert numbers(found, Arrived) == list(range(3, QUEUE_PAIRS + 3))


def test_an_error_of_the_source_arrives_after_what_came_before() -> None:
    def broken(stopped: Callable[[], bool]) -> Iterator[SourcePair | Passed]:
        yield from source(1)(stopped)
        raise InputError("data.csv line 2: no number")

    with Feed(broken, None) as feed:
        sleep(0.2)
        assert isinstance(feed.next(), Arrived)
        with pytest.raises(InputError, match="line 2"):
            feed.next(2.0)


def test_stopping_ends_it_before_its_source_ends() -> None:
    with Feed(source(10_000), 1.0) as feed:
        assert feed.next(2.0) is not None
        feed.stop()
    assert len(drain(feed)) < 10_000
