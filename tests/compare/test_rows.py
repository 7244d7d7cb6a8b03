"""compare.json: its schema is shipped, and what is not a comparison is refused in a line."""

import json
from pathlib import Path

import jsonschema
import pytest

from polhode.compare.page import write_page
from polhode.compare.ranking import beats, curve, front, growths, performance_profiles
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
from polhode.compare.tables import cells, csv_text, not_separable, tallies, verdict
from polhode.runtime.errors import InputError
from tests.figures_of_page import text_of_figures


def row(solver: str, cost: float | None, wall_s: float, **more: object) -> Row:
    content = {
        "problem": "a", "solver": solver, "start": "cold", "seed": 0, "family": "tests", "claim": "ok",
        "status": "ok", "message": "converged", "ran": True, "kept": "answer",
        "not_separable": "", "cost": cost, "gain_left": 0.0, "iterations": 3,
        "wall_s": wall_s, "build_s": 0.0, "evaluation_s": 0.0, "linear_s": wall_s, "callback_s": 0.0,
        "memory_mb": 1.0,
        "memory_before_mb": 1.0, "k1": 0.1, "k2": 0.1, "sigma_k1": None, "sigma_k2": None,
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
            name=name, source="tests", fingerprint="0", frames=size // 10, landmarks=3, observations=size,
            unknowns=9, accel_psd=1e-6, torque_psd=1e-6, prepared_s=0.1, truth=False,
            reference_cost=reference, least_cost=least(name), sigma_k1=None, sigma_k2=None, sigma_com_mm=None,
        )
        for name, size in sizes.items()
    ]  # fmt: skip
    found = Comparison(limit_s=60.0, machine="m", versions={}, problems=problems, rows=rows)
    return found.model_copy(update={"profiles": performance_profiles(found)})


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
    rows = [row("fast", 10.0, 1.0), row("slow", 10.0, 3.0), row("wrong", 11.0, 0.1)]
    rows += [row("fast", 20.0, 4.0, problem="b"), row("slow", 20.0, 2.0, problem="b")]
    rows.append(row("wrong", 20.0, 9.0, problem="b", status="failed"))
    found = {each.solver: each for each in comparison(rows).profiles}
    factor, share = curve(found["fast"])
    assert factor.tolist() == [1.0, 1.0, 2.0, 100.0]
    assert share.tolist() == [0.0, 0.5, 1.0, 1.0]
    assert curve(found["slow"])[0].tolist() == [1.0, 1.0, 3.0, 100.0]
    assert curve(found["wrong"])[1].tolist() == [0.0, 0.0]
    assert (found["wrong"].solved, found["wrong"].ran) == (0, 2)


def test_what_did_not_run_counts_neither_for_nor_against_a_solver() -> None:
    missing = {"status": "missing", "ran": False, "kept": "nothing"}
    rows = [
        row("whole", 10.0, 1.0),
        row("partly", 10.0, 2.0),
        row("never", None, 0.0, **missing),
        row("whole", 20.0, 1.0, problem="b"),
        row("partly", None, 0.0, problem="b", **{**missing, "status": "timeout"}),
        row("never", None, 0.0, problem="b", **missing),
        row("other", 20.0, 1.0, problem="b", status="baseline", claim="baseline"),
    ]
    made = comparison(rows)
    found = {each.solver: each for each in made.profiles}
    # a baseline claims no convergence
    assert list(found) == ["whole", "partly", "never"]
    counted = {name: (each.solved, each.ran, each.not_run) for name, each in found.items()}
    assert counted == {"whole": (2, 2, 0), "partly": (1, 1, 1), "never": (0, 0, 2)}
    assert curve(found["partly"])[1].max() == 1.0
    assert found["partly"].starts["cold"].model_dump() == {"solved": 1, "ran": 1, "not_run": 1}
    # on the page, at the terminal and in the JSON
    assert "  partly: solved cold 1 of 1 (1 not run)" in tallies(made)
    content = json.loads(made.model_dump_json(by_alias=True))["profiles"]
    assert content[1]["ran"] == 1 and content[1]["not_run"] == 1


