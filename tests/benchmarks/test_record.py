"""A benchmark that was interrupted goes on where it stopped."""

from pathlib import Path

from benchmarks.record import Case, complete, forget, measured


def square(case: Case) -> Case:
    return {"square": case["x"] ** 2}


def test_only_missing_cases_are_measured_and_a_cut_line_does_no_harm(tmp_path: Path) -> None:
    record = tmp_path / "deep" / "record.jsonl"
    first = complete(record, [{"x": 1}, {"x": 2}], square, workers=1)
    assert [line["square"] for line in first] == [1, 4]
    record.write_text(record.read_text().replace('"square": 4', '"square": 5') + '{"case": {"x": 3}, "squ')
    again = complete(record, [{"x": 3}, {"x": 2}], square, workers=1)
    assert [line["square"] for line in again] == [9, 5]
    # what came after the cut line is a line of its own
    record.write_text(record.read_text().replace('"square": 9', '"square": 8'))
    assert complete(record, [{"x": 3}], square, workers=1)[0]["square"] == 8
    assert [line["square"] for line in measured(record, [{"x": 7}, {"x": 3}, {"x": 1}])] == [8, 1]


def test_what_is_forgotten_is_measured_again(tmp_path: Path) -> None:
    record = tmp_path / "record.jsonl"
    cases: list[Case] = [{"x": 1}, {"x": 2}]
    complete(record, cases, square, workers=1)
    forget(record, lambda case: case["x"] == 1)
    assert [line["square"] for line in measured(record, cases)] == [4]
    assert [line["square"] for line in complete(record, cases, square, workers=1)] == [1, 4]
    forget(tmp_path / "none.jsonl", lambda case: True)
