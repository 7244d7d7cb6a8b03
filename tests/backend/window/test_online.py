"""A whole sequence: one row per frame, told in the words of the final estimate."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.monte_carlo.window import first_frames
from polhode.backend import (
    align_online_estimate,
    estimate_motion,
    estimate_online,
    initialize_motion,
    window_warnings,
)
from polhode.config.backend import Backend
from polhode.lie import inverse_pose, transform_points
from polhode.progress import Silent
from polhode.records import MotionEstimate, OnlineEstimate
from polhode.simulation.monte_carlo import SyntheticSequence

FAST = Backend.model_validate({"solver": "gauss_newton", "process_noise": "given"})


@pytest.fixture(scope="module")
def both(tumble: SyntheticSequence) -> tuple[OnlineEstimate, MotionEstimate]:
    tracks = tumble.tracks
    final = estimate_motion(tracks, initialize_motion(tracks, tumble.relative, FAST), FAST, Silent())
    return estimate_online(tracks, FAST, Silent()), final


def test_one_row_per_frame_and_only_the_first_ones_unknown(
    both: tuple[OnlineEstimate, MotionEstimate],
) -> None:
    online, final = both
    np.testing.assert_array_equal(online.timestamps_ns, final.timestamps_ns)
    unknown = ~np.asarray(np.isfinite(online.covariance).all(axis=(1, 2)))
    assert unknown[0] and not unknown[-15:].any()
    assert online.determined[-1].all()


def test_half_turns_and_frame_G_are_those_of_the_final_estimate(
    both: tuple[OnlineEstimate, MotionEstimate],
) -> None:
    online, final = both
    flipped = replace(
        online,
        R_NP=online.R_NP * np.array([-1.0, 1.0, -1.0]),
        w_P=online.w_P * np.array([-1.0, 1.0, -1.0]),
        R_GP=online.R_GP * np.array([-1.0, 1.0, -1.0]),
    )
    for estimate in (online, flipped):
        told = align_online_estimate(estimate, final)
        apart = np.einsum("fij,fij->f", told.R_NP[-15:], final.R_NP[-15:])
        assert np.all(apart > 2.9)
        assert np.all(np.abs(told.w_P[-15:] - final.w_P[-15:]) < 0.05)
        np.testing.assert_allclose(told.com_G[-1], final.mass.com_G, atol=2e-3)
        np.testing.assert_allclose(told.X_NG[-1], final.X_NG[-1], atol=0.02)
        # what does not depend on the frame G stays
        r_N = transform_points(told.X_NG, told.com_G[:, None])[:, 0]
        np.testing.assert_allclose(r_N, online.r_N, atol=1e-9)
        np.testing.assert_allclose(told.X_NG[:, :3, :3] @ told.R_GP, told.R_NP, atol=1e-9)


def test_names_change_and_sigmas_with_them(both: tuple[OnlineEstimate, MotionEstimate]) -> None:
    online, final = both
    told = align_online_estimate(online, final)
    before, after = (np.diagonal(e.covariance, axis1=1, axis2=2) for e in (online, told))
    np.testing.assert_array_equal(before, after)
    known = np.isfinite(online.cov_com_G).all(axis=(1, 2))
    trace, told_trace = (np.trace(e.cov_com_G[known], axis1=1, axis2=2) for e in (online, told))
    np.testing.assert_allclose(told_trace, trace, rtol=1e-9)
    assert np.isfinite(inverse_pose(told.X_NG)).all()


def test_a_window_longer_than_the_sequence_is_said_and_works(tumble: SyntheticSequence) -> None:
    short = first_frames(tumble, 10)
    for frames, expected in ((10, 0), (40, 1)):
        config = Backend.model_validate({"process_noise": "given", "window": {"frames": frames}})
        assert len(window_warnings(10, config)) == expected
        assert np.isfinite(estimate_online(short.tracks, config, Silent()).r_N).all()
    assert "backend.window.frames" in window_warnings(10, config)[0]
