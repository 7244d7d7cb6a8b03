"""trajectory.csv: columns, exactness, and what undetermined quantities look like."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.run_directory.trajectory_file import (
    TRAJECTORY_COLUMNS,
    read_trajectory,
    standard_deviations,
    trajectory_of,
    write_trajectory,
)
from polhode.runtime.errors import InputError, RunFailure


def test_reading_gives_back_every_bit_under_the_26_columns_of_the_contract(
    example: Any, tmp_path: Path
) -> None:
    assert ",".join(TRAJECTORY_COLUMNS) == (
        "timestamp_ns,r_N_x,r_N_y,r_N_z,v_N_x,v_N_y,v_N_z,q_NP_w,q_NP_x,q_NP_y,q_NP_z,w_P_x,w_P_y,w_P_z,"
        "sigma_r_x,sigma_r_y,sigma_r_z,sigma_v_x,sigma_v_y,sigma_v_z,"
        "sigma_theta_x,sigma_theta_y,sigma_theta_z,sigma_w_x,sigma_w_y,sigma_w_z"
    )
    path = trajectory_of(example.estimate)
    write_trajectory(path, tmp_path / "trajectory.csv")
    again = read_trajectory(tmp_path)
    for name in vars(path):
        np.testing.assert_array_equal(getattr(again, name), getattr(path, name), err_msg=name)
    np.testing.assert_allclose(again.R_NP, example.estimate.R_NP, atol=1e-14)
    covariance = np.diag([4.0, np.inf, np.nan, -1e-12])
    np.testing.assert_array_equal(standard_deviations(covariance), [2.0, np.inf, np.inf, np.inf])


def test_plain_csv_readers_see_a_row_per_pair_with_no_empty_cell(undetermined: Any, tmp_path: Path) -> None:
    write_trajectory(trajectory_of(undetermined.estimate), tmp_path / "trajectory.csv")
    with (tmp_path / "trajectory.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == undetermined.tracks.n_frames
    values = np.array([[float(cell) for cell in row.values()] for row in rows])
    assert values.shape[1] == 26
    assert not np.any(np.isnan(values))
    assert {row["sigma_r_y"] for row in rows} == {"inf"} == {row["sigma_theta_y"] for row in rows}
    assert all(np.isfinite(float(row["r_N_y"])) for row in rows)


def test_what_would_not_be_read_again_is_never_written(example: Any, tmp_path: Path) -> None:
    # timestamps in microseconds, read as nanoseconds
    path, r_N = trajectory_of(example.estimate), example.estimate.r_N.copy()
    with pytest.raises(RunFailure, match=r"rotate at 7.64e\+03 RPM.*check that the timestamps"):
        write_trajectory(replace(path, w_P=np.full((24, 3), 800.0)), tmp_path / "trajectory.csv")
    r_N[3, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        write_trajectory(replace(path, r_N=r_N), tmp_path / "trajectory.csv")
    assert not list(tmp_path.iterdir())


def rows_with(column: int, value: str) -> str:
    """A table of one row at rest, with another value in a column."""
    row = ["1", *["0"] * 6, "1", *["0"] * 18]
    row[column] = value
    return ",".join(TRAJECTORY_COLUMNS) + "\n" + ",".join(row) + "\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        ("t,x\n1,2\n", "header"),
        (",".join(TRAJECTORY_COLUMNS) + "\n1,a\n", r"line 2: 2 columns, expected 26 \(see docs/run_d"),
        (",".join(TRAJECTORY_COLUMNS) + "\n", r"is empty: .* \(see docs/run_directory"),
        (",".join(TRAJECTORY_COLUMNS) + "\n1" + ",1" * 25 + "\n", "line 2: a quaternion that is not of unit"),
        (
            ",".join(TRAJECTORY_COLUMNS) + ("\n7" + ",0.5" * 25) * 2 + "\n",
            "line 3: timestamp 7 repeats 7",
        ),
        (rows_with(11, "1e14"), "line 2: an angular velocity above 300 rad/s"),
        (rows_with(14, "1e308"), "line 2: a finite standard deviation above 1e\\+100"),
        (rows_with(1, "1e20"), "line 2: a state above 1e\\+15"),
        (
            ",".join(TRAJECTORY_COLUMNS) + f"\n{2**70}" + ",0.5" * 25 + "\n",
            "line 2: timestamp 1180591620717411303424 is beyond",
        ),
    ],
)
def test_a_damaged_table_is_refused_in_one_line(content: str | None, words: str, tmp_path: Path) -> None:
    file = tmp_path / "trajectory.csv"
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputError, match=words) as caught:
        read_trajectory(file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)
