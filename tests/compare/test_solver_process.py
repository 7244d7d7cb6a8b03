"""A solver that crashes, hangs, lies or is missing costs its own row."""

from pathlib import Path

import pytest

from polhode.compare.rows import Case, Row
from polhode.compare.solver import ENTRIES, Entry, entries
from polhode.compare.solver_process import row_of, storable
from polhode.runtime.errors import InputError

CASE = Case(problem="small", solver="faulty", start="cold", seed=0)


def row(small_file: Path, how: str, limit_s: float = 60.0) -> Row:
    entry = Entry("faulty", "tests", "tests.compare.faulty:Faulty", {"how": how})
    return row_of(small_file, entry, CASE, limit_s)


def test_one_that_hangs_is_ended_at_its_limit(small_file: Path) -> None:
    found = row(small_file, "hangs", limit_s=2.0)
    assert (found.status, found.kept, found.cost) == ("timeout", "nothing", None)
    assert "limit of 2 s" in found.message


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("crashes", "SIGABRT"),
        ("exits", "ended with 3"),
        ("lies", "left to gain"),
        ("nonsense", "no finite cost"),
    ],
)
def test_no_answer_a_false_one_and_nonsense_are_failed_rows(how: str, message: str, small_file: Path) -> None:
    found = row(small_file, how)
    assert found.status == "failed" and message in found.message
    assert (found.cost is None) == (how != "lies")
    assert how != "lies" or (found.gain_left is not None and found.gain_left > 1e-6)


def test_an_exception_is_told_in_a_line_and_the_child_takes_our_packages_wherever_it_is_started(
    small_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "backend").mkdir()
    (tmp_path / "backend" / "__init__.py").write_text("raise RuntimeError('foreign')")
    monkeypatch.chdir(tmp_path)
    found = row(small_file, "raises")
    assert (found.status, found.message) == ("failed", "ValueError: no such luck")


def test_a_missing_package_is_a_row_that_names_it_and_so_is_a_wrong_solver(small_file: Path) -> None:
    entry = Entry("x", "tests", "ours:Ours", needs="no_such_package_anywhere")
    found = row_of(small_file, entry, CASE, 10.0)
    assert found.status == "missing" and "no_such_package_anywhere" in found.message
    assert len({entry.name for entry in ENTRIES}) == len(ENTRIES)
    with pytest.raises(InputError, match="did you mean ceres"):
        entries(("ceress",))


def test_numbers_that_are_not_finite_are_none_in_a_row() -> None:
    errors = {"k1": float("nan"), "k2": 1.0}
    nested = {"cost": float("inf"), "errors": errors, "trace": [(0.0, 1.0)], "status": "ok"}
    assert storable(nested) == {**nested, "cost": None, "errors": {"k1": None, "k2": 1.0}}
