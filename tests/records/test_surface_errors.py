"""Sigmas of a surface against the truth, and the part of an error that does not average out over a patch."""

import numpy as np
import pytest
import trimesh

from polhode.records.surface import ErrorCorrelation
from polhode.records.surface_errors import mean_correlation, sigma_of_mean, sigma_shares

SIGMA_M = 1e-3
ALL_OVER, NOWHERE = (ErrorCorrelation(1.0, np.inf),), (ErrorCorrelation(1.0, 1e-3),)


def sheet(height_m: np.ndarray | float, count: int = 60) -> trimesh.Trimesh:
    """A square of 0.6 m with a vertex every centimetre, at these heights (count * count,)."""
    x, y = np.meshgrid(np.arange(count) * 0.01, np.arange(count) * 0.01, indexing="ij")
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + count, corner + 1], axis=1),
            np.stack([corner + 1, corner + count, corner + count + 1], axis=1),
        ]
    )
    z = np.broadcast_to(height_m, x.size)
    return trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z], axis=-1), faces, process=False)


def test_the_mean_over_a_disc_agrees_with_sampling() -> None:
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.uniform(size=(2, 200_000))), rng.uniform(0.0, 2.0 * np.pi, (2, 200_000))
    points = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    distance = np.linalg.norm(points[0] - points[1], axis=1)
    for ratio in (0.1, 0.5, 1.0, 3.0, 10.0):
        found = mean_correlation(ratio, (ErrorCorrelation(1.0, 1.0),))
        assert found == pytest.approx(np.exp(-ratio * distance).mean(), rel=0.1)
    assert mean_correlation(5.0, ALL_OVER) == 1.0
    # what all vertices share does not average out
    sigma = np.full(50, SIGMA_M)
    assert sigma_of_mean(sigma, 0.1, ALL_OVER) == pytest.approx(SIGMA_M)
    assert sigma_of_mean(sigma, 0.1, NOWHERE) < 0.02 * SIGMA_M


def test_right_sigmas_hold_two_thirds_and_nearly_all() -> None:
    rng, truth = np.random.default_rng(1), sheet(0.0)
    noisy = sheet(rng.normal(0.0, SIGMA_M, 60 * 60))
    shares = sigma_shares(noisy, np.full(60 * 60, SIGMA_M), truth, None)
    assert shares["within_one_sigma"] == pytest.approx(0.683, abs=0.02)
    assert shares["within_three_sigma"] == pytest.approx(0.997, abs=0.003)
    assert shares["patches_within_one_sigma"] is None
    halved = sigma_shares(noisy, np.full(60 * 60, 0.5 * SIGMA_M), truth, None)
    assert halved["within_one_sigma"] == pytest.approx(0.383, abs=0.02)


def test_a_common_offset_shows_in_patches_alone() -> None:
    lifted, truth = sheet(2.0 * SIGMA_M), sheet(0.0)
    short = (ErrorCorrelation(0.5, 0.01), ErrorCorrelation(0.5, 0.1))
    shares = sigma_shares(lifted, np.full(60 * 60, 2.5 * SIGMA_M), truth, short)
    assert shares["within_one_sigma"] == 1.0 and shares["patches_within_one_sigma"] == 0.0
    # what was not measured does not count
    nothing = sigma_shares(lifted, np.full(60 * 60, np.inf), sheet(0.0), ALL_OVER)
    assert set(nothing.values()) == {None}
