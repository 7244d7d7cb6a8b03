"""Reported poses that the images contradict are named; right ones, and a camera at rest, are not."""

import numpy as np
import pytest

from polhode.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.pipeline.data_checks.pose_checks import inspector_check
from polhode.pipeline.run_directory.verdict import reasons_of
from polhode.rigid_body import propagate

F = 40
SEEN = np.ones(F, dtype=np.bool_)
TIME_S: Array = np.linspace(0.0, 19.5, F)


def target() -> Array:
    r, _, R, _ = propagate(
        TIME_S,
        np.array([0.0, 0.0, 0.6]),
        np.zeros(3),
        np.eye(3),
        np.array([0.5, 0.2, 0.2]),
        np.diag([1.5, 1.2, 0.9]),
    )
    return make_pose(R, r)


def said(error_deg: float, share: float, stated_deg: float = 0.02, moves: bool = True) -> list[str]:
    """Of a camera that swings, whose reported attitudes are off by so much in a share of the frames."""
    rng = np.random.default_rng(2)
    swing = np.stack([0.02 * np.sin(0.7 * TIME_S), 0.03 * np.cos(0.5 * TIME_S), 0.0 * TIME_S], axis=1)
    true = make_pose(exp_so3(swing if moves else 0.0 * swing), np.zeros((F, 3)))
    axis = rng.standard_normal((F, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    wrong = np.deg2rad(error_deg) * axis * (rng.random(F) < share)[:, None]
    noise = np.deg2rad(stated_deg) * rng.standard_normal((F, 3)) if moves else np.zeros((F, 3))
    reported = true @ make_pose(exp_so3(wrong + noise), np.zeros((F, 3)))
    X_RG = inverse_pose(true) @ target()
    return reasons_of([inspector_check(reported, reported @ X_RG, SEEN, float(np.deg2rad(stated_deg)))])


def test_poses_of_which_half_are_wrong_are_named() -> None:
    found = said(1.0, 0.5)
    assert len(found) == 1 and "contradict the images" in found[0]


@pytest.mark.parametrize("stated_deg", [0.02, 0.2])
def test_poses_that_scatter_as_stated_are_not(stated_deg: float) -> None:
    assert said(0.0, 0.0, stated_deg) == []


def test_a_camera_at_rest_reports_nothing_to_doubt() -> None:
    assert said(0.0, 0.0, moves=False) == []
