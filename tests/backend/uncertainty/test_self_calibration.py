"""What the data say of the calibration's errors, and the estimate freed of those that they determine."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend import with_calibration
from polhode.backend.uncertainty.self_calibration import MAX_SHARE, determined_errors
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.estimate import CalibrationScore
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, calibrated, estimated, sigmas, state_errors, with_errors

NONE_SHARED = Backend(
    solver="gauss_newton", process_noise="given", accel_psd=1e-9, torque_psd=1e-9,
    systematic_px=(0.0, 0.0, 0.0), light_px=0.0,
)  # fmt: skip
SCENE = SyntheticScene(
    frames=30, landmarks=300, detection=0.5, w_G=(0.4, 0.5, 0.45), J_G=BOX, sigma_uv_px=0.1, sigma_d_px=0.1,
    accel_psd=1e-9, torque_psd=1e-9,
)  # fmt: skip


def scaled(sequence: SyntheticSequence, times: float) -> SyntheticSequence:
    """With the sigmas of the calibration multiplied."""
    effects = sequence.tracks.calibration
    assert effects is not None
    by = times * np.eye(len(effects.right_later_s))
    return replace(sequence, tracks=replace(sequence.tracks, calibration=effects.mixed(by)))


def effects_of(names: tuple[str, ...], factor: Array, later_s: Array | None = None) -> CalibrationEffects:
    """Effects of which only names and factor count."""
    none = np.zeros((1, 2, factor.shape[1]))
    shift = np.zeros((3, factor.shape[1]))
    later_s = np.zeros(factor.shape[1]) if later_s is None else later_s
    return CalibrationEffects(
        "test", none, none, shift, shift, later_s, shift, shift, names=names, factor=factor
    )


def score(A: Array, z: Array, B: Array | None = None) -> CalibrationScore:
    """Of errors z without noise, the two stretches beside them."""
    wide = np.zeros((len(A) + 2, len(A) + 2))
    wide[2:, 2:] = A
    noise = wide.copy()
    noise[2:, 2:] = A if B is None else B
    return CalibrationScore(wide, np.append(np.zeros(2), A @ z), noise)


def test_the_score_changes_by_the_information_times_the_errors() -> None:
    sequence = calibrated(generate(SCENE, 1))
    wrong, z = with_errors(sequence, 3, size=1.0)
    right, off = (estimated(each, NONE_SHARED).calibration_score for each in (sequence, wrong))
    assert right is not None and off is not None
    (A, s_right, B), s_off = right.of_prior(), off.of_prior()[1]
    expected = A @ z
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(s_off - s_right, expected, atol=0.07 * np.abs(expected).max())
    # the observations are independent: their noise is what the information says
    known = np.diag(A) > 1e-3
    np.testing.assert_allclose(np.diag(B)[known], np.diag(A)[known], rtol=0.15)


def test_what_the_data_determine_is_the_gaussian_posterior_and_the_rest_stays_as_it_was() -> None:
    effects = effects_of(("cam0.fu", "cam1.p_x"), np.diag([2.0, 1e-3]))
    found = determined_errors(score(np.diag([15.0, 1.0]), np.array([1.6, 1.0])), effects)
    assert found is not None
    # 1 / sqrt(1 + 15) of the prior is left, and 15 / 16 of the error is found
    np.testing.assert_allclose(found.mean, [1.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.factor @ found.factor.T, np.diag([1.0 / 16.0, 1.0]), atol=1e-12)
    (error,) = found.errors
    assert error.parameters == pytest.approx({"cam0.fu": 3.0})
    assert (error.value, error.sigma) == pytest.approx((1.5, 0.25))
    # the same information with errors that depend on one another is worth less
    dependent = score(np.diag([15.0, 1.0]), np.array([1.6, 1.0]), np.diag([150.0, 10.0]))
    assert determined_errors(dependent, effects) is None
    # an offset of the clock hides behind nothing else, but is never taken off
    late = effects_of(("cam0.fu", "cam1.clock_offset"), np.eye(2), np.array([0.0, 1e-3]))
    found = determined_errors(score(np.array([[15.0, 2.0], [2.0, 90.0]]), np.array([1.6, 1.0])), late)
    assert found is not None
    assert abs(found.mean[1]) < 1e-12 and found.errors[0].sigma < MAX_SHARE


def test_a_wrong_calibration_that_the_data_determine_is_found_and_taken_off() -> None:
    squares = []
    for seed in range(3):
        sequence = scaled(calibrated(generate(SCENE, seed)), 10.0)
        wrong, z = with_errors(sequence, seed)
        considered = estimated(wrong, NONE_SHARED)
        tracks, found = with_calibration(wrong.tracks, considered, NONE_SHARED, Silent())
        part, effects = found.calibration, wrong.tracks.calibration
        assert part is not None and part.estimated and part.correction is not None and effects is not None
        assert tracks.calibration is not None and found.calibration_score is considered.calibration_score
        left = effects.factor @ z - part.correction.factor[:, 0]
        # the errors that are left, in the sigmas that are left
        squares.append(np.square(np.linalg.lstsq(tracks.calibration.factor, left)[0]))
        before, after = (np.abs(state_errors(wrong, each)) for each in (considered, found))
        assert np.median(sigmas(found.covariance)[:, :3]) < np.median(sigmas(considered.covariance)[:, :3])
        assert (after < 4.0 * sigmas(found.covariance)).all() and (
            before < 4.5 * sigmas(considered.covariance)
        ).all()
    assert 0.6 < np.mean(squares) < 1.5


def test_nothing_changes_where_the_data_determine_nothing_and_poses_of_depth_are_without_it() -> None:
    sequence = calibrated(generate(replace(SCENE, frames=12, sigma_uv_px=1.0, sigma_d_px=1.0), 2))
    estimate = estimated(sequence, NONE_SHARED)
    tracks, found = with_calibration(sequence.tracks, estimate, NONE_SHARED, Silent())
    assert tracks is sequence.tracks and found is estimate
    assert found.calibration is not None and not found.calibration.estimated
    # poses for the depth that is put there, which has the same errors: as with an exact calibration
    exact = estimated(replace(sequence, tracks=replace(sequence.tracks, calibration=None)), NONE_SHARED)
    assert found.covariance_X_NG is not None and exact.covariance_X_NG is not None
    size = np.abs(exact.covariance_X_NG).max()
    np.testing.assert_allclose(found.covariance_X_NG, exact.covariance_X_NG, atol=1e-9 * size)
    assert found.covariance[-1][2, 2] > exact.covariance[-1][2, 2]
