"""The tables of the replay: times of each stage, errors beside those of the batch."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from benchmarks.command import ROOT
from benchmarks.live.replay import (
    BATCH,
    ERRORS,
    NEES_HEAD,
    SAMPLE,
    SCENES,
    TIMES,
    batch_row,
    error_rows,
    nees_row,
    stage_times,
    times_row,
)
from polhode.pipeline.live.run_live import LiveReport


def line(same: bool) -> dict[str, Any]:
    return {
        "case": {"sequence": "/data/ts38", "rate_hz": 2.0},
        "pairs": 115,
        "dropped": 1,
        "report_s": 41.26,
        "report_processor_s": 20.04,
        "seconds": {stage: [0.2, 0.35] for stage in ("features", "matching", "window", "latency")},
        "errors": {
            "live": [1.0, 2.0, 0.3, 3.0],
            "window of the batch": [1.0, 1.0, 0.2, 2.5],
            "final": [0.5, 0.1, 0.01, 1.0],
        },
        "nees": {"position": 3.123, "velocity": 2.0, "attitude": None, "angular_velocity": 3.0},
        "same": same,
        "film_s": 57.5,
        "batch_s": 69.0,
        "sift_s": 23.0,
        "processor_s": 40.0,
        "load": [0.0, 1.25],
    }


def test_rows_have_the_columns_of_their_heads() -> None:
    row = times_row(line(True))
    assert len(row) == TIMES.count("|") + 1
    assert row == ["ts38", "115", "1", *["0.200 (0.350)"] * 4, "41.3", "20.0", "0.0"]
    rows = error_rows(line(True))
    assert all(len(each) == ERRORS.count("|") + 1 for each in rows)
    assert [each[1] for each in rows] == ["live", "window of the batch", "final"]
    assert [each[-1] for each in rows] == ["-", "-", "yes"]
    assert error_rows(line(False))[-1][-1] == "no"
    consistency = nees_row(line(True))
    assert len(consistency) == NEES_HEAD.count("|") + 1
    assert consistency == ["ts38", "3.12", "2.00", "-", "3.00", "0.22 to 9.35"]
    batch = batch_row(line(True))
    assert len(batch) == BATCH.count("|") + 1
    assert batch == ["ts38", "57.5", "69.0", "1.20", "23.0", "3.0", "40.0", "1.2"]


def test_stages_have_median_and_95_percent() -> None:
    processed = [
        SimpleNamespace(
            state=SimpleNamespace(seconds={"features": k, "matching": 0.0, "window": 1.0}), latency_s=2.0 * k
        )
        for k in range(21)
    ]
    found = stage_times(LiveReport(cast(Any, processed)))
    assert found["features"] == pytest.approx([10.0, 19.0])
    assert found["latency"] == pytest.approx([20.0, 38.0]) and found["window"] == [1.0, 1.0]


def test_its_scenes_are_there() -> None:
    assert (SAMPLE / "mav0").is_dir() and all((ROOT / Path(each)).is_file() for each in SCENES)
