"""The benchmark of the stages counts what it says: own seconds, those of the named functions, and ratios."""

import cProfile
import pstats
from time import process_time

import numpy as np
import pytest

from benchmarks.live.stages import STAGES, seconds_of, table


def test_named_functions_count_by_their_own_seconds() -> None:
    profile = cProfile.Profile(process_time)
    profile.enable()
    A = np.random.default_rng(0).random((500, 500)) + 500.0 * np.eye(500)
    np.linalg.inv(A)
    sorted(A.ravel().tolist())
    profile.disable()
    stats = pstats.Stats(profile)
    whole, inverse = seconds_of(stats, ("inv",))
    assert 0.0 < inverse < whole
    # a built-in function, and a method of one
    assert all(0.0 < seconds_of(stats, (name,))[1] < whole for name in ("sorted", "tolist"))
    assert seconds_of(stats, ("is not called",)) == (whole, 0.0)


def test_the_table_has_medians_and_ratios() -> None:
    runs = [dict.fromkeys([*STAGES, "all"], (seconds, 0.5)) for seconds in (2.0, 9.0, 1.0)]
    columns, rows = table(runs, [dict.fromkeys([*STAGES, "all"], (6.0, 1.0))])
    assert columns.count("|") + 1 == len(rows[0]) == 6
    assert rows[0][0] == next(iter(STAGES)) and rows[-1][0] == "all"
    assert all(row[2:] == ["2.00", "0.50", "6.00", "3.00"] for row in rows)
    assert len(table(runs, None)[1][0]) == 4


@pytest.mark.parametrize("stage", list(STAGES))
def test_every_stage_has_functions_and_what_bounds_it(stage: str) -> None:
    names, bound, functions = STAGES[stage]
    assert names and bound and functions
