"""Checks and verdict against the truth: scores, curves and shares of a small record."""

from typing import Any

import numpy as np
import pytest

from benchmarks.robustness.measurement_faults import FAULTS, SCENE, Seen
from benchmarks.robustness.verdict import area, check_scores, curve, judged_runs, print_checks, print_verdict
from polhode.simulation.monte_carlo import SyntheticSequence, generate, random_scene


def line(step: float, shared: float, wrong: bool, fault: str = "step", status: str = "ok") -> dict[str, Any]:
    checks = {
        "step": (step, 2.0, step > 2.0),
        "shared": (shared, 6.0, shared < 6.0),
        "note": (1.0, None, False),
    }
    claims = {"position": {"worst_sigmas": 9.0 if wrong else 2.0}}
    wrong_names = ["position"] if wrong else []
    return {
        "case": {"scene": 0, "fault": fault},
        "status": status,
        "warnings": [],
        "checks": checks,
        "claims": claims,
        "wrong": wrong_names,
    }


LINES = [line(0.5 + 0.1 * n, 20.0, False, "none") for n in range(5)]
LINES += [line(3.0 + n, 20.0, True, status="degraded") for n in range(4)] + [line(1.0, 3.0, True)]


def test_scores_are_above_one_where_a_check_doubts() -> None:
    scores = check_scores(LINES)
    assert set(scores) == {"step", "shared"}
    assert scores["step"][0] == pytest.approx(0.25) and scores["step"][5] == pytest.approx(1.5)
    assert scores["shared"][0] == pytest.approx(0.3) and scores["shared"][-1] == pytest.approx(2.0)
    absent = check_scores([*LINES, {**LINES[0], "checks": {"step": (None, 2.0, False)}}])
    assert np.isnan(absent["step"][-1]) and np.isnan(absent["shared"][-1])


def test_wrong_and_good_runs_are_told_apart() -> None:
    runs = judged_runs([*LINES, {**LINES[0], "status": "failed"}])
    assert len(runs.lines) == 10 and runs.wrong.sum() == 5 and runs.good.sum() == runs.undisturbed.sum() == 5
    assert runs.said.tolist() == [False] * 5 + [True] * 4 + [False]


def test_area_and_curve_of_perfect_and_of_powerless_scores() -> None:
    assert area(np.array([2.0, 3.0]), np.array([0.0, 1.0])) == 1.0
    assert area(np.array([1.0, 1.0]), np.array([1.0, 1.0])) == 0.5
    doubted, found = curve(np.array([2.0, 3.0]), np.array([0.0, 1.0]))
    assert doubted[0] == found[0] == 0.0 and doubted[-1] == found[-1] == 1.0
    assert np.any((doubted == 0.0) & (found == 1.0))


def test_the_tables_say_what_passes_and_what_is_spoiled(capsys: pytest.CaptureFixture[str]) -> None:
    runs = judged_runs(LINES)
    print_verdict(runs)
    print_checks(runs, check_scores(LINES))
    words = capsys.readouterr().out
    assert "| wrong, status ok | 1 | 5 | 20.0 % |" in words
    assert "| undisturbed and good, spoiled | 0 | 5 | 0.0 % |" in words
    assert "| the verdict: largest of all | 5, 5 | 1.00 | 100% | 0.0% |" in words


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(random_scene(0, **SCENE | {"frames": 12, "landmarks": 80}), 0)


@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_a_fault_changes_what_it_says_and_grows_with_its_amount(
    fault: str, sequence: SyntheticSequence
) -> None:
    _, change, least, most = FAULTS[fault]
    sun_N = np.array([0.0, 0.6, -0.8])
    small, large = (
        change(Seen(sequence, sun_N, np.random.default_rng(1)), amount) for amount in (least, most)
    )
    before = sequence.tracks
    if fault == "none":
        assert large is before
    elif fault == "few":
        assert len(small.frame) < len(large.frame) < len(before.frame)
    elif fault == "focal":
        assert before.rig.focal_px < small.rig.focal_px < large.rig.focal_px
    elif fault == "clock":
        assert np.ptp(before.timestamps_ns) < np.ptp(small.timestamps_ns) < np.ptp(large.timestamps_ns)
    elif fault == "poses":
        assert np.abs(large.X_NR - before.X_NR).max() > np.abs(small.X_NR - before.X_NR).max() > 0.0
    else:
        moved = [np.sum(np.abs(each.uvd_px - before.uvd_px)) for each in (small, large)]
        assert moved[1] > moved[0] > 0.0
