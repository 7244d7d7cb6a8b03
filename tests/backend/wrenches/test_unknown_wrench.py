"""Unknown pushes: found, followed and recovered; nothing is found where nothing pushes."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.backend.problem.motion_data import steps_with_nodes
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, log_so3
from polhode.records.estimate import Impulse, MotionEstimate
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, Vector, generate
from tests.backend.motions import deviations, estimated, half_turn

MOMENTS = np.array([3.0e-2, 2.4e-2, 1.8e-2])
FREE = SyntheticScene(
    frames=36, landmarks=200, detection=0.4, w_G=(0.3, 0.5, 0.35), J_G=np.diag(MOMENTS),
    accel_psd=1e-8, torque_psd=1e-8,
)  # fmt: skip
Push = tuple[float, float, Vector, Vector]
LONG: Push = (7.0, 3.0, (0.0, -1e-2, 1e-2), (0.0, 1.6e-3, 2e-3))
HIT: Push = (8.0, 0.25, (0.0, -8e-2, 8e-2), (0.0, 1e-2, -2e-2))


def pushed(push: Push, seed: int) -> SyntheticSequence:
    """The push is in the motion; nobody tells of it."""
    sequence = generate(replace(FREE, pushes=(push,)), seed)
    return replace(sequence, tracks=replace(sequence.tracks, wrench=None))


def push_deviation(
    found: Impulse, push: Push, sequence: SyntheticSequence, estimate: MotionEstimate
) -> Array:
    """(6,) error of the whole push over its sigma."""
    _, duration_s, force_N, torque_P = push
    dv, dw = np.array(force_N) * duration_s / FREE.mass_kg, np.array(torque_P) * duration_s / MOMENTS
    dw = dw * half_turn(sequence, estimate)[0]
    of_rate = (found.delta_w_P - dw) / found.sigma_delta_w_P
    return np.append((found.delta_v_N - dv) / found.sigma_delta_v_N, of_rate)


@pytest.mark.parametrize("push", [LONG, HIT], ids=["seconds long", "a hit"])
def test_a_push_is_found_followed_and_recovered(push: Push) -> None:
    sequence = pushed(push, 1)
    estimate = estimated(sequence)
    assert estimate.disturbances is not None and len(estimate.disturbances.impulses) == 1
    found = estimate.disturbances.impulses[0]
    # the smear of a push may add steps, the first and the last may pass for disturbances
    assert 1e9 * (push[0] - 2.0) <= found.start_ns <= 1e9 * (push[0] + 0.5)
    assert 1e9 * (push[0] + push[1] - 0.5) <= found.end_ns <= 1e9 * (push[0] + push[1] + 2.0)
    assert np.abs(push_deviation(found, push, sequence, estimate)).max() < 4.0
    assert np.linalg.norm(found.sigma_delta_v_N) < 0.3 * np.linalg.norm(found.delta_v_N)
    assert np.linalg.norm(found.sigma_delta_w_P) < 0.15 * np.linalg.norm(found.delta_w_P)
    z = deviations(sequence, estimate)
    assert np.mean(np.abs(z) < 3.0) > 0.98 and np.mean(z**2) < 1.6
    # the push does not pass for disturbances that act all the time
    assert estimate.noise.torque_psd < 1e-5 and estimate.mass.identifiable.k1
    assert abs(estimate.mass.k1 - sequence.truth.k1) < 4.0 * np.sqrt(estimate.mass.cov_k[0, 0]) < 0.05
    assert any("an unknown disturbance acted on the target" in text for text in estimate.warnings)


def test_nothing_is_found_where_nothing_pushes() -> None:
    for seed, psd, outliers in ((1, 1e-8, 0.0), (2, 1e-6, 0.0), (3, 3e-6, 0.05)):
        scene = replace(FREE, accel_psd=psd, torque_psd=psd, outliers=outliers)
        assert estimated(generate(scene, seed)).disturbances is None


def test_steps_of_stated_times_have_a_node_and_no_others() -> None:
    dt_s = np.full(6, 0.5)
    np.testing.assert_array_equal(steps_with_nodes(((0.6, 1.2),), False, dt_s), [0, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(steps_with_nodes(((0.5, 1.0), (2.9, 9.0)), False, dt_s), [0, 1, 0, 0, 0, 1])
    assert steps_with_nodes((), True, dt_s).all() and not steps_with_nodes((), False, dt_s).any()


def test_a_push_at_stated_times_is_recovered_without_a_search() -> None:
    sequence = pushed(LONG, 4)
    stated = Backend(
        solver="gauss_newton", unknown_wrench="none", unknown_wrench_s=((7.0, 10.0),),
        unknown_acceleration=5e-3, unknown_angular_acceleration=0.1,
    )  # fmt: skip
    estimate = estimated(sequence, stated)
    assert estimate.disturbances is not None and len(estimate.disturbances.accel_N) == 6
    assert np.abs(push_deviation(estimate.disturbances.impulses[0], LONG, sequence, estimate)).max() < 4.0
    assert np.mean(np.abs(deviations(sequence, estimate)) < 3.0) > 0.98


def test_with_a_wide_node_in_every_step_the_poses_are_followed_and_nothing_else_is_claimed() -> None:
    sequence = pushed(LONG, 5)
    config = Backend(solver="gauss_newton", unknown_wrench="everywhere", process_noise="given")
    estimate = estimated(sequence, config)
    known = estimate.mass.identifiable
    assert not (known.k1 or known.k2 or known.axes or known.com)
    assert estimate.disturbances is not None and np.isinf(estimate.disturbances.sigma_angular_accel_P).all()
    R_NG, R_true = estimate.X_NG[:, :3, :3], sequence.X_NG[:, :3, :3]
    turned = log_so3(np.swapaxes(R_NG[0].T @ R_NG, 1, 2) @ (R_NG[0].T @ R_true @ R_true[0].T @ R_NG[0]))
    # twenty observations of 1 px in a frame
    assert np.rad2deg(np.sqrt(np.mean(np.sum(turned**2, axis=1)))) < 2.0
