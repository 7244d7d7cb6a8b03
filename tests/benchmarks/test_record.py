"""A benchmark that was interrupted goes on where it stopped; its record is a study."""

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from benchmarks.record import Case, add, complete, forget, lines_of, measured
from polhode.studies.store import Store


def square(case: Case) -> Case:
    return {"square": case["x"] ** 2, "list": [1.5, None, {"a": case["x"]}]}


def refuse_two(case: Case) -> Case:
    if case["x"] == 2:
        raise ValueError("two is refused")
    return square(case)


@pytest.mark.usefixtures("sweep_here")
def test_only_missing_cases_are_measured(tmp_path: Path) -> None:
    record = tmp_path / "deep" / "record"
    first = complete(record, [{"x": 1}, {"x": 2}], square, workers=1)
    assert [line["square"] for line in first] == [1, 4]
    assert first[0]["case"] == {"x": 1} and first[0]["list"] == [1.5, None, {"a": 1}]
    forget(record, lambda case: case == {"x": 2})
    add(record, [{"case": {"x": 2}, "made": first[1]["made"], "square": 5}])
    again = complete(record, [{"x": 3, "kind": "b"}, {"x": 2}], square, workers=1)
    assert [line["square"] for line in again] == [9, 5]
    cases: list[Case] = [{"x": 7}, {"x": 3}, {"x": 3, "kind": "b"}, {"x": 1}]
    assert [line["square"] for line in measured(record, cases)] == [9, 1]


@pytest.mark.usefixtures("sweep_here")
def test_a_record_has_a_table_and_a_page_of_all_its_cases(tmp_path: Path) -> None:
    record = tmp_path / "record"
    complete(record, [{"x": 1}, {"x": 2}], square, workers=1)
    complete(record, [{"x": 3}], square, workers=1)
    table = pq.read_table(record / "table.parquet").to_pydict()
    assert table["case.x"] == [1, 2, 3] and table["measure.square"] == [1, 4, 9]
    assert "measure.square" in (record / "study.html").read_text()


@pytest.mark.usefixtures("sweep_here")
def test_what_is_forgotten_is_measured_again(tmp_path: Path) -> None:
    record = tmp_path / "record"
    cases: list[Case] = [{"x": 1}, {"x": 2}]
    complete(record, cases, square, workers=1)
    forget(record, lambda case: case["x"] == 1)
    assert [line["square"] for line in measured(record, cases)] == [4]
    assert [line["square"] for line in complete(record, cases, square, workers=1)] == [1, 4]
    forget(tmp_path / "none", lambda case: True)


@pytest.mark.usefixtures("sweep_here")
def test_a_case_that_fails_ends_the_benchmark_after_the_others_and_is_no_line(tmp_path: Path) -> None:
    record = tmp_path / "record"
    cases: list[Case] = [{"x": 2}, {"x": 3}]
    with pytest.raises(SystemExit, match=r"1 of 2 cases failed: 1 x measure: .*two is refused"):
        complete(record, cases, refuse_two, workers=1)
    assert [line["square"] for line in lines_of(record)] == [9]
    assert [line["square"] for line in complete(record, cases, square, workers=1)] == [4, 9]


def test_what_was_measured_elsewhere_is_stored_as_it_is(tmp_path: Path) -> None:
    lines = [{"case": {"x": k, "kind": "a"}, "made": None, "y": [k, {"z": 0.1}]} for k in range(3)]
    add(tmp_path / "record", lines)
    assert list(lines_of(tmp_path / "record")) == lines
    assert not list(Store(tmp_path / "record").folder.glob("points/*"))
