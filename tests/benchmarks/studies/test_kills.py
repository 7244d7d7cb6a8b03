"""What the benchmark of kills compares; tests/studies/test_cluster.py kills studies itself."""

import pyarrow as pa

from benchmarks.studies.kills import column_digests, differences


def test_columns_that_differ_are_named_and_times_are_not_compared() -> None:
    first = pa.table({"point": [0, 1], "run.k": [1.0, None], "time.run_s": [1.0, 2.0], "gone": [1, 1]})
    same = pa.table({"point": [0, 1], "run.k": [1.0, None], "time.run_s": [3.0, 4.0], "gone": [1, 1]})
    assert differences(column_digests(first), column_digests(same)) == []
    other = pa.table({"point": [0, 1], "run.k": [1.0, 2.0], "new": [1, 1]})
    assert differences(column_digests(first), column_digests(other)) == ["run.k", "gone", "new"]
