"""A push changes the velocity; a jump of the position alone is none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.answer_checks.estimate_checks import push_check
from polhode.records import Disturbances, Impulse, MotionEstimate


def disturbed(example: Any, jump_m: float, change_m_s: float) -> MotionEstimate:
    """From frame 10 to 12 (1 s) the target jumps, and moves with another velocity from then on."""
    estimate: MotionEstimate = example.estimate
    stamps, time_s = estimate.timestamps_ns, (estimate.timestamps_ns - estimate.timestamps_ns[0]) * 1e-9
    start_s, end_s = time_s[10], time_s[12]
    along = np.array([0.0, 0.0, 1.0])
    # a constant force over the interval
    share = np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)
    moved = change_m_s * (0.5 * share**2 * (end_s - start_s) + np.maximum(time_s - end_s, 0.0))
    r_N = estimate.r_N + (moved + jump_m * (time_s >= end_s))[:, None] * along
    v_N = estimate.v_N + (change_m_s * share)[:, None] * along
    none, start_ns, end_ns = np.zeros((0, 3)), int(stamps[10]), int(stamps[12])
    push = Impulse(start_ns, end_ns, np.zeros(3), np.ones(3), np.zeros(3), np.ones(3))
    steps = np.zeros(0, dtype=np.int64)
    found = Disturbances(steps, steps, none, none, none, none, (push,))
    return replace(estimate, r_N=r_N, v_N=v_N, disturbances=found)


def test_a_push_displaces_as_far_as_its_change_of_velocity_allows(example: Any) -> None:
    check = push_check(disturbed(example, 0.0, 0.02))
    assert check.value == pytest.approx(0.0) and check.reason == ""


def test_a_jump_without_a_change_of_velocity_is_doubted(example: Any) -> None:
    check = push_check(disturbed(example, 5e-3, 0.0))
    assert check.value is not None and check.value > 5.0
    assert "displaced by 5 mm more" in check.reason


def test_without_disturbances_the_check_is_not_possible(example: Any) -> None:
    assert push_check(example.estimate).value is None
