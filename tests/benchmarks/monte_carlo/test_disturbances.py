"""The benchmark of pushes counts what was pushed, and tells false finds from right ones."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.monte_carlo.disturbances import FREE, MOMENTS, UNKNOWN, print_unknown, whole_pushes
from polhode.records import Impulse

HIT = UNKNOWN["an impact of 0.25 s, 6 mm/s and 17 deg/s"]


def push(start_s: float, end_s: float, dv: np.ndarray, dw: np.ndarray) -> Impulse:
    return Impulse(int(1e9 * start_s), int(1e9 * end_s), dv, np.full(3, 1e-4), dw, np.full(3, 1e-3))


def test_a_push_is_compared_with_the_impulses_that_it_overlaps() -> None:
    _, duration_s, force_N, torque_P = HIT[0]
    dv, dw = duration_s * np.array(force_N) / FREE.mass_kg, duration_s * np.array(torque_P) / MOMENTS
    found = (push(11.5, 13.0, dv + 2e-4, dw), push(20.0, 21.0, np.zeros(3), np.full(3, 3e-3)))
    estimate: Any = SimpleNamespace(disturbances=SimpleNamespace(impulses=found))
    right, wrong = whole_pushes(estimate, HIT, np.ones(3))
    assert right == pytest.approx([2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0])
    assert wrong == pytest.approx([0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 0.0])


def test_the_table_counts_right_and_false_finds(capsys: pytest.CaptureFixture[str]) -> None:
    lines: list[dict[str, Any]] = [
        {
            "case": {"push": name, "search": search, "seed": 0},
            "nees": 1.0, "inside": 0.99, "error_k": [0.001, -0.002],
            "found": [[1.0] * 7, [0.0] * 7] if name.startswith("an impact") and search == "found" else [],
        }
        for name in UNKNOWN for search in ("none", "found")
    ]  # fmt: skip
    print_unknown(lines)
    (row,) = [
        text
        for text in capsys.readouterr().out.splitlines()
        if text.startswith("| an impact") and "| found" in text
    ]
    assert row.endswith("| found | 1/1 | 1 | 1.00, 99.0 % | 0.0010, 0.0020 | 1.00 |")
