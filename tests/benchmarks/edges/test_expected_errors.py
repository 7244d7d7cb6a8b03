"""Trials of the tracker of stripes that are hard: another pose explains more of its own edges."""

import numpy as np
import pytest

from benchmarks.edges.expected_errors import MODELS, _pairs, cases, trials_of
from benchmarks.edges.observability import RIG, START_DEG, START_M, levels, off_px
from polhode.planning.edges.visible_edges import SPACING_PX, control_points


@pytest.mark.parametrize(
    ("body", "pose", "model", "image"),
    [
        ("house", 6, "half", 7),
        ("wedge", 1, "half", 23),
        ("steps", 2, "half", 5),
        ("block", 5, "three quarters", 17),
    ],
)
def test_the_pose_that_explains_most_edges_is_taken(body: str, pose: int, model: str, image: int) -> None:
    # poses 6 to 20 px off have a larger share of the few edges that would be in sight there
    which = {"range": "2 to 4 m", "body": body, "pose": pose}
    case = next(case for case in cases(short=False) if which.items() <= case.items())
    trials = trials_of(case)
    chosen = levels(trials.whole)[MODELS.index(model)]
    found = trials.tracked(trials.image(image), chosen, image)
    p_G = control_points(trials.whole, RIG, trials.true_X_RG[image], SPACING_PX).p_G
    assert found.converged and off_px(p_G, found.X_RG, trials.true_X_RG[image]) < 0.5


def test_pairs_that_are_not_determined_have_the_error_of_the_start() -> None:
    exact, open_ended = 1e-6 * np.eye(6), np.diag([np.inf, 1e-6, 1e-6, 1e-6, 1e-6, np.nan])
    trial = {"error": [0.0] * 6, "settled": True, "agreement": 0.9, "covariance": [0.0] * 21}
    told = [
        {"expected": each.tolist(), "displacement": exact.tolist(), "plain": [1.0] * 6, "trials": [trial]}
        for each in (exact, open_ended, exact)
    ]
    first, second, third = _pairs({"case": {"body": "block", "range": "3 m"}, "models": told})
    assert (first.determined, second.determined, third.determined) == (True, False, True)
    np.testing.assert_allclose(first.expected, 1e-3)
    np.testing.assert_allclose(second.expected, [START_M, *[1e-3] * 4, np.deg2rad(START_DEG)])
