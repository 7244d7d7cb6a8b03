"""What counts as wrong, and as missed."""

import numpy as np

from benchmarks.monte_carlo.convergence import KINDS, missed, scene_of, wrong
from benchmarks.record import Case

FINE = [1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02, 0.02, 0.02]


def line(errors: list[float], sigma: list[float | None], known: bool = True) -> Case:
    return {"errors": errors, "sigma": sigma, "determined_at_truth": [known] * 8}


def test_wrong_is_beyond_five_sigma_and_beyond_the_tolerance() -> None:
    errors = [0.0] * 8
    errors[0], errors[3], errors[5] = 0.004, 0.12, 0.2
    sigma: list[float | None] = [*FINE]
    sigma[5] = None
    np.testing.assert_array_equal(np.flatnonzero(wrong(line(errors, sigma))), [3])
    # many sigmas, but nothing that matters
    assert not wrong(line([1e-4] * 8, [1e-6] * 8)).any()


def test_a_scene_is_missed_when_it_fails_errs_or_hides_what_it_could_know() -> None:
    assert not missed(line([1e-3] * 8, [*FINE]))
    assert missed({"failure": "no consistent motion", "determined_at_truth": [True] * 8})
    assert missed(line([0.3] * 8, [*FINE]))
    assert missed(line([0.3] * 8, [None] * 8))
    # too careful, but right
    assert not missed(line([1e-3] * 8, [None] * 8))


def test_the_scenes_are_the_same_every_time_and_of_all_kinds() -> None:
    kinds = {scene_of(seed)[0] for seed in range(len(KINDS))}
    assert kinds == set(KINDS)
    (_, first), (_, again) = scene_of(8), scene_of(8)
    assert first.w_G == again.w_G and first.J_G is not None and again.J_G is not None
    np.testing.assert_array_equal(first.J_G, again.J_G)
    for seed in range(12):
        second = 0.5 * np.trace(J := np.asarray(scene_of(seed)[1].J_G)) * np.eye(3) - J
        assert np.linalg.eigvalsh(second)[0] > 0.0
