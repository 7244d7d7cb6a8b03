"""A way around a body that turns: it stays out of the volume, and uses little."""

import numpy as np
import pytest

from polhode.planning.approach.trajectory import ApproachTask, hull_points, min_distance, plan_trajectory
from polhode.planning.keep_out.volumes import KeepOutOptions, keep_out
from tests.planning.bodies import box, estimate


def task(**changed: object) -> ApproachTask:
    values: dict[str, object] = {
        "start_N": np.array([0.1, 0.0, 0.1]), "goal_N": np.array([0.1, 0.0, 1.1]),
        "via_N": np.array([0.5, 0.0, 0.6]), "duration_s": 20.0, "steps": 8, "radius_m": 0.05,
        "clearance_m": 0.02, "max_accel_m_s2": 0.05,
    }  # fmt: skip
    return ApproachTask(**(values | changed))  # type: ignore[arg-type]


def test_the_way_keeps_its_clearance_at_every_instant_and_without_thrust_there_is_none() -> None:
    options = KeepOutOptions(20.0, 0.97, members=80, cells=24)
    volume = keep_out(box(0.02), estimate((0.0, 0.4, 0.1)), options).instant
    trajectory = plan_trajectory(volume, task())
    np.testing.assert_allclose(trajectory.p_N[[0, -1]], [[0.1, 0.0, 0.1], [0.1, 0.0, 1.1]], atol=1e-6)
    np.testing.assert_allclose(trajectory.v_N[[0, -1]], 0.0, atol=1e-6)
    p, v, _ = trajectory.at(volume.motion.time_s)
    gap = min_distance(volume, trajectory)
    assert 0.07 <= gap < 0.10
    # not a wide detour either: the straight way would go through the middle
    assert np.linalg.norm(p - [0.1, 0.0, 0.6], axis=1).min() < 0.4
    np.testing.assert_allclose(np.gradient(p[:, 2], volume.motion.time_s)[5:-5], v[5:-5, 2], atol=2e-3)
    with pytest.raises(ValueError, match="no trajectory was found"):
        plan_trajectory(volume, task(max_accel_m_s2=1e-4))


def test_few_points_tell_how_much_of_the_hull_they_miss() -> None:
    points = np.random.default_rng(0).normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    few, short = hull_points(points, 80)
    assert len(few) == 80 and 0.02 < short < 0.25
    assert hull_points(points[:50], 80)[1] == pytest.approx(0.0, abs=1e-9)
