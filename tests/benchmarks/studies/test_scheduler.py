"""The simulation of a scheduler, where its result can be calculated."""

import pytest

from benchmarks.studies.scheduler import simulated


def test_long_points_are_limited_by_the_workers() -> None:
    found = simulated(1000, 4, 10.0, 0.001, 0.0)
    # 250 points each, and the last one is served
    assert found.seconds == pytest.approx(2500.0, abs=0.02)
    assert found.workers_busy == pytest.approx(1.0, abs=1e-4)
    assert found.program_busy == pytest.approx(1.0 / 2500.0, rel=1e-3)


def test_short_points_are_limited_by_the_program() -> None:
    found = simulated(1000, 64, 0.01, 0.005, 0.0)
    # the first one ends after 10 ms, and then one is served after the other
    assert found.seconds == pytest.approx(0.01 + 1000 * 0.005)
    assert found.program_busy > 0.99 and found.workers_busy == pytest.approx(10.0 / (64 * 5.01))


def test_fewer_points_than_workers_take_one_length() -> None:
    assert simulated(3, 8, 2.0, 0.0, 0.5).seconds == pytest.approx(2.5)
