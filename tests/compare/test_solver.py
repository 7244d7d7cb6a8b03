"""What a process has reached outlives it: the point, the costs, the words."""

from pathlib import Path

import numpy as np
import pytest

from polhode.compare.solver import (
    ProgressFiles,
    SolveMonitor,
    read_point,
    read_status,
    read_trace,
    seconds_since_start,
)


def test_the_newest_whole_point_is_read(tmp_path: Path) -> None:
    stem = tmp_path / "row.json"
    assert read_point(stem) is None and seconds_since_start(stem) is None
    reached = ProgressFiles(stem, 4)
    assert read_point(stem) is None
    for n in range(5):
        reached.point(np.full(4, float(n)), "best")
        found = read_point(stem)
        assert found is not None and found[0] == "best" and found[1].tolist() == [n] * 4
    reached.point(np.zeros(4), "last")
    found = read_point(stem)
    assert found is not None and found[0] == "last"
    # a write that is cut off in the middle does not touch the point that counts
    reached._numbers[1:3] = np.nan
    found = read_point(stem)
    assert found is not None and found[1].tolist() == [0.0] * 4
    with pytest.raises(ValueError, match="reshape"):
        reached.point(np.zeros(3), "best")


def test_a_line_that_was_cut_short_is_no_point_of_the_trace(tmp_path: Path) -> None:
    stem = tmp_path / "row.json"
    reached = ProgressFiles(stem, 1)
    reached.cost(0.5, 12.0)
    reached.cost(1.5, 11.0)
    with stem.with_suffix(".trace").open("a") as file:
        file.write("2.5 1")
    assert read_trace(stem) == [(0.5, 12.0), (1.5, 11.0)]
    assert read_status(stem) == ""
    reached.status("half")
    assert read_status(stem) == "half"


def test_a_watch_keeps_the_best_of_the_common_cost_and_the_last_of_another(tmp_path: Path) -> None:
    stem = tmp_path / "row.json"
    monitor = SolveMonitor(10.0, files=ProgressFiles(stem, 2))
    assert monitor.kept() == ("nothing", None)
    for cost, value in ((float("nan"), 9.0), (3.0, 0.0), (1.0, 1.0), (2.0, 2.0), (float("inf"), 3.0)):
        monitor.record(cost, np.full(2, value))
    kept, x = monitor.kept()
    assert kept == "best" and x is not None and x.tolist() == [1.0, 1.0]
    stored = read_point(stem)
    assert stored is not None and stored[0] == "best" and stored[1].tolist() == [1.0, 1.0]
    assert len(monitor.trace) == 5

    other = SolveMonitor(10.0, files=ProgressFiles(tmp_path / "other.json", 2))
    for cost, value in ((3.0, 0.0), (1.0, 1.0), (2.0, 2.0)):
        other.record(cost, np.full(2, value), common=False)
    kept, x = other.kept()
    assert kept == "last" and x is not None and x.tolist() == [2.0, 2.0]
