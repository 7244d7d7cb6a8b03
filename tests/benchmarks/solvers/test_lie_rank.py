"""The rank test of the thesis's chapter 3, against its results, physics and finite differences."""

import casadi as ca
import numpy as np
import pytest

from benchmarks.solvers.lie_rank import (
    System,
    evaluate,
    measured_poses,
    measured_rates,
    observability,
)
from polhode.lie import matrix_from_wxyz, wxyz_from_matrix
from polhode.rigid_body import propagate

BOX = [1.5, 1.2, 0.9]


def pose_state(w: list[float], J: list[float]) -> np.ndarray:
    q = np.array([0.5, 0.5, -0.5, 0.5])
    return np.array([0.1, 0.2, 0.6, 0.01, 0.02, -0.01, *q, *w, 0.01, 0.02, -0.03, *J, 0.0, 0.0, 0.0])


def test_rank_five_of_six_and_the_null_vector_is_the_inertia_itself() -> None:
    function = measured_rates().observability_matrix(1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        second = rng.uniform(0.2, 2.0, 3)
        J = second.sum() - second
        matrix = evaluate(function, np.concatenate([rng.normal(size=3), J]))
        found = observability(matrix)
        assert found.rank == 5
        # eq. 3.15 without its minus signs
        null = np.concatenate([np.zeros(3), J]) / J[2]
        np.testing.assert_allclose(matrix @ null, 0.0, atol=1e-12)
        assert np.linalg.norm(matrix @ (null * [1, 1, 1, -1, -1, 1])) > 1e-3
        np.testing.assert_allclose(found.null_space[:, 0] / found.null_space[5, 0], null, atol=1e-9)


def test_higher_derivatives_do_not_show_the_scale() -> None:
    for order in (2, 3, 5):
        found = observability(
            evaluate(measured_rates().observability_matrix(order), np.array([0.4, 0.5, 0.45, *BOX]))
        )
        assert found.rank == 5


def test_the_matrix_as_printed_in_equation_3_14_has_rank_three() -> None:
    matrix = evaluate(measured_rates().observability_matrix(1), np.array([0.4, 0.5, 0.45, *BOX]))
    assert observability(np.vstack([matrix[:3], matrix[:3]])).rank == 3


@pytest.mark.parametrize(
    ("w", "J", "of_rates", "of_poses"),
    [
        ([0.4, 0.5, 0.45], BOX, 5, 21),
        ([0.4, 0.1, 0.6], [1.3, 1.3, 0.8], 5, 21),
        ([0.8, 0.1, 0.0], BOX, 5, 21),
        ([0.0, 0.0, 0.8], BOX, 3, 17),
        ([0.8, 0.0, 0.0], BOX, 3, 17),
        ([0.4, 0.1, 0.6], [1.0, 1.0, 1.0], 5, 17),
        ([0.0, 0.0, 0.0], BOX, 3, 13),
    ],
    ids=["tumble", "axisymmetric", "a rate passes zero", "pure spin", "flat spin", "ball", "rest"],
)
def test_the_rank_follows_the_motion(w: list[float], J: list[float], of_rates: int, of_poses: int) -> None:
    rates, poses = measured_rates().observability_matrix(4), measured_poses().observability_matrix(4)
    assert observability(evaluate(rates, np.array([*w, *J]))).rank == of_rates
    assert observability(evaluate(poses, pose_state(w, J))).rank == of_poses


def test_a_pure_spin_hides_the_shift_along_it_but_not_across() -> None:
    found = observability(
        evaluate(measured_poses().observability_matrix(4), pose_state([0.0, 0.0, 0.8], BOX))
    )
    # a shift of the centre of mass along z, r_N following it, is hidden; any other shift is not
    com = found.null_space[13:16]
    np.testing.assert_allclose(com[:2], 0.0, atol=1e-9)
    assert np.abs(com[2]).max() > 0.1


def test_lie_derivatives_are_the_time_derivatives_of_the_measurement() -> None:
    system = measured_poses()
    w, J = [0.4, 0.5, 0.45], [1.5, 1.2, 0.9]
    state = pose_state(w, J)
    derivatives = ca.Function("lie", [system.x], system.lie_derivatives(2))
    h, h1, h2 = (np.asarray(each).ravel() for each in derivatives(state))
    step = 1e-3
    around = [_measured(system, state, t) for t in (-step, step)]
    np.testing.assert_allclose((around[1] - around[0]) / (2 * step), h1, atol=1e-6)
    np.testing.assert_allclose((around[1] - 2 * h + around[0]) / step**2, h2, atol=1e-5)


def _measured(system: System, state: np.ndarray, t: float) -> np.ndarray:
    """h after t seconds of the free motion, by the rigid body's own integrator."""
    J = np.diag(state[16:19])
    sign = 1.0 if t > 0 else -1.0
    # backwards in time: the same equations with v and w reversed
    r, v, R, w = propagate(
        [0.0, abs(t)], state[:3], sign * state[3:6], matrix_from_wxyz(state[6:10]), sign * state[10:13], J
    )
    q = wxyz_from_matrix(R[-1])
    q = q * np.sign(q @ state[6:10])
    after = np.concatenate([r[-1], sign * v[-1], q, sign * w[-1], state[13:]])
    return np.asarray(ca.Function("h", [system.x], [system.h])(after)).ravel()