def test_texts_of_rows_are_shown_as_text_and_never_run(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script><img src=x onerror=alert(2)>"
    found = comparison([row(hostile, 1.0, 1.0, message=hostile, family=hostile, not_separable=hostile)])
    page = tmp_path / "compare.html"
    write_page(found.model_copy(update={"machine": hostile, "versions": {hostile: hostile}}), page)
    text = page.read_text()
    assert "<script>alert" not in text and "<img src=x" not in text and "&lt;script&gt;alert(1)" in text


def test_the_page_tells_how_many_cases_were_run(tmp_path: Path) -> None:
    absent = {"status": "missing", "ran": False, "kept": "nothing", "problem": "b"}
    rows = [row("x", 10.0, 1.0), row("x", 20.0, 1.0, problem="b"), row("y", 10.0, 2.0)]
    rows.append(row("y", None, 0.0, **absent))
    write_page(comparison(rows), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    page += text_of_figures(page)
    assert "2 of 2" in page and "1 of 1 (1 not run)" in page and "x: 2 of 2" in page
    write_page(comparison(rows[:1]), tmp_path / "one.html")
    assert "1 of 1" not in (tmp_path / "one.html").read_text()


def test_what_is_solved_is_judged_by_the_reference_solution_too() -> None:
    rows = [row("x", 10.0, 1.0), row("y", 10.0, 2.0)]
    assert [each.solved for each in comparison(rows).profiles] == [1, 1]
    better = comparison(rows, reference=9.0)
    assert [each.solved for each in better.profiles] == [0, 0]
    assert least_costs(better) == {"a": 9.0}
    assert cells(rows[0], 9.0)[3] == "1.1e-01"


def test_times_that_are_not_told_apart_say_why() -> None:
    rows = [
        row("x", 10.0, 1.0),
        row("inside", 10.0, 1.0, evaluation_s=None, linear_s=None, not_separable="all in C++"),
    ]
    assert cells(rows[1], 10.0)[7:9] == ["n/s", "n/s"]
    assert cells(rows[0], 10.0)[7:9] == ["0.00", "1.00"]
    assert not_separable(rows) == ["n/s, not separable (inside): all in C++"]
    assert csv_text(rows).splitlines()[2].count("all in C++") == 1


def test_growth_is_fitted_to_three_sizes() -> None:
    rows = [row("x", 10.0, 1.0 * 4.0**n, problem=name) for n, name in enumerate("abc")]
    (found,) = growths(comparison(rows))
    assert found.exponent == pytest.approx(2.0)
    assert found.size.tolist() == [100.0, 200.0, 400.0]
    assert growths(comparison(rows[:2])) == []
    # motions of as many frames are no sizes, however much each shows
    alike = comparison(rows)
    problems = [each.model_copy(update={"frames": 10}) for each in alike.problems]
    assert growths(alike.model_copy(update={"problems": problems})) == []


def test_the_front_holds_the_fastest_of_the_accurate() -> None:
    baseline = {"status": "baseline", "claim": "baseline"}
    rows = [
        row("slow and good", 10.0, 5.0),
        row("good", 10.0 + 1e-7, 2.0),
        row("rough", 12.0, 0.5, **baseline),
        row("slow and rough", 13.0, 1.0, **baseline),
        row("failed", 10.0, 0.1, status="failed"),
    ]
    assert [each.solver for each in front(rows, 10.0)] == ["rough", "good"]
    assert "2 rows claim convergence" in verdict(rows, 10.0)


@pytest.mark.parametrize(
    ("other", "wins", "loses"),
    [
        (row("faster and worse", 10.01, 0.1, status="baseline"), False, False),
        (row("more accurate, slower", 10.0, 1.2), False, False),
        (row("more accurate, as fast", 10.0, 1.05), True, False),
        (row("faster, equal", 10.001, 0.5), True, False),
        (row("as accurate, as fast", 10.001, 0.95), False, False),
        (row("died", 9.0, 0.1, status="failed"), False, True),
        (row("slow and worse", 12.0, 9.0), False, True),
    ],
    ids=lambda value: value.solver if isinstance(value, Row) else "",
)
def test_a_row_is_beaten_by_the_faster_and_by_the_more_accurate_and_as_fast(
    other: Row, wins: bool, loses: bool
) -> None:
    own, unfinished = row("own", 10.001, 1.0), row("own", 10.0, 1.0, status="timeout")
    assert (beats(other, own, 10.0), beats(own, other, 10.0)) == (wins, loses)
    assert (own in front([own, other], 10.0)) == (not wins)
    # noise of costs counts up to AGREED of the least
    near = row("near", 10.0 * (1.0 + 5e-7), 1.0)
    assert not beats(row("best", 10.0, 0.95), near, 10.0) and beats(row("best", 10.0, 0.8), near, 10.0)
    assert not beats(unfinished, other, 10.0) and beats(other, unfinished, 10.0) == (other.status != "failed")
