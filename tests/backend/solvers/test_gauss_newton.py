"""The order in which steps are made shorter, and how that is taken back."""

from polhode.backend.solvers.gauss_newton import Damping


def test_both_ways_grow_apart_and_end() -> None:
    start, before = Damping(), Damping()
    for times in range(1, 3):
        firm, stiff = start.more(times)
        # one lengthens nothing but the constants' share, the other damps all
        assert firm.of_constants > before.of_constants and firm.of_all == start.of_all
        assert stiff.of_all > before.of_all and stiff.of_constants == 0.0
        before = Damping(stiff.of_all, firm.of_constants)
    assert start.more(30) == []


def test_an_accepted_step_takes_damping_back_to_nothing() -> None:
    damping = Damping(of_all=1e-3, of_constants=10.0)
    for _ in range(8):
        damping = damping.less()
    assert damping == Damping()
