"""What a second method of the front end adds is taken unless it fits worse, and stands in for the first."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.run_directory.trajectory_file import read_trajectory
from polhode.simulation.monte_carlo import SyntheticScene, generate
from tests.pipeline.synthetic_front_end import FRAMES, NO_WINDOW, SCENE, Outcome

STILL = replace(SCENE, accel_psd=0.0, torque_psd=0.0)
"""Without disturbances the motion of two sequences is one, whatever is measured of it."""
OTHER = replace(STILL, landmarks=150)
"""What the second method measures."""
Run = Callable[[SyntheticScene, SyntheticScene | None], Outcome]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    made = partial(Outcome, tmp_path, monkeypatch, capfd)
    return lambda first, second: made(first, *NO_WINDOW, second=second)


def test_frames_that_the_first_method_loses_are_found_by_the_second(run: Run) -> None:
    outcomes = [run(replace(STILL, dropped=(5, 6, 7)), second) for second in (None, OTHER)]
    assert [each.summary["frames_used"] for each in outcomes] == [FRAMES - 3, FRAMES]
    alone, both = (each.summary["observations"] for each in outcomes)
    assert both > 1.5 * alone
    found, truth = read_trajectory(outcomes[1].folder), generate(STILL, 1).truth
    error = np.linalg.norm(found.w_P, axis=1) - np.linalg.norm(truth.w_P, axis=1)
    assert np.all(np.abs(error) < 3.0 * np.linalg.norm(found.sigma_w, axis=1))


def test_what_fits_worse_sees_nothing_or_breaks_changes_nothing(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = run(STILL, None)
    assert alone.code == 0 and alone.log.count("motion and inertia") <= 3
    both = run(STILL, replace(OTHER, sigma_uv_px=1.2))
    assert "the second feature method brings no improvement and is not used" in both.log

    def broken(*_: Any, **__: Any) -> None:
        raise ValueError("no such thing")

    monkeypatch.setattr("polhode.pipeline.correspondences.combine_features", broken)
    failed = run(STILL, OTHER)
    assert "the second feature method failed" in failed.log and "no such thing" in failed.log
    for each in (both, failed):
        assert each.code == 0 and each.summary["observations"] == alone.summary["observations"]
        q, expected = (read_trajectory(one.folder).q_NP_wxyz for one in (each, alone))
        np.testing.assert_array_equal(q, expected)


@pytest.mark.parametrize("fault", [{"outliers": 1.0}, {"dropped": tuple(range(1, FRAMES))}])
def test_the_second_method_stands_in_where_the_first_finds_no_motion_or_sees_nothing(
    run: Run, fault: dict[str, Any]
) -> None:
    outcome = run(replace(STILL, **fault), OTHER)
    assert (outcome.code, outcome.summary["status"], outcome.summary["frames_used"]) == (0, "ok", FRAMES)
    assert "the second feature method is tried" in outcome.log
