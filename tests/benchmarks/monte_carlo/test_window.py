"""What the window is compared with: the first frames alone, by the same errors."""

import numpy as np

from benchmarks.monte_carlo.window import first_frames, ratios, smoothed, squares
from polhode.config.backend_settings import Backend
from polhode.simulation.monte_carlo import SyntheticScene, generate

SCENE = SyntheticScene(frames=30, landmarks=300, J_G=np.diag([1.5, 1.2, 0.9]), w_G=(0.4, 0.5, 0.45))


def test_the_first_frames_are_a_sequence_of_their_own() -> None:
    whole = generate(SCENE, 0)
    part = first_frames(whole, 12)
    assert part.tracks.n_frames == len(part.truth.r_N) == 12
    assert part.tracks.n_landmarks == len(part.p_G) < whole.tracks.n_landmarks
    n = len(part.tracks.frame)
    np.testing.assert_array_equal(part.tracks.uvd_px, whole.tracks.uvd_px[:n])
    np.testing.assert_array_equal(part.p_G[part.tracks.landmark], whole.p_G[whole.tracks.landmark[:n]])


def test_the_truth_has_no_error_whatever_the_half_turn() -> None:
    sequence, k = generate(SCENE, 1), 20
    truth = sequence.truth
    for turn in ([1.0, 1.0, 1.0], [-1.0, 1.0, -1.0]):
        motion = (truth.r_N[k], truth.v_N[k], truth.R_NP[k] * turn, truth.w_P[k] * turn)
        mass = (truth.k1, truth.k2, truth.R_GP * turn)
        found = squares(sequence, k, sequence.X_NG[0], motion, truth.com_G, mass)
        np.testing.assert_allclose(found, 0.0, atol=1e-20)
    off = (truth.r_N[k] + [3e-3, 0.0, 4e-3], *motion[1:])
    assert abs(squares(sequence, k, sequence.X_NG[0], off, truth.com_G, mass)[0] - 25e-6) < 1e-12


def test_smoothing_of_the_first_frames_is_near_the_truth() -> None:
    errors = np.sqrt(smoothed(generate(SCENE, 2), 25, Backend.model_validate({"process_noise": "given"})))
    assert errors[0] < 5e-3 and errors[1] < 5e-3 and errors[3] < 0.02


def test_ratios_are_of_states_at_all_frames_and_of_constants_at_the_last() -> None:
    smoothing = np.ones((3, 2, 6))
    window = smoothing * 4.0
    window[:, 0, 4:] = 100.0
    lines = [{"window": a.tolist(), "smoothing": b.tolist()} for a, b in zip(window, smoothing, strict=True)]
    np.testing.assert_allclose(ratios(lines), 2.0)
