"""Angular momentum and spin axis at the last pair: their derivatives, their errors, and what stays known."""

from functools import cache

import numpy as np
import pytest

from polhode.backend.problem.inertia import FORMS, inertia_by_parameters, inertia_from_second_moments
from polhode.backend.uncertainty.ambiguity import OpenRotation, end_of, with_ambiguous_rotation
from polhode.geometry.lie import Array, exp_so3
from polhode.geometry.rigid_body import angular_momentum_N
from polhode.records.estimate import MotionEstimate
from polhode.run_directory.last_rotation import last_rotation, momentum_jacobian
from polhode.run_directory.summary_schema import Direction, Rotation
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate
from tests.backend.motions import BOX, QUIET, estimated, half_turn
from tests.backend.wrenches.test_known_wrench import MOMENTS, pushed

TUMBLE, SPIN = (0.4, 0.5, 0.45), (0.0, 0.0, 0.8)


@cache
def solved(w_G: tuple[float, float, float], seed: int) -> tuple[SyntheticSequence, MotionEstimate]:
    scene = SyntheticScene(
        frames=30, landmarks=250, detection=0.4, sigma_uv_px=0.3, sigma_d_px=0.2, J_G=BOX, w_G=w_G,
        accel_psd=1e-8, torque_psd=1e-8,
    )  # fmt: skip
    sequence = generate(scene, seed)
    return sequence, estimated(sequence, QUIET)


def with_truth(sequence: SyntheticSequence, estimate: MotionEstimate) -> tuple[Rotation, Array]:
    """What is found, and the true momentum (3,) over the middle moment, in N."""
    found, truth = last_rotation(estimate), sequence.truth
    assert found is not None
    moments = np.diag(truth.moments) / truth.moments[1]
    return found, angular_momentum_N(moments, truth.R_NP[-1], truth.w_P[-1])


def across(found: Direction, true: Array) -> Array:
    """Errors (2,) in sigmas along the axes of the covariance across the direction."""
    values, vectors = np.linalg.eigh(np.array(found.cov, dtype=np.float64))
    error = vectors.T @ (found.unit - true / np.linalg.norm(true))
    return np.asarray(error[1:] / np.sqrt(values[1:]))


def test_derivatives_are_those_of_finite_differences() -> None:
    form, rng = FORMS["second_moments"], np.random.default_rng(4)
    R, turn, w = exp_so3(rng.normal(size=3)), exp_so3(rng.normal(size=3)), rng.normal(size=3)
    J, by_xi = inertia_by_parameters(turn @ BOX @ turn.T, form)
    xi, R_ref = form.coordinates(0.5 * np.trace(J) * np.eye(3) - J)

    def momentum(change: Array) -> Array:
        J_changed = inertia_from_second_moments(form.second_moments(xi + change[12:17], R_ref))
        h = angular_momentum_N(J_changed, R @ exp_so3(change[6:9]), w + change[9:12])
        return np.append(h / np.linalg.norm(h), np.linalg.norm(h))

    found = np.vstack(momentum_jacobian(R, w, J, by_xi))
    for n, step in enumerate(1e-6 * np.eye(20)):
        np.testing.assert_allclose(found[:, n], (momentum(step) - momentum(-step)) / 2e-6, atol=1e-8)


def test_errors_of_a_tumble_are_as_large_as_their_sigmas_say_and_unknown_if_it_is_ambiguous() -> None:
    errors = []
    for seed in range(5):
        sequence, estimate = solved(TUMBLE, seed)
        (found, h_N), truth = with_truth(sequence, estimate), sequence.truth
        assert found.sigma_momentum_rad_s is not None and found.momentum_N_m_s is None
        of_size = (found.momentum_rad_s - np.linalg.norm(h_N)) / found.sigma_momentum_rad_s
        w_N, w_P = truth.R_NP[-1] @ truth.w_P[-1], truth.w_P[-1] * half_turn(sequence, estimate)[0]
        parts = zip((found.momentum_N, found.spin_N, found.spin_P), (h_N, w_N, w_P), strict=True)
        errors.append(np.hstack([of_size, *(across(*part) for part in parts)]))
    mean_square = np.mean(np.square(errors), axis=0)
    assert np.abs(errors).max() < 3.5 and np.all((mean_square > 0.05) & (mean_square < 3.0))
    both = [end_of(estimate, OpenRotation("sphere", turn_deg, 0.5)) for turn_deg in (120.0, 240.0)]
    found, _ = with_truth(sequence, with_ambiguous_rotation(estimate, tuple(both)))
    assert {found.momentum_N.sigma_deg, found.spin_N.sigma_deg, found.sigma_momentum_rad_s} == {None}


def test_a_pure_spin_keeps_the_direction_of_its_momentum_though_not_its_size() -> None:
    sequence, estimate = solved(SPIN, 0)
    found, h_N = with_truth(sequence, estimate)
    assert not estimate.mass.identifiable.k2 and found.sigma_momentum_rad_s is None
    assert found.momentum_N.sigma_deg is not None and found.momentum_N.sigma_deg < 0.5
    assert np.abs(across(found.momentum_N, h_N)).max() < 3.5 and found.spin_P.sigma_deg is None


def test_known_torques_give_the_momentum_in_absolute_units_with_its_sigma() -> None:
    for seed in range(2):
        found, h_N = with_truth(*pushed(seed))
        value, sigma = found.momentum_N_m_s, found.sigma_momentum_N_m_s
        assert value is not None and sigma is not None and sigma < 0.03 * value
        assert value == pytest.approx(MOMENTS[1] * np.linalg.norm(h_N), abs=3.5 * sigma)
