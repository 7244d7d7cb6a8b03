"""The statistics of the accuracy tables, on errors that were drawn from their own covariance."""

import numpy as np

from benchmarks.monte_carlo.accuracy import MOTIONS, consistency, over_bound, same_sequences
from benchmarks.monte_carlo.bound import COMPONENTS
from benchmarks.record import Case

FREEDOM = np.array([9.0, 150.0, 4.0, 75.0, 3.0, 5.0])


def drawn(seed: int, scale: float = 1.0, sequences: int = 40) -> list[Case]:
    """Mean normalised squares as chi-squares of their freedom, errors ``scale`` times too large."""
    rng = np.random.default_rng(seed)
    lines = []
    for _ in range(sequences):
        relative = scale**2 * rng.chisquare(FREEDOM) / FREEDOM
        bound = rng.uniform(0.5, 2.0, 6)
        nees = relative * COMPONENTS
        lines.append({"squares": relative * bound, "bound": bound, "nees": nees, "freedom": FREEDOM})
    return lines


def test_honest_sigmas_fall_into_the_band_in_95_percent() -> None:
    inside = []
    for seed in range(60):
        nees, low, high = consistency(drawn(seed))
        inside.append((nees > low) & (nees < high))
    assert 0.91 < np.mean(inside) < 0.99


def test_sigmas_that_are_30_percent_too_small_fall_out_of_it() -> None:
    nees, _, high = consistency(drawn(0, scale=1.0 / 0.7))
    assert np.all(nees > high)


def test_the_ratio_to_the_bound_is_that_of_the_errors() -> None:
    np.testing.assert_allclose(over_bound(drawn(1, scale=1.2, sequences=400)), 1.2, rtol=0.08)


def test_an_undetermined_quantity_of_a_sequence_does_not_count() -> None:
    lines = drawn(2)
    lines[0]["nees"] = np.full(6, np.nan)
    lines[0]["freedom"] = FREEDOM
    nees, low, high = consistency(lines)
    assert np.all(np.isfinite(nees)) and np.all((low < nees) & (nees < high))


def test_there_are_at_least_six_motions() -> None:
    assert len(MOTIONS) >= 6 and all(scene.frames == 115 for scene in MOTIONS.values())


def test_only_the_same_sequences_are_set_side_by_side() -> None:
    def line(seed: int, noise: float) -> Case:
        return {"case": {"motion": "tumble", "noise_px": noise, "seed": seed}}

    pairs = same_sequences(
        [line(0, 1.0), line(1, 1.0), line(1, 0.3)], [line(1, 1.0), line(2, 1.0), line(0, 0.3)]
    )
    assert pairs == [(line(1, 1.0), line(1, 1.0))]
