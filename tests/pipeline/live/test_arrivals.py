"""Late, repeated and missing pairs: what is used, and what is said."""

import logging

import pytest

from polhode.pipeline.live.arrivals import NAMED, Arrivals

STEP_NS = 500_000_000


def test_late_pairs_and_those_of_the_same_time_are_refused_and_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    arrivals = Arrivals()
    with caplog.at_level(logging.WARNING):
        taken = [arrivals.accepts(stamp) for stamp in (10, 20, 15, 20, 30)]
    assert taken == [True, True, False, False, True]
    assert arrivals.count("late") == arrivals.count("same time") == 1
    assert ["15 ns" in caplog.text, "20 ns" in caplog.text] == [True, True]
    assert any("earlier than the pair before (1): 15 ns" in line for line in arrivals.warnings)


def test_a_gap_is_named_once_the_usual_interval_is_known() -> None:
    arrivals = Arrivals()
    stamps = [k * STEP_NS for k in (0, 1, 2, 3, 4, 7, 8)]
    assert all(arrivals.accepts(stamp) for stamp in stamps)
    (line,) = arrivals.warnings
    assert line.endswith(f"{7 * STEP_NS} ns (about 2)")


def test_a_sentence_names_the_first_pairs_and_counts_all() -> None:
    arrivals = Arrivals()
    for k in range(NAMED + 3):
        arrivals.note("dropped", f"{k} ns")
    (line,) = arrivals.warnings
    assert f"({NAMED + 3})" in line and line.endswith(f"{NAMED - 1} ns, ...")
