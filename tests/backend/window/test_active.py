"""Marginalization in a linear-Gaussian case: the arrival cost equals the batch."""

import numpy as np

from polhode.backend.window.frame import Frame
from polhode.backend.window.history import ActiveWindow, Part, add_parts
from polhode.backend.window.problem import Quadratic
from polhode.geometry.lie import Array


def frame(number: int, noisy: bool) -> Frame:
    x = np.random.default_rng(number).normal(0.0, 0.1, 12)
    information = np.eye(6) if noisy else None
    return Frame(number, float(number), np.eye(4), np.eye(3), x, camera_information=information)


def random_information(n: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng([seed, n])
    A = rng.normal(size=(n, n))
    return A @ A.T, rng.normal(size=n)


def filled(noisy: bool) -> tuple[ActiveWindow, list[Part]]:
    active = ActiveWindow(
        noisy_camera=noisy, keys=[frame(0, noisy)], recent=[frame(1, noisy), frame(2, noisy)]
    )
    n = len(active.vector())
    active.arrival = Quadratic(*random_information(n, 1), active.vector() + 0.1)
    parts: list[Part] = [
        (np.arange(n)[4:20], *random_information(16, 2)),
        (np.arange(n)[-12:], *random_information(12, 3)),
    ]
    return active, parts


def test_absorbing_and_forgetting_in_any_order_is_the_marginal_of_all() -> None:
    for noisy in (False, True):
        active, parts = filled(noisy)
        x, gone = active.vector(), np.array([7, 8, 9])
        H, g = active.arrival.H.copy(), active.arrival.gradient(x)
        add_parts(H, g, parts)
        active.absorb(parts, gone)
        kept = np.setdiff1d(np.arange(len(x)), gone)
        covariance = np.linalg.inv(H)[np.ix_(kept, kept)]
        np.testing.assert_allclose(np.linalg.inv(active.arrival.H), covariance, rtol=1e-6, atol=1e-9)
        best = x[kept] - np.linalg.solve(H, g)[kept]
        found = active.arrival.x0 - np.linalg.solve(active.arrival.H, active.arrival.g)
        np.testing.assert_allclose(found, best, atol=1e-7)


def test_a_new_frame_is_unknown_to_the_arrival_cost_and_the_rest_stays() -> None:
    for noisy in (False, True):
        active, _ = filled(noisy)
        before, x = active.arrival, active.vector()
        active.recent.append(frame(3, noisy))
        active.extend_arrival()
        after = active.arrival
        assert len(after.g) == len(active.vector()) == len(before.g) + (18 if noisy else 12)
        new = np.flatnonzero(np.all(after.H == 0.0, axis=0))
        old = np.setdiff1d(np.arange(len(after.g)), new)
        np.testing.assert_array_equal(after.H[np.ix_(old, old)], before.H)
        np.testing.assert_array_equal(after.x0[old], before.x0)
        np.testing.assert_array_equal(active.vector()[old], x)
