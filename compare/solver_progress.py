"""What a solver's process has reached, in files that outlive it: it may be killed at any moment.

The unknowns lie in a mapped file with two places that are written in turn; the first number names the whole
one. A write costs one copy, and a process that dies in the middle of it leaves the point before.
"""

from pathlib import Path
from time import time
from typing import Literal

import numpy as np

from polhode.lie import Array


class ProgressFiles:
    """Writer of one process; its files are ``stem`` with suffixes .started, .trace, .reached, .words."""

    def __init__(self, stem: Path, n: int) -> None:
        self._trace, self._words = stem.with_suffix(".trace"), stem.with_suffix(".words")
        self._numbers = np.memmap(
            stem.with_suffix(".reached"), dtype=np.float64, mode="w+", shape=(1 + 2 * n,)
        )
        self._n = n
        stem.with_suffix(".started").write_text(f"{time():.6f}")

    def point(self, x: Array, kind: Literal["best", "last"]) -> None:
        """The unknowns (n,) to be kept from now on. Raises ValueError for another length."""
        place = 1 if abs(self._numbers[0]) != 1.0 else 2
        at = 1 + (place - 1) * self._n
        self._numbers[at : at + self._n] = x.reshape(self._n)
        self._numbers[0] = place if kind == "best" else -place

    def cost(self, seconds: float, cost: float) -> None:
        """One more point of the trace."""
        with self._trace.open("a") as file:
            file.write(f"{seconds:.6f} {cost:.17g}\n")

    def words(self, words: str) -> None:
        """How far it is, for methods that have no whole point on their way."""
        self._words.write_text(words)


def read_point(stem: Path) -> tuple[Literal["best", "last"], Array] | None:
    """The unknowns (n,) that were kept, and whether they are the best or the last; None: none."""
    file = stem.with_suffix(".reached")
    if not file.is_file():
        return None
    numbers = np.fromfile(file)
    place, n = int(abs(numbers[0])), (len(numbers) - 1) // 2
    if place not in (1, 2):
        return None
    return "best" if numbers[0] > 0.0 else "last", numbers[1 + (place - 1) * n : 1 + place * n]


def read_trace(stem: Path) -> list[tuple[float, float]]:
    """Seconds and cost; a line that was cut short is left out."""
    file = stem.with_suffix(".trace")
    if not file.is_file():
        return []
    lines = file.read_text().splitlines(keepends=True)
    points = [line.split() for line in lines if line.endswith("\n")]
    return [(float(point[0]), float(point[1])) for point in points if len(point) == 2]


def seconds_since_start(stem: Path) -> float | None:
    """Of the solver's clock [s]; None: it did not get that far."""
    file = stem.with_suffix(".started")
    return time() - float(file.read_text()) if file.is_file() else None


def read_words(stem: Path) -> str:
    """How far it was; empty: it did not say."""
    file = stem.with_suffix(".words")
    return file.read_text() if file.is_file() else ""
