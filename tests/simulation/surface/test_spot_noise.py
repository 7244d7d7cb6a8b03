"""The second generator's solid noise."""

import numpy as np

from polhode.simulation.surface.spot_noise import discs_at, folds_at, layered_spots_at, spots_at


def test_the_gradient_of_spots_is_that_of_their_sum() -> None:
    rng = np.random.default_rng(2)
    step = 1e-6
    for p in rng.uniform(-5, 5, (60, 3)):
        for noise in (spots_at, layered_spots_at):
            _, *gradient = noise(p[0], p[1], p[2], 7)
            for axis in range(3):
                d = step * np.eye(3)[axis]
                (a, b, c), (e, f, g) = p + d, p - d
                change = (noise(a, b, c, 7)[0] - noise(e, f, g, 7)[0]) / (2 * step)
                np.testing.assert_allclose(gradient[axis], change, atol=1e-5)


def test_spots_vary_and_stay_within_bounds() -> None:
    points = np.random.default_rng(0).uniform(-20, 20, (4000, 3))
    values = np.array([layered_spots_at(x, y, z, 3)[0] for x, y, z in points])
    assert 0.15 < values.std() < 0.6 and abs(values.mean()) < 0.05 and np.abs(values).max() < 4.0
    discs = np.array([discs_at(x, y, z, 3) for x, y, z in points])
    assert np.abs(discs).max() <= 1.0
    # Hard edges: most close neighbours have exactly the same value, some a very different one.
    jump = np.abs(discs - np.array([discs_at(p[0] + 0.02, p[1], p[2], 3) for p in points]))
    assert (jump == 0).mean() > 0.7 and (jump > 0.3).mean() > 0.02


def test_folds_are_flat_pieces_between_straight_creases() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-5, 5, (500, 3))
    here = np.array([folds_at(x, y, z, 5) for x, y, z in points])
    there = np.array([folds_at(x, y, z, 5) for x, y, z in points + 0.01])
    same = (here == there).all(axis=1)
    assert 0.6 < same.mean() < 0.99
    assert np.linalg.norm(here - there, axis=1)[~same].min() > 1e-3
    assert (np.array([folds_at(x, y, z, 6) for x, y, z in points]) != here).any()
