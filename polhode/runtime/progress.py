"""How stages report their progress, and the level of what a user should read while they work."""

import logging
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

NOTE = 25
"""Level of the log between information and warnings: the command line prints it, though nothing is wrong"""
logging.addLevelName(NOTE, "NOTE")

Advance = Callable[[], None]


class Progress(Protocol):
    """Shows progress: one bar per stage."""

    def stage(self, title: str, total: int) -> AbstractContextManager[Advance]:
        """Open a bar of ``total`` steps; call what it yields once per step."""
        ...


Show = Callable[[str], None]


class LiveProgress(Progress, Protocol):
    """Shows progress, and a line that tells how things are now."""

    def line(self) -> AbstractContextManager[Show]:
        """Show a line until the block ends; what it yields replaces its text."""
        ...


class Silent:
    """Shows nothing: for tests and for use as a library."""

    @contextmanager
    def line(self) -> Iterator[Show]:
        yield lambda text: None

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        del title, total
        yield lambda: None
