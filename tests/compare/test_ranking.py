"""Who is on the front of time against accuracy: noise of the times counts as equal, failures do not count."""

from polhode.compare.ranking import beaten_by, front
from polhode.compare.rows import Row
from tests.compare.test_rows import row


def beaten(rows: list[Row], solver: str = "own") -> list[str]:
    least = min(each.cost or 0.0 for each in rows if each.status != "failed")
    own = next(each for each in rows if each.solver == solver)
    found = beaten_by(own, rows, least)
    assert (own in front(rows, least)) == (not found and own.status in ("ok", "baseline"))
    return [each.solver for each in found]


def test_a_row_is_beaten_by_the_faster_and_by_the_more_accurate_and_as_fast() -> None:
    own = row("own", 10.001, 1.0)
    worse = row("faster and worse", 10.01, 0.1, status="baseline")
    slower = row("more accurate, slower", 10.0, 1.2)
    both = [row("more accurate, as fast", 10.0, 1.05), row("faster, equal", 10.001, 0.5)]
    assert beaten([own, worse, slower, *both]) == ["faster, equal", "more accurate, as fast"]
    assert beaten([own, worse, slower]) == []


def test_within_noise_of_time_and_agreement_of_costs_all_are_equal() -> None:
    rows = [row("own", 10.0 * (1.0 + 5e-7), 1.0), row("other", 10.0, 0.95)]
    assert beaten(rows) == beaten(rows, "other") == []
    assert beaten([rows[0], row("other", 10.0, 0.8)]) == ["other"]


def test_a_row_that_did_not_finish_is_beaten_and_beats_none() -> None:
    died = row("died", 9.0, 0.1, status="failed")
    rows = [row("own", 10.0, 1.0, status="timeout"), row("slow", 12.0, 9.0), died]
    assert beaten(rows) == ["slow"]
    assert beaten(rows, "slow") == []
