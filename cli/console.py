"""Progress and warnings on the terminal: one bar per stage, or plain lines where there is no terminal.

Everything goes to standard output; standard error is kept for the one line of an error. With --json, ``main``
sends all of it to standard error instead; with --quiet none of it is shown.
"""

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress
from rich.text import Text

from polhode.cli.time_left import StageShare, TimeLeft
from polhode.errors import one_line, printable
from polhode.interrupts import raise_if_received
from polhode.progress import NOTE, Advance, LiveProgress, Progress, Show

_log = logging.getLogger(__name__)
SILENCE_S = 30.0
"""Where there is no terminal, a line says what is going on when none was printed for so long."""
LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


@dataclass
class _Command:
    """What is known of the command that runs."""

    quiet: bool = False
    finished: list[str] = field(default_factory=list)
    """Titles of the stages that it has finished"""


_command = _Command()


def choose_progress() -> LiveProgress:
    """Bars on a terminal, plain lines in a file, a pipe or CI; nothing with --quiet."""
    if _command.quiet:
        return Quiet()
    return Bars() if sys.stdout.isatty() else Lines()


@contextmanager
def progress_of_run() -> Iterator[Progress]:
    """Show the stages of a whole run, and how long all of them still take."""
    if _command.quiet:
        yield Quiet()
    elif sys.stdout.isatty():
        with RunBars().shown() as progress:
            yield progress
    else:
        lines = Lines(TimeLeft())
        with lines.never_silent():
            yield lines


def progress_of_points() -> Progress:
    """Bars with the time left; where there is no terminal, lines that say it now and then."""
    if _command.quiet or sys.stdout.isatty():
        return choose_progress()
    return Lines(TimeLeft((StageShare("points", 0.0, 1.0),)))


def announce(text: str) -> None:
    """Print a line before the work begins, unless --quiet is given."""
    if not _command.quiet:
        print(printable(text), flush=True)


class Bars:
    """A live bar per stage, which stays on the screen when the stage is done."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Open a bar of ``total`` steps; call what it yields once per step."""
        raise_if_received()
        bar = RichProgress(*_columns(), TimeRemainingColumn(), console=Console(file=sys.stdout))
        start = perf_counter()
        with bar:
            task = bar.add_task(escape(printable(title)), total=total or None)

            def advance() -> None:
                raise_if_received()
                bar.advance(task)

            yield advance
        _finish(title, perf_counter() - start)

    @contextmanager
    def line(self) -> Iterator[Show]:
        """Keep one line at the bottom of the terminal, and its last text when the block ends."""
        with Live(Text(""), console=Console(file=sys.stdout), refresh_per_second=8) as live:

            def show(text: str) -> None:
                raise_if_received()
                live.update(Text(printable(text)))

            yield show


class RunBars:
    """A bar for each stage of a run, and below them one for the whole, with the time that it still takes."""

    def __init__(self) -> None:
        self._left = TimeLeft()
        self._console = Console(file=sys.stdout)
        self._stages = RichProgress(*_columns(), console=self._console)
        self._whole = RichProgress(
            TextColumn("{task.description:<28}"),
            BarColumn(),
            TimeElapsedColumn(),
            _LeftColumn(self._left),
            console=self._console,
        )

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Keep the bars on the screen while the block runs, and after it those of the stages."""
        whole = self._whole.add_task("whole run", total=1.0)
        with Live(Group(self._stages, self._whole), console=self._console, refresh_per_second=4):
            yield self
            self._whole.update(whole, completed=1.0)

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Add a bar of ``total`` steps; call what it yields once per step."""
        raise_if_received()
        start, steps = perf_counter(), 0
        task = self._stages.add_task(escape(printable(title)), total=total or None)
        self._left.begin(title)

        def advance() -> None:
            nonlocal steps
            raise_if_received()
            steps += 1
            self._stages.advance(task)
            self._left.advance(steps / max(total, steps))
            self._show_share()

        self._show_share()
        yield advance
        self._stages.update(task, total=max(total, 1), completed=max(total, 1))
        self._stages.stop_task(task)
        self._left.advance(1.0)
        self._show_share()
        _finish(title, perf_counter() - start)

    def _show_share(self) -> None:
        self._whole.update(self._whole.task_ids[0], completed=self._left.share)


class _LeftColumn(ProgressColumn):
    """The time until the end of the whole run, which goes down between the steps too."""

    def __init__(self, left: TimeLeft) -> None:
        super().__init__()
        self._left = left

    def render(self, task: Task) -> Text:
        """Nothing while it is not known, or when all is done."""
        seconds = self._left.seconds()
        return Text("" if seconds is None or task.finished else f"about {duration(seconds)} left")


def duration(seconds: float) -> str:
    """As people say it: 40 s, 5 min."""
    return f"{round(seconds)} s" if seconds < 100.0 else f"{round(seconds / 60.0)} min"


