"""pushes.csv: one row a step, steps of one push together, exact numbers."""

from pathlib import Path

import numpy as np

from polhode.pipeline.run_directory.disturbances_file import PUSHES_COLUMNS, write_pushes
from polhode.records import Push, UnknownPushes


def test_the_table_reads_back_exactly_and_numbers_the_pushes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    start = 1_600_000_000_000_000_000 + 500_000_000 * np.array([3, 4, 9], dtype=np.int64)
    accel, sigma = rng.normal(size=(2, 3, 3)), rng.uniform(0.1, 1.0, (2, 3, 3))
    sigma[1, 2] = np.inf
    one = Push(int(start[0]), int(start[1]) + 500_000_000, *rng.normal(size=(4, 3)))
    two = Push(int(start[2]), int(start[2]) + 500_000_000, *rng.normal(size=(4, 3)))
    pushes = UnknownPushes(start, start + 500_000_000, accel[0], sigma[0], accel[1], sigma[1], (one, two))
    write_pushes(pushes, tmp_path / "pushes.csv")
    header, *rows = (tmp_path / "pushes.csv").read_text().splitlines()
    assert tuple(header.split(",")) == PUSHES_COLUMNS and len(PUSHES_COLUMNS) == 15
    cells = [row.split(",") for row in rows]
    assert [int(row[0]) for row in cells] == [1, 1, 2]
    assert [int(row[1]) for row in cells] == start.tolist()
    values = np.array([[float(cell) for cell in row[3:]] for row in cells])
    np.testing.assert_array_equal(values, np.hstack([accel[0], sigma[0], accel[1], sigma[1]]))
