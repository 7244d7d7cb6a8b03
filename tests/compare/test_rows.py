"""compare.json: its schema is shipped, and what is not a comparison is refused in a line."""

import json
from pathlib import Path

import jsonschema
import pytest

from polhode.compare.page import write_page
from polhode.compare.rows import (
    SCHEMA_FILE,
    Comparison,
    ProblemSummary,
    Row,
    least_costs,
    read_comparison,
    schema_text,
    write_comparison,
)
from polhode.compare.tables import cells, csv_text, curve, performance_profiles, tallies
from polhode.runtime.errors import InputError
from tests.figures_of_page import text_of_figures


def row(solver: str, cost: float | None, wall_s: float, **more: object) -> Row:
    content = {
        "problem": "a", "solver": solver, "start": "cold", "seed": 0, "family": "tests", "claim": "ok",
        "status": "ok", "message": "converged", "ran": True, "kept": "answer",
        "cost": cost, "gain_left": 0.0, "iterations": 3,
        "wall_s": wall_s, "memory_mb": 1.0, "k1": 0.1, "k2": 0.1, "sigma_k1": None, "sigma_k2": None,
        "sigma_com_mm": None, "errors": None, "trace": [(0.0, 5.0), (wall_s, cost or 1.0)],
    }  # fmt: skip
    return Row.model_validate({**content, **more})


def comparison(rows: list[Row], reference: float | None = None) -> Comparison:
    def least(name: str) -> float | None:
        costs = [each.cost for each in rows if each.problem == name] + [reference]
        return min((cost for cost in costs if cost is not None), default=None)

    sizes = {name: 100 * 2**n for n, name in enumerate(dict.fromkeys(each.problem for each in rows))}
    problems = [
        ProblemSummary(
            name=name, source="tests", frames=size // 10, landmarks=3, observations=size,
            unknowns=9, accel_psd=1e-6, torque_psd=1e-6, prepared_s=0.1, truth=False,
            reference_cost=reference, least_cost=least(name), sigma_k1=None, sigma_k2=None, sigma_com_mm=None,
        )
        for name, size in sizes.items()
    ]  # fmt: skip
    found = Comparison(limit_s=60.0, machine="m", versions={}, problems=problems, rows=rows)
    return found.model_copy(update={"profiles": performance_profiles(found)})


def test_what_is_written_obeys_the_shipped_schema_and_comes_back_and_another_file_is_refused(
    tmp_path: Path,
) -> None:
    assert SCHEMA_FILE.read_text() == schema_text()
    written = comparison([row("x", 10.0, 1.0), row("y", None, 2.0, status="failed")])
    write_comparison(written, tmp_path / "compare.json")
    content = json.loads((tmp_path / "compare.json").read_text())
    jsonschema.validate(content, json.loads(SCHEMA_FILE.read_text()))
    assert {"solver", "status", "cost", "iterations", "wall_s"} <= content["rows"][0].keys()
    assert read_comparison(tmp_path / "compare.json") == written
    lines = csv_text(written.rows).splitlines()
    assert len(lines) == 3 and lines[0].startswith("problem,solver,start")
    assert cells(written.rows[0], 9.0)[3:7] == ["1.1e-01", "3", "1.00", "1"]
    (tmp_path / "compare.json").write_text('{"rows": []}')
    for name, words in (("compare.json", "not a comparison"), ("other.json", "no such file")):
        with pytest.raises(InputError, match=words):
            read_comparison(tmp_path / name)


def test_profiles_count_what_was_solved_at_the_least_cost_of_the_cases_that_ran(tmp_path: Path) -> None:
    missing = {"status": "missing", "ran": False, "kept": "nothing"}
    rows = [row("fast", 10.0, 1.0), row("slow", 10.0, 3.0), row("wrong", 11.0, 0.1)]
    rows += [row("fast", 20.0, 4.0, problem="b"), row("slow", 20.0, 2.0, problem="b")]
    rows += [row("wrong", 20.0, 9.0, problem="b", status="failed"), row("partly", 10.0, 2.0)]
    rows += [row("partly", None, 0.0, problem="b", **missing)]
    # a baseline claims no convergence
    rows.append(row("other", 20.0, 1.0, problem="b", status="baseline", claim="baseline"))
    made = comparison(rows)
    found = {each.solver: each for each in made.profiles}
    counted = {name: (each.solved, each.ran, each.not_run) for name, each in found.items()}
    assert counted == {"fast": (2, 2, 0), "slow": (2, 2, 0), "wrong": (0, 2, 0), "partly": (1, 1, 1)}
    factor, share = curve(found["fast"])
    assert (factor.tolist(), share.tolist()) == ([1.0, 1.0, 2.0, 100.0], [0.0, 0.5, 1.0, 1.0])
    assert curve(found["slow"])[0].tolist() == [1.0, 1.0, 3.0, 100.0]
    assert curve(found["wrong"])[1].tolist() == [0.0, 0.0] and curve(found["partly"])[1].max() == 1.0
    # at the terminal and on the page
    assert "  partly: solved cold 1 of 1 (1 not run)" in tallies(made)
    write_page(made, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "1 of 1 (1 not run)" in page and "fast: 2 of 2" in text_of_figures(page)
    # the reference solution counts too
    better = comparison(rows, reference=9.0)
    assert [each.solved for each in better.profiles] == [0] * 4 and least_costs(better)["a"] == 9.0


def test_texts_of_rows_are_shown_as_text_and_never_run(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script><img src=x onerror=alert(2)>"
    found = comparison([row(hostile, 1.0, 1.0, message=hostile, family=hostile)])
    page = tmp_path / "compare.html"
    write_page(found.model_copy(update={"machine": hostile, "versions": {hostile: hostile}}), page)
    text = page.read_text()
    assert "<script>alert" not in text and "<img src=x" not in text and "&lt;script&gt;alert(1)" in text