def _columns() -> tuple[ProgressColumn, ...]:
    return (
        TextColumn("{task.description:<28}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )


def _finish(title: str, seconds: float) -> None:
    """Note that a stage is done."""
    _command.finished.append(title)
    _log.info("%s: %.1f s", title, seconds)


@dataclass
class _Stage:
    """A stage that is open."""

    title: str
    total: int
    """Steps; 0: their number is not known"""
    start: float
    """Time at which it began [s]"""
    steps: int = 0


class Lines:
    """One line when a stage is done, and one now and then while it goes on; with ``left`` they say how long
    the whole still takes."""

    def __init__(self, left: TimeLeft | None = None) -> None:
        self._left = left
        self._start = self._printed = perf_counter()
        self._stages: list[_Stage] = []
        """Those that are open, each within the one before"""
        self._is_watched = False

    @contextmanager
    def never_silent(self) -> Iterator[None]:
        """While the block runs, print a line whenever none was printed for ``SILENCE_S``."""
        if self._is_watched:
            yield
            return
        done = threading.Event()

        def watch() -> None:
            while not done.wait(max(self._printed + SILENCE_S - perf_counter(), 0.01)):
                if perf_counter() - self._printed >= SILENCE_S:
                    self._print(self._going_on())

        self._is_watched, self._printed = True, perf_counter()
        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            done.set()
            watcher.join()
            self._is_watched = False

    def _going_on(self) -> str:
        """What is being done, and how far it is."""
        if not self._stages:
            return f"working, {duration(perf_counter() - self._start)} since the start{self._time_left()}"
        stage = self._stages[-1]
        count = f"{stage.steps} of {stage.total}" if stage.total else "working"
        since = duration(perf_counter() - stage.start)
        return f"{printable(stage.title)}: {count} after {since}{self._time_left()}"

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Count the steps; print title, count and seconds at the end."""
        raise_if_received()
        stage = _Stage(title, total, perf_counter())
        if self._left is not None:
            self._left.begin(title)

        def advance() -> None:
            raise_if_received()
            stage.steps += 1
            if self._left is not None:
                self._left.advance(stage.steps / max(total, stage.steps))

        self._stages.append(stage)
        try:
            with self.never_silent():
                yield advance
        finally:
            self._stages.remove(stage)
        seconds = perf_counter() - stage.start
        count = f"{stage.steps} in " if stage.steps else ""
        self._print(f"{printable(title)}: {count}{seconds:.1f} s{self._what_is_left()}")
        _finish(title, seconds)

    @contextmanager
    def line(self) -> Iterator[Show]:
        """Print every text on a line of its own."""

        def show(text: str) -> None:
            raise_if_received()
            self._print(printable(text))

        yield show

    def _what_is_left(self) -> str:
        if self._left is None:
            return ""
        self._left.advance(1.0)
        return self._time_left()

    def _time_left(self) -> str:
        seconds = None if self._left is None or self._left.share >= 1.0 else self._left.seconds()
        return "" if seconds is None else f"; about {duration(seconds)} left"

    def _print(self, text: str) -> None:
        self._printed = perf_counter()
        print(text, flush=True)


class Quiet(Lines):
    """Nothing is shown."""

    @contextmanager
    def never_silent(self) -> Iterator[None]:
        """Nothing, here too."""
        yield

    def _print(self, text: str) -> None:
        del text


class _PlainWarnings(logging.Handler):
    """Notes and warnings on standard output, whatever that is at the time: one line each, and each once."""

    def __init__(self, warnings: list[str]) -> None:
        super().__init__(NOTE)
        self._warnings = warnings
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = one_line(record.getMessage())
        line = f"{record.levelname.lower()}: {message}"
        if line in self._printed:
            return
        self._printed.add(line)
        if record.levelno >= logging.WARNING:
            self._warnings.append(message)
        if not _command.quiet:
            print(line, flush=True)


def is_working() -> bool:
    """Whether the command has finished a stage of its work."""
    return bool(_command.finished)


@contextmanager
def show_warnings(quiet: bool = False, verbose: bool = False) -> Iterator[list[str]]:
    """Print the program's notes and warnings while the block runs, which is one command.

    Yields a list to which the warnings are appended. ``quiet``: print none. ``verbose``: show what is logged
    (a run's log.txt) on standard error.
    """
    warnings: list[str] = []
    handlers: list[logging.Handler] = [_PlainWarnings(warnings)]
    # Errors are reported by the last line on standard error.
    handlers[0].addFilter(lambda record: record.levelno < logging.ERROR)
    if verbose:
        log = logging.StreamHandler(sys.stderr)
        log.setFormatter(logging.Formatter(LOG_FORMAT))
        log.setLevel(logging.INFO)
        handlers.append(log)
    global _command
    _command = _Command(quiet)
    root, own = logging.getLogger(), logging.getLogger("polhode")
    level = own.level
    own.setLevel(logging.INFO if verbose else NOTE)
    for handler in handlers:
        root.addHandler(handler)
    try:
        yield warnings
    finally:
        # what it has finished is asked for after the block
        _command.quiet = False
        own.setLevel(level)
        for handler in handlers:
            root.removeHandler(handler)
