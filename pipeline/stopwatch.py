"""Seconds spent in each stage of a run."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import TypeVar

Item = TypeVar("Item")


@dataclass
class Stopwatch:
    """Seconds spent in each stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=perf_counter)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - begin

    def waiting(self, stage: str, items: Iterator[Item]) -> Iterator[Item]:
        """Pass the items on; the time until each comes counts as the stage's."""
        while True:
            with self(stage):
                item = next(items, None)
            if item is None:
                return
            yield item

    def add_total(self) -> None:
        """The whole time since the start, also what no stage claims."""
        self.seconds["total"] = perf_counter() - self.start
