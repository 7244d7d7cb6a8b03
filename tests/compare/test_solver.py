"""What a process has reached outlives it: the point, the costs, the words."""

from pathlib import Path

import numpy as np
import pytest

from polhode.compare.solver import ProgressFiles, SolveMonitor, read_progress


def test_the_newest_whole_point_and_line_are_read(tmp_path: Path) -> None:
    stem = tmp_path / "row.json"
    assert read_progress(stem).x is None and read_progress(stem).wall_s is None
    reached = ProgressFiles(stem, 4)
    assert read_progress(stem).kept == "nothing" and read_progress(stem).status == ""
    assert read_progress(stem).wall_s == pytest.approx(0.0, abs=60.0)
    for n in range(5):
        reached.point(np.full(4, float(n)), "best")
        found = read_progress(stem)
        assert found.kept == "best" and found.x is not None and found.x.tolist() == [n] * 4
    reached.point(np.zeros(4), "last")
    # a write that is cut off in the middle does not touch the point that counts
    reached._numbers[1:3] = np.nan
    found = read_progress(stem)
    assert found.kept == "last" and found.x is not None and found.x.tolist() == [0.0] * 4
    with pytest.raises(ValueError, match="reshape"):
        reached.point(np.zeros(3), "best")
    for line in ("cost 0.5 12.0", "cost 1.5 11.0", "status a tenth", "status half of it"):
        reached.write(line)
    with stem.with_suffix(".log").open("a") as file:
        file.write("cost 2.5 1")
    assert read_progress(stem).trace == ((0.5, 12.0), (1.5, 11.0))
    assert read_progress(stem).status == "half of it"


def test_a_monitor_keeps_the_best_of_the_common_cost_and_the_last_of_another(tmp_path: Path) -> None:
    monitor = SolveMonitor(10.0, files=ProgressFiles(tmp_path / "row.json", 2))
    assert monitor.kept() == ("nothing", None)
    for cost, value in ((float("nan"), 9.0), (3.0, 0.0), (1.0, 1.0), (2.0, 2.0), (float("inf"), 3.0)):
        monitor.record(cost, np.full(2, value))
    kept, x = monitor.kept()
    assert kept == "best" and x is not None and x.tolist() == [1.0, 1.0]
    stored = read_progress(tmp_path / "row.json")
    assert stored.kept == "best" and stored.x is not None and stored.x.tolist() == [1.0, 1.0]
    assert len(monitor.trace) == len(stored.trace) == 5

    other = SolveMonitor(10.0, files=ProgressFiles(tmp_path / "other.json", 2))
    for cost, value in ((3.0, 0.0), (1.0, 1.0), (2.0, 2.0)):
        other.record(cost, np.full(2, value), common=False)
    kept, x = other.kept()
    assert kept == "last" and x is not None and x.tolist() == [2.0, 2.0]
