"""Single comparisons of the estimate: a push is no jump."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.checks.answer_checks.check_answer import push_check
from polhode.records.estimate import Disturbances, Impulse


@pytest.mark.parametrize(("jump_m", "change_m_s"), [(0.0, 0.02), (5e-3, 0.0)])
def test_a_push_displaces_as_far_as_its_change_of_velocity_allows_and_a_jump_is_doubted(
    jump_m: float, change_m_s: float, example: Any
) -> None:
    """From frame 10 to 12 (1 s) the target jumps, and moves with another velocity from then on."""
    estimate = example.estimate
    stamps, time_s = estimate.timestamps_ns, (estimate.timestamps_ns - estimate.timestamps_ns[0]) * 1e-9
    start_s, end_s = time_s[10], time_s[12]
    # a constant force over the interval
    share = np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)
    moved = change_m_s * (0.5 * share**2 * (end_s - start_s) + np.maximum(time_s - end_s, 0.0))
    r_N, v_N = estimate.r_N.copy(), estimate.v_N.copy()
    r_N[:, 2] += moved + jump_m * (time_s >= end_s)
    v_N[:, 2] += change_m_s * share
    zero, one, none, steps = np.zeros(3), np.ones(3), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    push = Impulse(int(stamps[10]), int(stamps[12]), zero, one, zero, one)
    found = Disturbances(steps, steps, none, none, none, none, (push,))
    check = push_check(replace(estimate, r_N=r_N, v_N=v_N, disturbances=found))
    if jump_m:
        assert check.value is not None and check.value > 5.0
        assert "displaced by 5 mm more" in check.reason
    else:
        assert check.value == pytest.approx(0.0) and check.reason == ""
    assert push_check(estimate).value is None
