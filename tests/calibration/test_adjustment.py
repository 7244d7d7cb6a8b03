"""The bundle adjustment finds the rig, and its errors are as large as its covariance says."""

import numpy as np
import pytest
from scipy.stats import chi2

from polhode.calibration.adjustment import RigState, adjust
from polhode.calibration.formats import prior_of_adjustment
from polhode.calibration.lenses import COEFFICIENTS, Model
from polhode.calibration.start_values import calibrated_alone
from polhode.geometry.lie import Array, exp_so3, inverse_pose, log_so3
from polhode.records.calibration_prior import changed
from polhode.records.rig_calibration import StereoCalibration
from tests.calibration.synthetic_rigs import SIZE, rig, seen_corners

MODELS: tuple[Model, ...] = tuple(COEFFICIENTS)
VIEWS = 14


def errors(found: RigState, truth: RigState) -> Array:
    """Estimate minus truth of the shared unknowns; of a rotation in the step's own frame."""
    values = [a.values - b.values for a, b in zip(found.lenses, truth.lenses, strict=True)]
    turn = log_so3(truth.X_10[:3, :3].T @ found.X_10[:3, :3])
    return np.concatenate([*values, turn, found.X_10[:3, 3] - truth.X_10[:3, 3]])


@pytest.mark.parametrize("model", MODELS)
def test_one_camera_is_found_from_nothing(model: Model) -> None:
    rng = np.random.default_rng(2)
    truth = rig(model, VIEWS, rng)
    data = seen_corners(truth, 0.0, rng)[0]
    found = calibrated_alone(data, model, SIZE, VIEWS)
    assert np.abs(found.residuals[0]).max() < 1e-3
    np.testing.assert_allclose(found.state.lenses[0].values[:4], truth.lenses[0].values[:4], atol=0.05)


@pytest.mark.parametrize("model", MODELS)
def test_errors_of_the_pair_are_those_of_its_covariance(model: Model) -> None:
    """NEES, summed over trials."""
    nees, trials, sigma = 0.0, 6, 0.1
    for seed in range(trials):
        rng = np.random.default_rng(100 + seed)
        truth = rig(model, VIEWS, rng)
        data = seen_corners(truth, sigma, rng)
        free = np.ones(truth.shared, dtype=np.bool_)
        found = adjust(data, truth, free, robust=False)
        off = errors(found.state, truth)
        nees += float(off @ np.linalg.solve(found.covariance, off))
        assert abs(np.nanmedian(np.concatenate(found.sigma_px)) / sigma - 1.0) < 0.1
    low, high = chi2.interval(0.99, trials * truth.shared)
    assert low < nees < high


def test_what_is_fixed_stays_and_has_no_variance() -> None:
    rng = np.random.default_rng(4)
    truth = rig("brown5", VIEWS, rng)
    data = seen_corners(truth, 0.1, rng)
    free = np.zeros(truth.shared, dtype=np.bool_)
    free[-6:-3] = True
    turned = RigState(truth.lenses, truth.X_CB, truth.X_10.copy())
    turned.X_10[:3, :3] = truth.X_10[:3, :3] @ exp_so3([0.004, -0.003, 0.002])
    found = adjust(data, turned, free, robust=False)
    np.testing.assert_array_equal(found.state.lenses[0].values, truth.lenses[0].values)
    np.testing.assert_array_equal(found.state.X_10[:3, 3], truth.X_10[:3, 3])
    turn = log_so3(truth.X_10[:3, :3].T @ found.state.X_10[:3, :3])
    assert np.abs(turn).max() < 5e-4
    assert np.count_nonzero(found.covariance.diagonal()) == 3


def test_wrong_corners_hardly_move_the_robust_solution() -> None:
    rng = np.random.default_rng(6)
    truth = rig("brown5", VIEWS, rng)
    data = seen_corners(truth, 0.05, rng)
    for each in data:
        wrong = rng.choice(len(each.view), len(each.view) // 50, replace=False)
        each.uv_px[wrong] += rng.uniform(10.0, 40.0, (len(wrong), 2))
    found = adjust(data, truth, np.ones(truth.shared, dtype=np.bool_), robust=True)
    off = errors(found.state, truth) / np.sqrt(found.covariance.diagonal())
    assert np.abs(off).max() < 4.0


def test_the_covariance_is_carried_into_the_parameters_of_a_dataset() -> None:
    state, rng = rig("brown5", 1, np.random.default_rng(1)), np.random.default_rng(2)
    step = 1e-6 * rng.normal(size=state.shared)
    moved = state.moved(step, np.zeros((1, 6)))
    # of one error alone the covariance gives the error, but for its sign
    prior = prior_of_adjustment(state, np.outer(step, step))
    errors = np.sign(step[0]) * prior.covariance[:, 0] / prior.sigma[0]
    lenses = [(lens.K, lens.coefficients) for lens in state.lenses]
    (K0, dist0), (K1, dist1) = lenses
    stated = StereoCalibration(K0, K1, dist0, dist1, np.eye(4), inverse_pose(state.X_10), 640, 480)
    true = changed(stated, dict(zip(prior.names, errors.tolist(), strict=True)))
    np.testing.assert_allclose(true.X_BC1, inverse_pose(moved.X_10), rtol=0, atol=1e-11)
    assert abs(true.X_BC1 - stated.X_BC1).max() > 1e-7
    np.testing.assert_allclose(true.dist1, moved.lenses[1].coefficients, rtol=0, atol=1e-11)
