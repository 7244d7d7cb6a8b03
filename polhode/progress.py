"""How a stage tells that it advances, without knowing who listens."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

Advance = Callable[[], None]


class Progress(Protocol):
    """A listener: one bar per stage."""

    def stage(self, title: str, total: int) -> AbstractContextManager[Advance]:
        """Open a bar of ``total`` steps; call what it yields once per step."""
        ...


class Silent:
    """Nobody listens: for tests and for use as a library."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        del title, total
        yield lambda: None
