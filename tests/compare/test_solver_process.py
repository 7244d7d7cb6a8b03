"""A solver that crashes, hangs, lies or is missing costs its own row."""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from polhode.compare.problem.assessment import assess
from polhode.compare.problem.problem_file import read_problem
from polhode.compare.registry import ENTRIES, Entry, entries
from polhode.compare.rows import Case, Row
from polhode.compare.solver_process import row_of, storable
from polhode.runtime.errors import InputError

CASE = Case(problem="small", solver="faulty", start="cold", seed=0)


def row(small_file: Path, how: str, limit_s: float = 60.0) -> Row:
    entry = Entry("faulty", "tests", "tests.compare.faulty:Faulty", {"how": how})
    return row_of(small_file, entry, CASE, limit_s)


def assert_start_is_kept(found: Row, small_file: Path) -> None:
    """The common cost of the point that it recorded, whatever cost it stated itself."""
    problem = read_problem(small_file)
    at_start = assess(problem, problem.cold)
    assert found.kept == "best"
    assert found.cost == at_start.cost and found.k1 == at_start.k1
    assert found.errors == at_start.errors is not None
    assert found.evaluation_s is None and "before its times were read" in found.not_separable


@pytest.fixture(scope="module", autouse=True)
def hanging(small_file: Path) -> Iterator[dict[str, Future[Row]]]:
    """Two that hang, beside the other tests: what they cost is waiting."""
    how = ("hangs", "hangs dumbly")
    with ThreadPoolExecutor(len(how)) as pool:
        yield {each: pool.submit(row, small_file, each, limit_s=45.0) for each in how}


def test_a_crash_is_a_failed_row_with_what_was_reached(small_file: Path) -> None:
    found = row(small_file, "crashes")
    assert found.status == "failed"
    assert "SIGABRT" in found.message
    assert len(found.trace) == 1
    assert_start_is_kept(found, small_file)


@pytest.mark.parametrize(
    ("how", "message"), [("exits", "ended with 3"), ("lies", "left to gain"), ("nonsense", "no finite cost")]
)
def test_no_answer_a_false_one_and_nonsense_are_failed_rows(how: str, message: str, small_file: Path) -> None:
    found = row(small_file, how)
    assert found.status == "failed" and message in found.message
    assert (found.cost is None) == (how == "nonsense")
    assert how != "lies" or (found.gain_left is not None and found.gain_left > 1e-6)


def test_numbers_that_are_not_finite_are_none_in_a_row(small_file: Path) -> None:
    errors = {"k1": float("nan"), "k2": 1.0}
    nested = {"cost": float("inf"), "errors": errors, "trace": [(0.0, 1.0)], "status": "ok"}
    assert storable(nested) == {**nested, "cost": None, "errors": {"k1": None, "k2": 1.0}}


def test_an_exception_is_told_in_a_line_and_the_child_takes_our_packages_wherever_it_is_started(
    small_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A foreign package of our name in the working directory is not taken for ours."""
    (tmp_path / "backend").mkdir()
    (tmp_path / "backend" / "__init__.py").write_text("raise RuntimeError('foreign')")
    monkeypatch.chdir(tmp_path)
    found = row(small_file, "raises")
    assert (found.status, found.message) == ("failed", "ValueError: no such luck")


def test_a_missing_package_is_a_row_that_names_it(small_file: Path) -> None:
    entry = Entry("x", "tests", "ours:Ours", needs="no_such_package_anywhere")
    found = row_of(small_file, entry, CASE, 10.0)
    assert found.status == "missing"
    assert "no_such_package_anywhere" in found.message


def test_names_of_solvers_are_unique_and_a_wrong_one_is_told() -> None:
    assert len({entry.name for entry in ENTRIES}) == len(ENTRIES)
    with pytest.raises(InputError, match="did you mean ceres"):
        entries(("ceress",))


def test_one_that_hangs_is_ended_at_its_limit(small_file: Path, hanging: dict[str, Future[Row]]) -> None:
    found = hanging["hangs"].result()
    assert found.status == "timeout"
    assert "45 s" in found.message and "the best point is kept" in found.message
    assert_start_is_kept(found, small_file)
    assert found.wall_s is not None
    assert found.memory_mb is not None and found.memory_mb > 50.0


def test_of_one_that_notes_no_point_nothing_is_kept(hanging: dict[str, Future[Row]]) -> None:
    found = hanging["hangs dumbly"].result()
    assert (found.status, found.kept, found.cost) == ("timeout", "nothing", None)
    assert "3 of 20 frames were in; nothing is kept" in found.message
