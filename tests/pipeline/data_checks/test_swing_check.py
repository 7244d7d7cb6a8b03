"""A swing of the inspector is a reason to doubt, also where it claims to be at rest."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import estimate_motion
from polhode.config.backend_settings import Backend
from polhode.lie import Array, exp_so3, inverse_pose
from polhode.pipeline.data_checks.pose_checks import swing_check
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.progress import Silent
from polhode.records import InitialMotion
from polhode.simulation.monte_carlo import generate, random_scene

FRAMES = 24
K: Array = np.arange(FRAMES, dtype=np.float64)


def checked(deg: float, at_rest: bool) -> Check:
    """Of an inspector that swings by this while it reports to be at rest, or the reverse."""
    noise = {"sigma_uv_px": 0.3, "sigma_d_px": 0.1, "accel_psd": 1e-8, "torque_psd": 1e-8}
    sequence = generate(random_scene(4, frames=FRAMES, landmarks=120, detection=0.4, **noise), 4)
    tracks, X_NR = sequence.tracks, sequence.X_NR.copy()
    swing = np.deg2rad(deg) * np.stack([np.sin(K / 4.0), np.cos(K / 6.0), 0.0 * K], axis=1)
    if at_rest:
        # what the swinging camera sees
        rig = tracks.rig
        p_R = rig.triangulate(tracks.uvd_px)
        seen = np.einsum("nij,nj->ni", exp_so3(swing)[tracks.frame], p_R)
        tracks = replace(tracks, uvd_px=tracks.uvd_px + rig.project(seen) - rig.project(p_R))
        X_RG = inverse_pose(X_NR) @ sequence.X_NG
        X_RG[:, :3] = exp_so3(swing) @ X_RG[:, :3]
    else:
        X_RG = inverse_pose(X_NR) @ sequence.X_NG
        X_NR[:, :3, :3] = exp_so3(swing) @ X_NR[:, :3, :3]
        tracks = replace(tracks, X_NR=X_NR)
    start = InitialMotion(X_RG, np.ones(FRAMES, dtype=np.bool_))
    return swing_check(tracks, estimate_motion(tracks, start, Backend(), Silent()), Backend())


@pytest.mark.parametrize("at_rest", [True, False], ids=["claims rest", "reports a swing"])
def test_a_swing_is_named(at_rest: bool) -> None:
    check = checked(1.0, at_rest)
    assert check.value is not None and check.value > 6.0
    assert "check inspector0/" in check.reason and "deg beside what is reported" in check.reason


def test_an_inspector_that_keeps_its_attitude_is_not() -> None:
    check = checked(0.0, True)
    assert check.value is not None and check.value < 3.0 and not check.reason
