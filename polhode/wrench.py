"""What is known to push the target: ``wrench0/`` of a sequence."""

from pathlib import Path

from polhode.errors import InputError
from polhode.records import Ints, Wrench
from polhode.tables import numbers_of, read_rows, timestamps_of


def read_wrench(folder: Path, timestamps_ns: Ints) -> Wrench:
    """Read ``wrench0/data.csv``: timestamp, force_N (3) [N], torque_P (3) [N m]. A row holds until the next.

    Raises InputError when a row holds no numbers, timestamps do not increase, or no row is as early as the
    last frame (F,).
    """
    path = folder / "data.csv"
    rows = read_rows(path)
    stamps = timestamps_of(path, rows)
    values = numbers_of(path, rows, columns=6)
    if stamps[0] > timestamps_ns[-1]:
        message = f"{path}: the first row, {stamps[0]} ns, is after the last frame, {timestamps_ns[-1]} ns"
        raise InputError(f"{message}; use the clock of the images, or remove wrench0/")
    return Wrench(stamps, values[:, :3], values[:, 3:])
