"""compare.json: its schema is shipped, and what is not a comparison is refused in a line."""

import json
from pathlib import Path

import jsonschema
import pytest

from pipeline.compare.profiles import front, growths, performance_profiles, successes
from pipeline.compare.rows import (
    SCHEMA_FILE,
    Comparison,
    ProblemWords,
    Row,
    read_comparison,
    schema_text,
    write_comparison,
)
from pipeline.compare.table import csv_text, verdict
from polhode.errors import InputError


def row(solver: str, cost: float | None, wall_s: float, **more: object) -> Row:
    content = {
        "problem": "a", "solver": solver, "start": "cold", "seed": 0, "family": "tests", "claim": "ok",
        "status": "ok", "message": "converged", "cost": cost, "gain_left": 0.0, "iterations": 3,
        "wall_s": wall_s, "build_s": 0.0, "evaluation_s": 0.0, "linear_s": wall_s, "callback_s": 0.0,
        "memory_mb": 1.0,
        "memory_before_mb": 1.0, "k1": 0.1, "k2": 0.1, "sigma_k1": None, "sigma_k2": None,
        "sigma_com_mm": None, "errors": None, "trace": [(0.0, 5.0), (wall_s, cost or 1.0)],
    }  # fmt: skip
    return Row.model_validate({**content, **more})


def comparison(rows: list[Row]) -> Comparison:
    sizes = {name: 100 * 2**n for n, name in enumerate(dict.fromkeys(each.problem for each in rows))}
    problems = [
        ProblemWords(
            name=name, source="tests", fingerprint="0", frames=2, landmarks=3, observations=4, unknowns=size,
            accel_psd=1e-6, torque_psd=1e-6, prepared_s=0.1, sigma_k1=None, sigma_k2=None, sigma_com_mm=None,
        )
        for name, size in sizes.items()
    ]  # fmt: skip
    return Comparison(limit_s=60.0, machine="m", versions={}, problems=problems, rows=rows)


def test_the_shipped_schema_is_that_of_the_models() -> None:
    assert SCHEMA_FILE.read_text() == schema_text()


def test_what_is_written_obeys_the_schema_and_comes_back(tmp_path: Path) -> None:
    written = comparison([row("x", 10.0, 1.0), row("y", None, 2.0, status="failed")])
    write_comparison(written, tmp_path / "compare.json")
    content = json.loads((tmp_path / "compare.json").read_text())
    jsonschema.validate(content, json.loads(SCHEMA_FILE.read_text()))
    assert {"solver", "status", "cost", "iterations", "wall_s"} <= content["rows"][0].keys()
    assert read_comparison(tmp_path / "compare.json") == written
    lines = csv_text(written.rows).splitlines()
    assert len(lines) == 3 and lines[0].startswith("problem,solver,start")


def test_another_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "compare.json").write_text('{"rows": []}')
    with pytest.raises(InputError, match=r"compare\.json: not a comparison"):
        read_comparison(tmp_path / "compare.json")
    with pytest.raises(InputError, match="no such file"):
        read_comparison(tmp_path / "other.json")


def test_profiles_count_what_was_solved_at_the_least_cost() -> None:
    rows = [
        row("fast", 10.0, 1.0),
        row("slow", 10.0, 3.0),
        row("wrong", 11.0, 0.1),
        row("fast", 20.0, 4.0, problem="b"),
        row("slow", 20.0, 2.0, problem="b"),
        row("wrong", 20.0, 9.0, problem="b", status="failed"),
    ]
    found = {each.solver: each for each in performance_profiles(comparison(rows))}
    assert found["fast"].factor.tolist() == [1.0, 1.0, 2.0, 100.0]
    assert found["fast"].share.tolist() == [0.0, 0.5, 1.0, 1.0]
    assert found["slow"].factor.tolist() == [1.0, 1.0, 3.0, 100.0]
    assert found["wrong"].share.tolist() == [0.0, 0.0]
    assert successes(comparison(rows))["wrong"] == {"cold": (0, 2)}


def test_growth_is_fitted_to_three_sizes() -> None:
    rows = [row("x", 10.0, 1.0 * 4.0**n, problem=name) for n, name in enumerate("abc")]
    (found,) = growths(comparison(rows))
    assert found.exponent == pytest.approx(2.0)
    assert growths(comparison(rows[:2])) == []


def test_the_front_holds_the_fastest_of_the_accurate() -> None:
    rows = [
        row("slow and good", 10.0, 5.0),
        row("good", 10.0 + 1e-7, 2.0),
        row("rough", 12.0, 0.5, status="baseline", claim="baseline"),
        row("slow and rough", 13.0, 1.0, status="baseline", claim="baseline"),
        row("failed", 10.0, 0.1, status="failed"),
    ]
    assert [each.solver for each in front(rows)] == ["rough", "good"]
    assert "2 rows claim convergence" in verdict(rows, 10.0)
