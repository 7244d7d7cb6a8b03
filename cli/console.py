"""Progress and warnings on the terminal: one bar per stage, or plain lines where there is no terminal.

Everything goes to standard output; standard error is kept for the one line of an error.
"""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from polhode.errors import one_line, printable
from polhode.interrupts import raise_if_received
from polhode.progress import NOTE, Advance, LiveProgress, Show

_log = logging.getLogger(__name__)
_finished: list[str] = []
"""Titles of the stages that the command has finished."""


def choose_progress() -> LiveProgress:
    """Bars on a terminal, plain lines in a file, a pipe or CI."""
    return Bars() if sys.stdout.isatty() else Lines()


class Bars:
    """A live bar per stage, which stays on the screen when the stage is done."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Open a bar of ``total`` steps; call what it yields once per step."""
        raise_if_received()
        bar = RichProgress(
            TextColumn("{task.description:<28}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(file=sys.stdout),
        )
        start = perf_counter()
        with bar:
            task = bar.add_task(escape(printable(title)), total=total or None)

            def advance() -> None:
                raise_if_received()
                bar.advance(task)

            yield advance
        _finished.append(title)
        _log.info("%s: %.1f s", title, perf_counter() - start)

    @contextmanager
    def line(self) -> Iterator[Show]:
        """Keep one line at the bottom of the terminal, and its last text when the block ends."""
        with Live(Text(""), console=Console(file=sys.stdout), refresh_per_second=8) as live:

            def show(text: str) -> None:
                raise_if_received()
                live.update(Text(printable(text)))

            yield show


class Lines:
    """One line when a stage is done."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Count the steps; print title, count and seconds at the end."""
        del total
        raise_if_received()
        steps = 0
        start = perf_counter()

        def advance() -> None:
            nonlocal steps
            raise_if_received()
            steps += 1

        yield advance
        seconds = perf_counter() - start
        count = f"{steps} in " if steps else ""
        print(f"{printable(title)}: {count}{seconds:.1f} s", flush=True)
        _finished.append(title)
        _log.info("%s: %.1f s", title, seconds)

    @contextmanager
    def line(self) -> Iterator[Show]:
        """Print every text on a line of its own."""

        def show(text: str) -> None:
            raise_if_received()
            print(printable(text), flush=True)

        yield show


class _PlainWarnings(logging.Handler):
    """Notes and warnings on standard output, whatever that is at the time: one line each, and each once."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        line = f"{record.levelname.lower()}: {one_line(record.getMessage())}"
        if line not in self._printed:
            self._printed.add(line)
            print(line, flush=True)


def is_working() -> bool:
    """Whether the command has finished a stage of its work."""
    return bool(_finished)


@contextmanager
def show_warnings() -> Iterator[None]:
    """Print the program's notes and warnings while the block runs, which is one command."""
    _finished.clear()
    handler = _PlainWarnings(level=NOTE)
    # Errors are reported by the last line on standard error.
    handler.addFilter(lambda record: record.levelno < logging.ERROR)
    root, own = logging.getLogger(), logging.getLogger("polhode")
    level = own.level
    root.addHandler(handler)
    own.setLevel(NOTE)
    try:
        yield
    finally:
        own.setLevel(level)
        root.removeHandler(handler)
