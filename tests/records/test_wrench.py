"""wrench0: what is read, and each bad input's one line."""

from pathlib import Path

import numpy as np
import pytest

from polhode.records.dataset import open_sequence, read_wrench
from polhode.records.dataset_writer import write_wrench
from polhode.runtime.errors import InputError

STAMPS = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(6, dtype=np.int64)


def test_rows_come_back_as_written(tmp_path: Path) -> None:
    force_N, torque_P = np.arange(6.0).reshape(2, 3), -0.1 * np.arange(6.0).reshape(2, 3)
    write_wrench(tmp_path, STAMPS[:2], force_N, torque_P)
    wrench = read_wrench(tmp_path / "wrench0", STAMPS)
    np.testing.assert_array_equal(wrench.time_ns, STAMPS[:2])
    np.testing.assert_array_equal(wrench.force_N, force_N)
    np.testing.assert_array_equal(wrench.torque_P, torque_P)


def test_a_sequence_has_its_wrench_and_none_without_the_folder(small_sequence: Path) -> None:
    assert open_sequence(small_sequence).wrench is None
    write_wrench(small_sequence / "mav0", STAMPS[:1], np.ones((1, 3)), np.zeros((1, 3)))
    wrench = open_sequence(small_sequence).wrench
    assert wrench is not None
    np.testing.assert_array_equal(wrench.force_N, np.ones((1, 3)))


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "is missing"), ("#only a header", "is empty"), ("1,0,0,0,0,0", "6 columns, expected 7"),
     ("1,0,0,0,0,0,nan", "NaN or infinity"), ("1,0,0,x,0,0,0", "not a number"),
     ("2,0,0,0,0,0,0\n2,0,0,0,0,0,0", "repeats"),
     (f"{STAMPS[-1] + 1},0,0,0,0,0,0", "is after the last frame")],
)  # fmt: skip
def test_a_bad_file_is_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    folder = tmp_path / "wrench0"
    folder.mkdir()
    if text:
        (folder / "data.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_wrench(folder, STAMPS)
    assert "\n" not in str(caught.value) and str(folder) in str(caught.value)
