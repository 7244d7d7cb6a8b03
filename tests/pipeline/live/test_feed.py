"""Pairs on their way: what becomes of late, repeated and missing ones, and the queue before the estimate."""

from collections.abc import Callable, Iterator, Sequence
from time import sleep
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.live.arrivals import NAMED, Arrivals
from polhode.pipeline.live.feed import QUEUE_PAIRS, Arrived, Dropped, Feed
from polhode.pipeline.live.folder_source import Passed, SourcePair
from polhode.runtime.errors import InputError

STEP_NS = 100_000_000
GREY = np.zeros((2, 2), dtype=np.uint8)
Items = Iterator[SourcePair | Passed]


def test_late_pairs_are_refused_and_gaps_named_in_a_sentence_that_counts(
    caplog: pytest.LogCaptureFixture,
) -> None:
    arrivals = Arrivals()
    taken = [arrivals.accepts(stamp) for stamp in (10, 20, 15, 20, 30)]
    assert taken == [True, True, False, False, True]
    assert "15 ns" in caplog.text and "20 ns" in caplog.text
    late, same = arrivals.warnings
    assert "earlier than the pair before (1): 15 ns" in late and "the time of the pair before (1)" in same
    # a gap is named once the usual interval is known
    gaps = Arrivals()
    assert all(gaps.accepts(k * STEP_NS) for k in (0, 1, 2, 3, 4, 7, 8))
    assert gaps.warnings[0].endswith(f"{7 * STEP_NS} ns (about 2)") and len(gaps.warnings) == 1
    many = Arrivals()
    for k in range(NAMED + 3):
        many.note("dropped", f"{k} ns")
    (line,) = many.warnings
    assert f"({NAMED + 3})" in line and line.endswith(f"{NAMED - 1} ns, ...")


def source(
    count: int, broken: bool = False, written_s: Sequence[float] = ()
) -> Callable[[Callable[[], bool]], Items]:
    def pairs(stopped: Callable[[], bool]) -> Items:
        for k, at_s in zip(range(count), written_s or [0.0] * count, strict=True):
            if stopped():
                return
            yield SourcePair((k * STEP_NS, k * STEP_NS), ("a", "b"), GREY, GREY, (None, None), None, at_s)
        if broken:
            raise InputError("data.csv line 2: no number")

    return pairs


def drain(feed: Feed) -> tuple[list[int], list[int], list[Any]]:
    """Numbers of the pairs that arrived and of those that were dropped, and the former."""
    found: list[Any] = []
    while not feed.ended:
        if (item := feed.next()) is not None:
            found.append(item)
    arrived = [each for each in found if isinstance(each, Arrived)]
    dropped = [each.timestamp_ns // STEP_NS for each in found if isinstance(each, Dropped)]
    return [each.pair.stamps_ns[0] // STEP_NS for each in arrived], dropped, arrived


def test_without_a_pace_nothing_is_dropped_and_a_replay_keeps_its_pace() -> None:
    with Feed(source(30), 0.0) as feed:
        sleep(0.1)
        assert drain(feed)[:2] == (list(range(30)), [])
    with Feed(source(5), 2.0) as feed:
        _, _, arrived = drain(feed)
    # four steps of 0.1 s at twice the speed; a busy machine may add to them
    assert len(arrived) == 5 and arrived[-1].at - arrived[0].at >= 0.19


def test_pairs_on_the_disk_wait_there_and_count_from_when_they_were_written_or_from_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock_s = [50.0]
    monkeypatch.setattr("polhode.pipeline.live.feed.perf_counter", lambda: clock_s[0])
    monkeypatch.setattr("polhode.pipeline.live.feed.time", lambda: 1000.0)
    # long before the start, a second ago, and by a clock that is ahead
    feed = Feed(source(30, written_s=[0.0] * 10 + [999.0] * 10 + [1001.0] * 10), None)
    clock_s[0] = 100.0
    with feed:
        numbers, dropped, arrived = drain(feed)
    assert (numbers, dropped) == (list(range(30)), [])
    assert [each.at for each in arrived] == [50.0] * 10 + [99.0] * 10 + [100.0] * 10


def test_the_oldest_that_waits_is_dropped_and_named_stopping_ends_the_source_and_errors_arrive() -> None:
    with Feed(source(QUEUE_PAIRS + 3), 1e4) as feed:
        sleep(0.5)
        assert drain(feed)[:2] == (list(range(3, QUEUE_PAIRS + 3)), [0, 1, 2])
    with Feed(source(10_000), 1.0) as feed:
        assert feed.next(2.0) is not None
        feed.stop()
    assert len(drain(feed)[0]) < 10_000
    with Feed(source(1, broken=True), None) as feed:
        sleep(0.2)
        # after what came before
        assert isinstance(feed.next(), Arrived)
        with pytest.raises(InputError, match="line 2"):
            feed.next(2.0)
