"""The window as a whole: causal, bounded, as good as full smoothing, honest, the same by either solver."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import (
    align_online_estimate,
    estimate_motion,
    estimate_online,
    initialize_motion,
    window_warnings,
)
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.solve import refine
from polhode.backend.uncertainty.covariance import with_infinite
from polhode.backend.window.causal_state import OnlineState, unknown_state
from polhode.backend.window.estimator import (
    WARM_UP_FRAMES,
    SlidingWindow,
    warm_up,
    without_claims_after_torques,
)
from polhode.backend.window.frame import FrameMeasurements, frames_of
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, log_so3, make_pose, transform_points
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.tracks import Wrench
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticSequence, generate
from tests.backend.motions import at_truth
from tests.backend.window.conftest import TUMBLE, Feed

SMALL = {"frames": 6, "key_frames": 10, "history": 14}
FAST = Backend.model_validate({"solver": "gauss_newton", "process_noise": "given"})


def errors(sequence: SyntheticSequence, k: int, state: OnlineState) -> Array:
    """Truth minus estimate (12,) in the order and frames of the covariance, half-turn resolved."""
    truth = sequence.truth
    turns = [log_so3(state.R_NP.T @ truth.R_NP[k] @ np.diag(h)) for h in HALF_TURNS]
    best = int(np.argmin([np.linalg.norm(turn) for turn in turns]))
    w_P = truth.w_P[k] * HALF_TURNS[best] - state.w_P
    return np.concatenate([truth.r_N[k] - state.r_N, truth.v_N[k] - state.v_N, turns[best], w_P])


def deviations(sequence: SyntheticSequence, states: list[OnlineState], first: int = 0) -> Array:
    """Errors over their standard deviations, those that are determined, from a frame on."""
    z = [errors(sequence, k, s) / np.sqrt(np.diag(s.covariance)) for k, s in enumerate(states)]
    determined = np.isfinite([np.diag(s.covariance) for s in states])
    return np.array(z)[first:][determined[first:]]


def same(a: OnlineState, b: OnlineState) -> bool:
    names = ("r_N", "R_NP", "covariance", "com_G")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def test_a_row_does_not_depend_on_what_comes_later(tumble: SyntheticSequence, feed: Feed) -> None:
    later = tumble.tracks.frame >= 20
    noise = np.random.default_rng(0).normal(0.0, 3.0, (len(later), 3))
    tracks = replace(tumble.tracks, uvd_px=tumble.tracks.uvd_px + later[:, None] * noise)
    _, before = feed(tumble, 22, **SMALL)
    _, after = feed(replace(tumble, tracks=tracks), 22, **SMALL)
    assert all(same(a, b) for a, b in zip(before[:20], after[:20], strict=True))
    assert not same(before[21], after[21])


def test_a_window_that_covers_everything_is_full_smoothing() -> None:
    sequence = generate(replace(TUMBLE, frames=30), 4)
    # without a kernel: the window takes its weights for information, the batch solver does not
    config = Backend.model_validate(
        {"process_noise": "given", "robust_scale": 1e4, "window": {"frames": 30, "history": 100}}
    )
    window = SlidingWindow(sequence.tracks.rig, config)
    state = [window.add(m) for m in frames_of(sequence.tracks)][-1]
    start = at_truth(sequence, config)
    data = start.data
    whole, _, _ = refine(GaussNewton(data), start.iterate, 50)
    J = whole.J_G(data.form)
    moments = np.linalg.eigvalsh(J)[::-1]
    k = np.log(moments[:2] / moments[1:])
    assert np.all(np.abs(k - state.k) < 0.1 * np.sqrt(np.diag(state.cov_k)))
    sigma = np.sqrt(np.diag(state.covariance))
    assert np.all(np.isfinite(sigma))
    r_N = whole.p_NG[-1] + whole.R_NG[-1] @ whole.com_G
    assert np.all(np.abs(r_N - state.r_N) < 0.1 * sigma[:3])
    assert np.all(np.abs(whole.v_N[-1] - state.v_N) < 0.1 * sigma[3:6])
    w_P = state.R_NP.T @ whole.R_NG[-1] @ whole.w_G[-1]
    assert np.all(np.abs(w_P - state.w_P) < 0.1 * sigma[9:12])


def test_once_the_inertia_is_known_errors_are_as_large_as_the_covariance_says(feed: Feed) -> None:
    sequences = [generate(TUMBLE, 20 + n) for n in range(3)]
    z = np.concatenate([deviations(each, feed(each, **SMALL)[1], 24) for each in sequences])
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3
    assert np.mean(np.abs(z) < 3.0) > 0.97


def test_memory_is_bounded_by_the_frames_that_are_held(feed: Feed) -> None:
    sequence = generate(replace(TUMBLE, frames=90, landmarks=200), 6)
    config = Backend.model_validate({"process_noise": "given", "window": SMALL})
    window, sizes = SlidingWindow(sequence.tracks.rig, config), []
    for k, m in enumerate(frames_of(sequence.tracks)):
        # every landmark is a new one when it comes back after 20 frames
        window.add(replace(m, landmark=m.landmark + 1000 * (k // 20)))
        active, marks = window.state.active, window.state.landmarks
        sizes.append(
            (len(active.keys), len(active.recent), len(active.arrival.g), len(marks.used), len(marks))
        )
        assert len(marks.used) <= sum(len(frame.slot) for frame in active.frames)
    assert window.state.history is None
    keys, recent, arrival, _, slots = (set(each) for each in np.array(sizes[45:]).T.tolist())
    assert (keys, recent, arrival, slots) == ({10}, {6}, {10 * 6 + 6 * 12 + 8}, {1024})


@pytest.mark.parametrize("inertia", ["second_moments", "ratios_axes"])
def test_both_solvers_agree_in_both_forms_of_the_inertia(
    tumble: SyntheticSequence, feed: Feed, inertia: str
) -> None:
    reference = feed(tumble, 36, inertia, **SMALL)[1][-1]
    window, states = feed(tumble, 36, inertia, solver="ipopt", **SMALL)
    state = states[-1]
    assert window.state.history is None
    sigma = np.sqrt(np.diag(reference.covariance))
    assert np.all(np.abs(state.r_N - reference.r_N) < 0.05 * sigma[:3])
    assert np.all(np.abs(state.v_N - reference.v_N) < 0.05 * sigma[3:6])
    turns = [log_so3(reference.R_NP.T @ state.R_NP @ np.diag(h)) for h in HALF_TURNS]
    assert any(np.all(np.abs(turn) < 0.05 * sigma[6:9]) for turn in turns)
    np.testing.assert_allclose(np.sqrt(np.diag(state.covariance)), sigma, rtol=0.02)
    k, sigma_k = reference.k, np.sqrt(np.diag(reference.cov_k))
    assert np.all(np.abs(k - state.k) < 0.1 * sigma_k)


def test_lost_frames_are_predicted_and_the_target_is_found_again(feed: Feed) -> None:
    sequence = generate(replace(TUMBLE, dropped=tuple(range(24, 34))), 7)
    _, states = feed(sequence, **SMALL)
    sigma = np.sqrt([np.diag(s.covariance) for s in states])
    assert np.all(np.diff(sigma[23:34, :3].max(axis=1)) > 0.0)
    assert sigma[33, 0] > 5.0 * sigma[23, 0]
    assert np.all(sigma[35, :6] < 2.0 * sigma[23, :6])
    assert np.mean(np.abs(deviations(sequence, states)) < 3.0) > 0.97


def test_gross_outliers_do_no_harm(feed: Feed) -> None:
    sequence = generate(replace(TUMBLE, outliers=0.3), 8)
    _, states = feed(sequence, **SMALL)
    assert np.mean(np.abs(deviations(sequence, states)) < 3.0) > 0.97
    assert np.sqrt(states[-1].cov_k[1, 1]) < 0.03


def test_what_a_spin_does_not_tell_is_infinite(feed: Feed) -> None:
    spin = replace(TUMBLE, w_G=(0.0, 0.0, 1.0), J_G=np.diag([1.0, 1.1, 1.3]), accel_psd=0.0, torque_psd=0.0)
    sequence = generate(spin, 9)
    _, states = feed(sequence, **SMALL)
    assert not states[-1].determined.any()
    assert np.all(np.isinf(np.diag(states[-1].cov_k)))
    assert np.isfinite(states[-1].r_N).all() and np.isfinite(states[-1].R_NP).all()
    assert np.mean(np.abs(deviations(sequence, states)) < 3.0) > 0.97


def test_first_frames_without_anything_in_common_begin_again(tumble: SyntheticSequence, feed: Feed) -> None:
    config = Backend.model_validate({"process_noise": "given", "window": SMALL})
    window, nothing, states = SlidingWindow(tumble.tracks.rig, config), np.zeros((0, 3)), []
    for k, m in enumerate(frames_of(tumble.tracks)):
        if k == 0:
            m = FrameMeasurements(m.timestamp_ns, m.X_NR, np.zeros(0, np.int64), nothing, nothing)
        states.append(window.add(replace(m, landmark=m.landmark + 1000) if k == 1 else m))
    assert all(np.all(np.isinf(np.diag(s.covariance))) for s in states[:4])
    assert np.isfinite(states[-1].covariance).all()
    assert np.mean(np.abs(deviations(tumble, states)) < 3.0) > 0.97


def test_the_causal_estimate_in_the_conventions_of_the_final_one(tumble: SyntheticSequence) -> None:
    tracks = tumble.tracks
    final = estimate_motion(tracks, initialize_motion(tracks, tumble.relative, FAST), FAST, Silent())
    online = estimate_online(tracks, FAST, Silent())
    np.testing.assert_array_equal(online.timestamps_ns, final.timestamps_ns)
    unknown = ~np.asarray(np.isfinite(online.covariance).all(axis=(1, 2)))
    assert unknown[0] and not unknown[-15:].any() and online.determined[-1].all()
    turn = np.array([-1.0, 1.0, -1.0])
    flipped = replace(online, R_NP=online.R_NP * turn, w_P=online.w_P * turn, R_GP=online.R_GP * turn)
    for estimate in (online, flipped):
        aligned = align_online_estimate(estimate, final)
        assert np.all(np.einsum("fij,fij->f", aligned.R_NP[-15:], final.R_NP[-15:]) > 2.9)
        assert np.all(np.abs(aligned.w_P[-15:] - final.w_P[-15:]) < 0.05)
        np.testing.assert_allclose(aligned.com_G[-1], final.mass.com_G, atol=2e-3)
        np.testing.assert_allclose(aligned.X_NG[-1], final.X_NG[-1], atol=0.02)
        # what does not depend on the frame G stays
        r_N = transform_points(aligned.X_NG, aligned.com_G[:, None])[:, 0]
        np.testing.assert_allclose(r_N, online.r_N, atol=1e-9)
        np.testing.assert_allclose(aligned.X_NG[:, :3, :3] @ aligned.R_GP, aligned.R_NP, atol=1e-9)
    aligned = align_online_estimate(online, final)
    before, after = (np.diagonal(e.covariance, axis1=1, axis2=2) for e in (online, aligned))
    np.testing.assert_array_equal(before, after)
    known = np.isfinite(online.cov_com_G).all(axis=(1, 2))
    trace, aligned_trace = (np.trace(e.cov_com_G[known], axis1=1, axis2=2) for e in (online, aligned))
    np.testing.assert_allclose(aligned_trace, trace, rtol=1e-9)
    # after a known torque the rotation is not claimed
    n = len(online.timestamps_ns)
    times, late = online.timestamps_ns[[0, n // 2, n // 2 + 1]], n // 2 + 1
    force, torque = np.zeros((3, 3)), np.array([[0.0] * 3, [0.0, 1e-3, 0.0], [0.0] * 3])
    claimed = without_claims_after_torques(online, Wrench(times, force, torque))
    np.testing.assert_array_equal(claimed.covariance[:late], online.covariance[:late])
    sigma = np.diagonal(claimed.covariance, axis1=1, axis2=2)[late:]
    assert np.isinf(sigma[:, 6:]).all() and np.isfinite(sigma[:, :6]).all()
    assert np.isinf(np.diagonal(claimed.cov_k, axis1=1, axis2=2)[late:]).all()
    assert without_claims_after_torques(online, Wrench(times, torque, force)) is online


def test_a_window_longer_than_the_sequence_is_said_and_works() -> None:
    tracks = generate(replace(TUMBLE, frames=10), 0).tracks
    for frames, expected in ((10, 0), (40, 1)):
        config = Backend.model_validate({"process_noise": "given", "window": {"frames": frames}})
        assert len(window_warnings(10, config)) == expected
        assert np.isfinite(estimate_online(tracks, config, Silent()).r_N).all()
    assert "backend.window.frames" in window_warnings(10, config)[0]


def test_a_window_follows_the_body_that_it_is_warmed_up_with(monkeypatch: pytest.MonkeyPatch) -> None:
    added = []
    add = SlidingWindow.add

    def noted(window: SlidingWindow, measurements: FrameMeasurements) -> OnlineState:
        state = add(window, measurements)
        added.append((state, window.accepted, window.restarts, window.sigma_rate))
        return state

    monkeypatch.setattr(SlidingWindow, "add", noted)
    warm_up(RectifiedRig(400.0, 160.0, 128.0, 0.1, 320, 256), Backend())
    # 17 degrees in half a second
    state, accepted, restarts, sigma = added[-1]
    assert len(added) == WARM_UP_FRAMES and accepted > 30 and restarts == 0
    assert 0.5 < np.linalg.norm(state.w_P) < 0.7 and sigma < 0.05


def test_axes_do_not_flip_from_row_to_row(tumble: SyntheticSequence, feed: Feed) -> None:
    _, states = feed(tumble)
    known = [s for s in states if s.determined[3]]
    assert len(known) > 10
    for a, b in itertools.pairwise(known):
        assert np.trace(a.R_GP.T @ b.R_GP) > 2.0


def test_nothing_known_is_finite_with_infinite_sigma_and_without_covariance() -> None:
    state = unknown_state(5, make_pose(np.eye(3), [1.0, 0.0, 0.0]))
    assert np.isfinite(state.r_N).all() and np.all(np.isinf(np.diag(state.covariance)))
    assert not state.determined.any()
    out = with_infinite(np.ones((3, 3)), np.array([False, True, False]))
    assert np.isinf(out[1, 1]) and out[0, 1] == 0.0 and out[0, 2] == 1.0


def test_key_frames_spread_over_the_attitudes_and_are_seen_again_after_a_revolution(feed: Feed) -> None:
    # a slow start: most of the first frames look alike; then all sides
    sequence = generate(replace(TUMBLE, frames=60, dt_s=0.3, w_G=(0.05, 0.7, 0.05)), 1)
    window, _ = feed(sequence, frames=5, key_frames=8, history=12)
    active = window.state.active
    keys = active.keys
    turns = np.array([[np.linalg.norm(log_so3(a.R_NG.T @ b.R_NG)) for b in keys] for a in keys])
    # 60 frames of 12 degrees turn twice: eight keys could all lie within 96 degrees
    assert turns.max() > np.deg2rad(150.0)
    assert np.min(turns + 10.0 * np.eye(len(keys))) > np.deg2rad(3.0)
    newest = set(active.recent[-1].slot.tolist())
    assert any(len(newest & set(key.slot.tolist())) > 5 for key in keys)
