"""Tables of docs/compare.md are those of the rows, printed by one command."""

from pathlib import Path

import pytest

from benchmarks.solvers import compare
from benchmarks.solvers.compare import (
    errors_table,
    growth_table,
    markdown,
    motions_table,
    profile_table,
)
from polhode.compare.ranking import performance_profiles
from polhode.compare.rows import Comparison, ProblemSummary, Row, write_comparison

ERRORS = {"position_mm": 1.0, "velocity_mm_s": 2.0, "attitude_deg": 0.5, "angular_velocity_deg_s": 0.25,
          "com_mm": 0.125, "k1": 0.01, "k2": -0.02}  # fmt: skip


def row(solver: str, problem: str, wall_s: float, **more: object) -> Row:
    content = {
        "problem": problem, "solver": solver, "start": "cold", "seed": 0, "family": "tests", "claim": "ok",
        "status": "ok", "message": "converged", "ran": True, "kept": "answer", "cost": 10.0, "gain_left": 0.0,
        "iterations": 3, "wall_s": wall_s, "build_s": 0.0, "evaluation_s": 0.0, "linear_s": wall_s,
        "not_separable": "", "callback_s": 0.0, "memory_mb": 200.0, "memory_before_mb": 150.0, "k1": 0.1,
        "k2": 0.1, "sigma_k1": None, "sigma_k2": None, "sigma_com_mm": None, "errors": ERRORS, "trace": [],
    }  # fmt: skip
    return Row.model_validate({**content, **more})


def comparison(rows: list[Row]) -> Comparison:
    names = list(dict.fromkeys(each.problem for each in rows))
    problems = [
        ProblemSummary(
            name=name, source="tests", fingerprint="0", frames=10 * 2**n, landmarks=3,
            observations=100 * 2**n, unknowns=9, accel_psd=1e-6, torque_psd=1e-6, prepared_s=0.1, truth=True,
            reference_cost=10.0, least_cost=10.0, sigma_k1=None, sigma_k2=None, sigma_com_mm=None,
        )
        for n, name in enumerate(names)
    ]  # fmt: skip
    found = Comparison(limit_s=60.0, machine="m", versions={}, problems=problems, rows=rows)
    return found.model_copy(update={"profiles": performance_profiles(found)})


@pytest.fixture
def three() -> Comparison:
    rows = [row("fast", name, 1.0 * 4.0**n) for n, name in enumerate("abc")]
    rows += [row("slow", name, 3.0 * 4.0**n) for n, name in enumerate("ab")]
    rows.append(row("slow", "c", 60.0, status="timeout", cost=11.0, errors=None))
    unknown = {
        "status": "missing",
        "ran": False,
        "kept": "nothing",
        "errors": None,
        "cost": None,
    }
    rows += [row("absent", name, 0.0, **unknown) for name in "abc"]
    return comparison(rows)


def test_motions_growth_and_profiles_are_those_of_the_rows(three: Comparison) -> None:
    assert motions_table(three).splitlines()[2:] == [
        "| fast | 3 / 1.0 | 3 / 4.0 | 3 / 16.0 |",
        "| slow | 3 / 3.0 | 3 / 12.0 | 3 / 60.0, timeout, cost +1.0e-01 |",
        "| absent | not run | not run | not run |",
    ]
    assert growth_table(three).splitlines()[2:] == ["| fast | 1.00 | 4.00 | 16.00 | 2.00 |"]
    assert profile_table(three).splitlines()[2:] == [
        "| fast | 3 | 0 | 100% | 100% | 100% | 100% | 100% |",
        "| slow | 3 | 0 | 0% | 0% | 67% | 67% | 67% |",
        "| absent | 0 | 3 |  |  |  |  |  |",
    ]


def test_solvers_with_the_same_errors_share_a_line(three: Comparison) -> None:
    assert errors_table(three).splitlines()[2:] == [
        "| a | fast, slow | 1.00 | 2.00 | 0.500 | 0.250 | 0.12 | +0.0100 | -0.0200 |",
        "| b | fast, slow | 1.00 | 2.00 | 0.500 | 0.250 | 0.12 | +0.0100 | -0.0200 |",
        "| c | fast | 1.00 | 2.00 | 0.500 | 0.250 | 0.12 | +0.0100 | -0.0200 |",
    ]


def test_what_is_stored_is_printed_and_nothing_is_measured(
    three: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "growth").mkdir()
    write_comparison(three, tmp_path / "growth" / "compare.json")
    monkeypatch.setattr(compare, "compare", lambda *_: pytest.fail("measured"))
    compare.main(stored=True, output=tmp_path)
    printed = capsys.readouterr().out
    assert markdown(three, "gauss_newton") in printed
    assert "a: on the front: fast\n" in printed
    assert "gauss_newton: on the front of time against accuracy on 0 of 3 problems" in printed
    assert "seeds: nothing stored" in printed


def test_one_problem_has_a_table_of_all_prices() -> None:
    found = comparison([row("x", "a", 1.5), row("y", "a", 2.0, evaluation_s=None, linear_s=None,
                                                not_separable="all in C++")])  # fmt: skip
    printed = markdown(found, "x")
    assert "| x | ok | 0.0e+00 | 3 | 1.50 | 0.00 | 0.00 | 1.50 | 0.00 | 200 | 150 |  |  |" in printed
    assert "| y | ok | 0.0e+00 | 3 | 2.00 | 0.00 | n/s | n/s | 0.00 | 200 | 150 |  |  |" in printed
    assert "n/s, not separable (y): all in C++" in printed
