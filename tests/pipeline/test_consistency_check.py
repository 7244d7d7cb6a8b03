"""Associations made with the motion stay only when they fit as well as blind ones."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.backend import estimate_motion, initialize_motion
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Bools, Ints, exp_so3, make_pose
from polhode.pipeline.find_motion import attitude_difference_deg, contradicts_first_method, fits_worse
from polhode.records.estimate import MotionEstimate
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(frames=14, landmarks=300, detection=0.4, J_G=np.diag([1.5, 1.2, 0.9]))
EVERY, HALF = np.ones(14, dtype=np.bool_), np.arange(7)


@cache
def solved(wrong: float = 0.0, noise_px: float = 1.0) -> MotionEstimate:
    """The motion when a share of the associations is wrong, or all are noisier."""
    config = Backend(solver="gauss_newton", process_noise="given")
    sequence = generate(replace(SCENE, outliers=wrong, sigma_uv_px=noise_px), 5)
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return estimate_motion(sequence.tracks, initial, config, Silent())


@pytest.mark.parametrize(
    ("later", "earlier", "worse"),
    [((0.15, 1.0), (0.0, 1.0), True), ((0.0, 1.4), (0.0, 1.0), True), ((0.0, 1.04), (0.0, 1.0), False),
     ((0.0, 1.0), (0.15, 1.0), False)],
)  # fmt: skip
def test_a_worse_fit_is_seen(later: tuple[float, float], earlier: tuple[float, float], worse: bool) -> None:
    assert fits_worse(solved(*later), solved(*earlier)) == worse


def test_what_does_not_converge_is_refused_unless_nothing_did() -> None:
    unfinished = replace(solved(), solver=replace(solved().solver, converged=False))
    assert fits_worse(unfinished, solved()) and not fits_worse(unfinished, unfinished)


def test_another_motion_is_a_revision_and_another_body_frame_is_none() -> None:
    tracks = generate(replace(SCENE, outliers=0.0, sigma_uv_px=1.0), 5).tracks

    def contradicts(later: MotionEstimate, connected: Bools = EVERY, shift_px: float = 0.0) -> bool:
        seen = replace(tracks, uvd_px=tracks.uvd_px + shift_px)
        both: Any = SimpleNamespace(tracks=seen, estimate=later)
        first: Any = SimpleNamespace(tracks=tracks, estimate=solved())
        return contradicts_first_method(both, first, connected)

    def turned(frames: Ints) -> MotionEstimate:
        """Some frames turned by 8 degrees about the camera's axis, and all of them in another body frame."""
        X_NG = solved().X_NG @ make_pose(exp_so3([0.3, -0.8, 1.1]), np.array([0.1, 0.0, 0.0]))
        X_NG[frames, :3, :3] = exp_so3([0.0, 0.0, np.deg2rad(8.0)]) @ X_NG[frames, :3, :3]
        return replace(solved(), X_NG=X_NG)

    same, other = turned(HALF[:0]), turned(HALF)
    assert attitude_difference_deg(same, solved(), EVERY) < 1e-6 and not contradicts(same)
    # against the others: by 4 against the turn that fits best
    np.testing.assert_allclose(attitude_difference_deg(other, solved(), EVERY), 4.0, atol=1e-2)
    # frames that the first method did not see are the second one's own affair
    assert contradicts(other) and not contradicts(other, np.arange(14) >= 7)
    # places of the first method must fit as well; what only the second method sees has none with the first
    worse = replace(solved(), residuals_px=1.2 * solved().residuals_px)
    assert contradicts(worse) and not contradicts(worse, shift_px=3.0)
