"""Verdicts on motions whose answer is known from rigid-body dynamics."""

from typing import Any

import numpy as np
import pytest

from polhode.backend.uncertainty.identifiability import (
    IdentifiabilityAnalysis,
    analyse,
    undetermined_states,
)
from polhode.backend.uncertainty.principal_axes import AxesDerivative
from polhode.geometry.lie import hat
from polhode.records.estimate import Identifiability, MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.backend.motions import BOX, QUIET, estimated

SYMMETRIC = np.diag([1.3, 1.3, 0.8])


FINE = np.array([1e-4, 1e-4, 1e-4, 0.01, 0.01, 0.01, 0.01, 0.01])
"""Standard deviations of com_P [m], k1, k2, theta [rad] that determine everything"""


def estimate(
    J_G: np.ndarray, w_G: tuple[float, float, float], psd: float = 1e-8, most: int = 200
) -> MotionEstimate:
    """30 s of a body seen well: 60 frames, 0.3 px."""
    noise: dict[str, Any] = {"accel_psd": psd, "torque_psd": psd}
    scene = SyntheticScene(
        frames=60, landmarks=200, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.1, J_G=J_G, w_G=w_G, **noise
    )
    return estimated(generate(scene, 0), QUIET.model_copy(update={**noise, "max_iterations": most}))


def analysed(sigma: np.ndarray, moments: list[float], w_P: np.ndarray) -> IdentifiabilityAnalysis:
    """From uncorrelated standard deviations of com_P [m], k1, k2, theta [rad]; xi are the last five."""
    derivative = AxesDerivative(np.array(moments), np.eye(3), np.eye(5)[:2], np.eye(5)[2:])
    return analyse(np.diag(sigma**-2.0), derivative, w_P)


def verdict(sigma: np.ndarray, moments: list[float]) -> Identifiability:
    return analysed(sigma, moments, np.tile([0.1, 0.4, 0.3], (9, 1))).record


def lost(motion: MotionEstimate) -> set[str]:
    return {name for name, text in motion.mass.identifiable.detail.items() if text.startswith("not")}


@pytest.mark.parametrize(
    ("w_G", "psd"),
    [((0.4, 0.5, 0.45), 1e-6), ((0.8, 0.1, 0.1), 1e-6), ((0.1, 0.1, 0.8), 1e-8), ((0.8, 0.03, 0.0), 1e-8)],
    ids=["disturbed tumble", "near the major axis", "near the minor axis", "wobble"],
)  # fmt: skip
def test_a_nutating_body_of_unequal_moments_is_determined_whole(
    w_G: tuple[float, float, float], psd: float
) -> None:
    motion = estimate(BOX, w_G, psd)
    assert lost(motion) == set()
    assert np.all(np.isfinite(motion.covariance))


def test_axes_are_open_while_the_order_of_the_moments_is_or_where_moments_may_be_equal() -> None:
    assert verdict(FINE, [1.4, 1.0, 0.7]).axes_P.all()
    for ratio in (3, 4):
        known = verdict(np.where(np.arange(8) == ratio, 0.2, FINE), [1.4, 1.0, 0.7])
        assert not known.axes_P.any() and known.com
    np.testing.assert_array_equal(verdict(FINE, [1.01, 1.0, 0.7]).axes_P, [True, True, False])
    np.testing.assert_array_equal(verdict(FINE, [1.4, 1.0, 0.99]).axes_P, [False, True, True])
    assert not verdict(FINE, [1.01, 1.0, 0.99]).axes_P.any()


def test_a_pure_spin_hides_ratios_axes_and_the_shift_along_it() -> None:
    # along what is hidden the solver would walk on without an end
    motion = estimate(BOX, (0.0, 0.0, 0.8), most=40)
    known = motion.mass.identifiable
    assert not known.k1 and not known.k2 and not known.axes and not known.com
    # only the shift along the spin is lost: it is known across
    assert known.com_P.sum() == 2
    assert np.isinf(np.diag(motion.mass.cov_J)).any()
    assert np.isinf(motion.mass.cov_k[0, 0]) and np.isinf(motion.mass.cov_k[1, 1])


def test_a_symmetric_body_hides_only_the_turn_about_its_axis() -> None:
    motion = estimate(SYMMETRIC, (0.4, 0.1, 0.6))
    assert lost(motion) == {"axes_z"}
    assert motion.mass.k2 == pytest.approx(np.log(1.3 / 0.8), abs=0.02)


@pytest.mark.parametrize("rate", [(0.4, 0.0, 0.3), (0.0, 0.4, 0.3), (0.28, 0.28, 0.3)])
def test_a_free_turn_about_an_axis_leaves_both_rates_across_it_open(rate: tuple[float, float, float]) -> None:
    # where one of them is 0 its neighbour does not change to first order, and still is not known
    analysis = analysed(FINE, [1.01, 1.0, 0.7], np.tile(rate, (2, 1)))
    assert analysis.record.axes_P.tolist() == [True, True, False]
    jacobians = np.zeros((2, 12, 20))
    jacobians[:, 9:12, 17:20] = hat(np.array(rate))
    open_ = undetermined_states(analysis, jacobians, np.zeros((24, 8)), np.tile(rate, (2, 1)))
    assert open_[:, 9:12].tolist() == [[True, True, False]] * 2
    spin = np.array([0.0, 0.0, 0.5])
    jacobians[:, 9:12, 17:20] = hat(spin)
    assert not undetermined_states(analysis, jacobians, np.zeros((24, 8)), np.tile(spin, (2, 1))).any()


def test_a_body_at_rest_claims_nothing() -> None:
    motion = estimate(BOX, (0.0, 0.0, 0.0))
    assert len(lost(motion)) == 8
    assert np.all(np.isfinite(motion.w_P)) and np.all(np.isfinite(motion.R_NP))
