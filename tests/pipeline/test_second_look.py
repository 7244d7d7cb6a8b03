"""Associations made with the motion stay only when they fit as well as blind ones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from backend import estimate_motion, initialize_motion
from pipeline.second_look import contradicts
from polhode.config.backend import Backend
from polhode.progress import Silent
from polhode.records import MotionEstimate
from simulation.measurements import SyntheticScene, generate

SCENE = SyntheticScene(frames=14, landmarks=300, detection=0.4, J_G=np.diag([1.5, 1.2, 0.9]))


@cache
def solved(wrong: float = 0.0, noise_px: float = 1.0) -> MotionEstimate:
    """The motion when a share of the associations is wrong, or all are noisier."""
    config = Backend(solver="gauss_newton", process_noise="given")
    sequence = generate(replace(SCENE, outliers=wrong, sigma_uv_px=noise_px), 2)
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return estimate_motion(sequence.tracks, initial, config, Silent())


@pytest.mark.parametrize(("wrong", "noise_px"), [(0.15, 1.0), (0.0, 1.4)])
def test_a_worse_fit_is_seen(wrong: float, noise_px: float) -> None:
    assert contradicts(solved(wrong, noise_px), solved())


def test_as_good_a_fit_is_kept() -> None:
    assert not contradicts(solved(0.0, 1.04), solved())
    assert not contradicts(solved(), solved(0.15))


def test_what_does_not_converge_is_refused_unless_nothing_did() -> None:
    def unfinished() -> MotionEstimate:
        return replace(solved(), solver=replace(solved().solver, converged=False))

    assert solved().solver.converged
    assert contradicts(unfinished(), solved())
    assert not contradicts(unfinished(), unfinished())
