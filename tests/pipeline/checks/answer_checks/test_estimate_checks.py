"""Single comparisons of the estimate: a push is no jump, a centre of mass lies in its body."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.checks.answer_checks.check_answer import mesh_check, push_check
from polhode.records.estimate import Disturbances, Impulse
from polhode.run_directory.summary_schema import Physics


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


def physics(offset_m: float | None, sigma_m: float | None = 1e-3) -> Physics:
    none = dict.fromkeys(("axes_angle_deg", "axes_angle_sigma_deg", "k1_difference", "k2_difference"))
    uniform = {"com_uniform_G": np.zeros(3), "R_GP_uniform": np.eye(3), "k1_uniform": 0.1, "k2_uniform": 0.1}
    offset = None if offset_m is None else (0.0, offset_m, 0.0)
    found = {"words": [], "volume_m3": 8e-3, "com_offset_G": offset, "com_offset_sigma_m": sigma_m}
    return Physics.model_validate(none | uniform | found)


def test_an_offset_of_the_centre_of_mass_counts_by_the_size_and_its_sigma() -> None:
    little = mesh_check(physics(0.023))
    assert little.value == pytest.approx(10.0) and little.reason == ""
    assert "no body of this surface" in mesh_check(physics(0.21)).reason
    assert mesh_check(physics(0.21, sigma_m=0.05)).reason == ""
    for unknown in (None, physics(None), physics(0.2, sigma_m=None)):
        assert mesh_check(unknown).value is None
