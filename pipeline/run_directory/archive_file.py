"""An .npz archive as it must be: arrays by name, each with its shape, none with NaN.

What is wrong raises InputError, one line that names file, array and row.
"""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile
from zlib import error as ZlibError

import numpy as np
from numpy.typing import NDArray

from polhode.errors import InputError
from polhode.lie import Array
from polhode.records import Ints

Arrays = dict[str, NDArray[np.generic]]
AGAIN = "run 'polhode run' again"


@dataclass(frozen=True)
class Archive:
    """What a file holds."""

    file: Path
    arrays: Arrays

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def numbers(self, name: str, *shape: int | None, infinite: bool = False) -> Array:
        """An array of floats, None: any length; finite, or with ``infinite`` just not NaN."""
        values = self._shaped(name, shape, "fiu").astype(np.float64)
        bad = np.isnan(values) if infinite else ~np.isfinite(values)
        if bad.any():
            row = f" in row {np.argwhere(bad)[0][0]}" if shape else ""
            raise self.wrong(f"{name} holds {'NaN' if infinite else 'NaN or infinity'}{row}")
        return values

    def whole(self, name: str, *shape: int | None, below: int | None = None) -> Ints:
        """An array of whole numbers; with ``below`` they are indices, 0 <= i < below."""
        values = self._shaped(name, shape, "iu").astype(np.int64)
        if below is not None and values.size and (values.min() < 0 or values.max() >= below):
            raise self.wrong(f"{name} points outside the run")
        return values

    def number(self, name: str) -> float:
        """A single finite number."""
        return float(self.numbers(name))

    def times(self, name: str, count: int | None = None) -> Ints:
        """(n,) strictly increasing [ns]"""
        stamps = self.whole(name, count)
        later = np.diff(stamps) > 0
        if not later.all():
            raise self.wrong(f"{name} does not increase in row {int(np.argmin(later)) + 1}")
        return stamps

    def wrong(self, what: str) -> InputError:
        """The error to raise."""
        return InputError(f"{self.file}: {what}; {AGAIN}")

    def _shaped(self, name: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[np.generic]:
        if name not in self.arrays:
            raise self.wrong(f"the array {name} is missing")
        values = self.arrays[name]
        if values.dtype.kind not in kinds:
            kind = "numbers" if "f" in kinds else "whole numbers"
            raise self.wrong(f"{name} holds {values.dtype}, expected {kind}")
        fits = len(values.shape) == len(shape) and all(
            wanted in (None, size) for wanted, size in zip(shape, values.shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if size is None else str(size) for size in shape) or "one number"
            given = " x ".join(map(str, values.shape)) or "one number"
            raise self.wrong(f"{name} is {given}, expected {wanted}")
        return values


def load_archive(path: Path, name: str) -> Archive:
    """Read the file, or that of this name in the folder of a run."""
    file = path / name if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run")
    try:
        with np.load(file, allow_pickle=False) as archive:
            return Archive(file, {key: archive[key] for key in archive.files})
    except (BadZipFile, ZlibError, ValueError, OSError, EOFError, AttributeError) as error:
        raise InputError(f"{file}: not a readable archive of arrays ({error})") from error
