"""A swing of the inspector is found with its course; disturbances of the target are not taken for one."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polhode.backend.outliers_and_noise.inspector_swing import (
    CORRELATION_LENGTHS,
    InspectorSwing,
    find_swing,
    smooth_functions,
)
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, exp_so3
from polhode.simulation.monte_carlo import generate, random_scene
from tests.backend.motions import at_truth

FRAMES = 30
K: Array = np.arange(FRAMES, dtype=np.float64)
SWING: Array = np.deg2rad(0.5) * np.stack([np.sin(K / 5.0), np.cos(K / 7.0), 0.0 * K], axis=1)
"""(F, 3) [rad] along N, of the stated attitude against the true one"""
NOISE = {"sigma_uv_px": 0.3, "sigma_d_px": 0.1}


@cache
def swing_of(
    swings: bool, psd: float = 1e-8, found_psd: float = 1e-8, sigma_rad: float = 0.0, frames: int = FRAMES
) -> InspectorSwing | None:
    """At the solution under a process noise, as it is estimated."""
    scene = random_scene(
        4, frames=frames, landmarks=150, detection=0.4, accel_psd=psd, torque_psd=psd, **NOISE
    )
    sequence = generate(scene, 4)
    X_NR = sequence.X_NR.copy()
    if swings:
        X_NR[:, :3, :3] = exp_so3(SWING) @ X_NR[:, :3, :3]
    tracks = replace(sequence.tracks, X_NR=X_NR, sigma_camera_theta_rad=sigma_rad)
    config = Backend(accel_psd=found_psd, torque_psd=10.0 * found_psd)
    start = at_truth(replace(sequence, tracks=tracks), config)
    solution = refine(GaussNewton(start.data, line_search=True), start.iterate, 20)[0]
    return find_swing(MotionFit(start.data, solution))


def test_a_swing_is_found_with_its_course() -> None:
    found = swing_of(True, found_psd=1e-7)
    assert found is not None and found.evidence_gain > 15.0
    true = SWING - SWING.mean(axis=0)
    assert found.rms_rad == pytest.approx(float(np.sqrt(np.mean(np.sum(true**2, axis=1)))), rel=0.3)
    # the target is in front of the camera: what is across the line of sight is along x and y
    assert np.corrcoef(found.alpha_N[:, :2].ravel(), -true[:, :2].ravel())[0, 1] > 0.9


def test_forces_and_torques_are_no_swing_and_too_few_frames_say_nothing() -> None:
    for psd in (1e-8, 1e-6):
        found = swing_of(False, psd, found_psd=psd)
        assert found is not None and found.evidence_gain < 3.0
    assert swing_of(False, frames=6) is None


def test_the_functions_have_the_correlation_of_a_swing_and_none_is_faster_than_three_frames() -> None:
    functions, roots = smooth_functions(np.full(59, 0.5))
    between = np.subtract.outer(np.arange(60.0), np.arange(60.0)) / 59.0
    for length, root in zip(CORRELATION_LENGTHS, roots, strict=True):
        spread = functions @ root
        assert spread @ spread.T == pytest.approx(np.exp(-0.5 * (between / length) ** 2), abs=3e-3)
    functions, roots = smooth_functions(np.full(11, 0.5))
    neighbours = [float((functions @ root @ root.T @ functions.T)[5, 6]) for root in roots]
    three, longest = np.exp(-0.5 / 9.0), np.exp(-0.5 * (3.0 / 11.0) ** 2)
    assert neighbours == pytest.approx([three, three, longest], abs=3e-3)
