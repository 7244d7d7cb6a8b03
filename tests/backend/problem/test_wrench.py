"""Impulses of a known wrench, and its unknowns."""

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.backend.problem.wrench import N_WRENCH, impulses_of, torque_in_G, wrench_residual
from polhode.geometry.lie import Array, exp_so3
from polhode.records.tracks import Wrench

STAMPS = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(5, dtype=np.int64)


def pushes() -> Wrench:
    """On from 0.7 s, weaker from 1.3 s; the first row says nothing, the last one holds on."""
    time_ns = STAMPS[0] + np.array([-(10**9), 700_000_000, 1_300_000_000], dtype=np.int64)
    rows = np.array([[0.0] * 6, [1.0, 2.0, 3.0, -1.0, 0.5, 0.2], [0.5, 0.0, -1.0, 0.1, 0.2, 0.3]])
    return Wrench(time_ns, rows[:, :3], rows[:, 3:])


def at(wrench: Wrench, time_s: Array) -> Array:
    row = np.searchsorted((wrench.time_ns - STAMPS[0]) * 1e-9, time_s, side="right") - 1
    return np.asarray(np.hstack([wrench.force_N, wrench.torque_P])[row])


def test_the_force_moves_a_kilogram_as_its_rows_say() -> None:
    wrench = pushes()
    moved = impulses_of(wrench, STAMPS).force_increments
    for k in range(4):
        t = 0.5 * k + np.linspace(0.0, 0.5, 200_001)[:-1] + 1.25e-6
        force = at(wrench, t)[:, :3]
        np.testing.assert_allclose(moved[k, 1], force.mean(axis=0) * 0.5, atol=1e-5)
        left = (0.5 * (k + 1) - t)[:, None]
        np.testing.assert_allclose(moved[k, 0], (force * left).mean(axis=0) * 0.5, atol=1e-5)


def test_each_series_has_the_torque_s_impulse_and_first_moment() -> None:
    wrench, series = pushes(), np.array([1, 4, 2, 1])
    torque = impulses_of(wrench, STAMPS).torque(series)
    assert torque.shape == (4, 4, 2, 3)
    for k, n in enumerate(series):
        for j in range(n):
            h = 0.5 / n
            s = np.linspace(0.0, 1.0, 100_001)[:-1] + 5e-6
            known = at(wrench, 0.5 * k + h * (j + s))[:, 3:]
            line = torque[k, j, 0] + np.outer(s, torque[k, j, 1])
            np.testing.assert_allclose(line.mean(axis=0), known.mean(axis=0), atol=1e-4)
            np.testing.assert_allclose(
                (s[:, None] * line).mean(axis=0), (s[:, None] * known).mean(axis=0), atol=1e-4
            )
    assert not torque[0, 1:].any()


def test_a_wrench_acts_in_the_steps_where_it_is_not_zero_even_if_it_cancels() -> None:
    impulses = impulses_of(pushes(), STAMPS)
    np.testing.assert_array_equal(impulses.acting, [False, True, True, True])
    none = Wrench(STAMPS[:1], np.zeros((1, 3)), np.zeros((1, 3)))
    assert not impulses_of(none, STAMPS).acting.any()
    # more series where a torque acts
    series = impulses.refine_series(np.ones(4, np.int64), np.tile([0.0, 2.0, 0.0], (4, 1)), np.full(4, 0.5))
    np.testing.assert_array_equal(series, [1, 4, 4, 4])
    time_ns = STAMPS[0] + 100_000_000 * np.arange(4, dtype=np.int64)
    force = np.outer([0.0, 1.0, -1.0, 0.0], [1.0, 0.0, 0.0])
    cancels = impulses_of(Wrench(time_ns, force, np.zeros((4, 3))), STAMPS)
    np.testing.assert_array_equal(cancels.acting, [True, False, False, False])
    np.testing.assert_allclose(cancels.force_increments[0, 1], 0.0, atol=1e-12)


def test_derivatives_of_the_torque_in_the_body_and_of_the_prior() -> None:
    rng = np.random.default_rng(0)
    M, dJ = rng.normal(size=(3, 3)), rng.normal(size=(5, 3, 3))
    unknowns, R_ref = rng.normal(size=N_WRENCH) * 0.3, Rotation.random(rng=rng).as_matrix()
    J, dJ = M @ M.T, dJ + np.swapaxes(dJ, 1, 2)
    torque_P = np.random.default_rng(1).normal(size=(2, 3, 2, 3))
    torque, derivatives = torque_in_G(torque_P, unknowns, R_ref)
    R = np.exp(-unknowns[0]) * R_ref @ exp_so3(unknowns[1:4])
    np.testing.assert_allclose(torque[1, 2, 0], R @ (torque_P[1, 2, 0] + unknowns[4:7]))
    np.testing.assert_allclose(torque[1, 2, 1], R @ torque_P[1, 2, 1])
    for n, e in enumerate(1e-6 * np.eye(N_WRENCH)[:7]):
        ends = [torque_in_G(torque_P, unknowns + s * e, R_ref)[0] for s in (1.0, -1.0)]
        np.testing.assert_allclose(derivatives[:, :, n], (ends[0] - ends[1]) / 2e-6, atol=1e-8)
    _, jacobian = wrench_residual(J, dJ, unknowns, R_ref, (0.2, 0.3))
    for n, e in enumerate(1e-6 * np.eye(5 + N_WRENCH)):
        change = np.tensordot(e[:5], dJ, 1)
        ends = [wrench_residual(J + s * change, dJ, unknowns + s * e[5:], R_ref, (0.2, 0.3))[0]
                for s in (1.0, -1.0)]  # fmt: skip
        np.testing.assert_allclose(jacobian[:, n], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-4)
