"""A limit cycle stays in its band, moves continuously, and repeats with its seed."""

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.simulation.motion.inspector import PULSE_S, RATE_VARIATION, LimitCycle, limit_cycle

T_S = np.linspace(0.0, 300.0, 300_000)


def _cycle(half_width: float = 0.01, rate: float = 0.004, stop_s: float = 301.0, seed: int = 1) -> LimitCycle:
    return limit_cycle(half_width, rate, stop_s, np.random.default_rng(seed))


def _slope(cycle: LimitCycle) -> Array:
    """Rate (n,) at ``T_S``, by central differences."""
    return np.asarray((cycle.value(T_S + 1e-6) - cycle.value(T_S - 1e-6)) / 2e-6)


@pytest.mark.parametrize(("half_width", "rate"), [(0.01, 0.004), (0.001, 0.02)])
def test_it_starts_in_the_middle_and_fills_its_band_without_leaving_it(
    half_width: float, rate: float
) -> None:
    cycle = _cycle(half_width, rate)
    value = cycle.value(T_S)
    assert cycle.value(np.zeros(1))[0] == 0.0
    assert np.abs(value).max() <= half_width
    assert value.max() > 0.9 * half_width
    assert value.min() < -0.9 * half_width


def test_between_pulses_it_drifts_near_the_nominal_rate_and_velocity_is_continuous() -> None:
    cycle = _cycle()
    slope = _slope(cycle)
    pulsing = np.abs(T_S[:, None] - cycle.corner_s).min(axis=1) < PULSE_S / 2
    rates = np.unique(np.abs(slope[~pulsing]).round(8))
    assert 40 < len(rates) < 80
    assert 0.004 * (1 - RATE_VARIATION) <= rates.min() < rates.max() <= 0.004 * (1 + RATE_VARIATION)
    assert pulsing.mean() == pytest.approx(
        PULSE_S * len(cycle.corner_s[cycle.corner_s < 300]) / 300, rel=0.05
    )
    rate = _cycle().rate
    assert (rate[1:] * rate[:-1] < 0).all()
    largest_step = 2 * 0.004 * (1 + RATE_VARIATION) / PULSE_S * (T_S[1] - T_S[0])
    assert np.abs(np.diff(_slope(_cycle()))).max() <= largest_step * 1.001 + 1e-8
    np.testing.assert_array_equal(_cycle(stop_s=100.0).value(T_S[:90_000]), _cycle().value(T_S[:90_000]))
    assert np.abs(_cycle(seed=2).value(T_S) - _cycle().value(T_S)).max() > 0.005


@pytest.mark.parametrize(("half_width", "rate"), [(0.0, 1.0), (1.0, 0.0)])
def test_without_band_or_drift_it_rests(half_width: float, rate: float) -> None:
    cycle = _cycle(half_width, rate)
    np.testing.assert_array_equal(cycle.value(T_S), 0.0)
