"""Progress and warnings on the terminal: one bar per stage, or plain lines where there is no terminal.

Everything goes to standard output; standard error is kept for the one line of an error. With --json, the
program sends all of it to standard error instead; with --quiet none of it is shown.
"""

import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from time import perf_counter

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from polhode.runtime.errors import one_line, printable
from polhode.runtime.interrupts import raise_if_received
from polhode.runtime.progress import NOTE, Advance, Progress, Show

_log = logging.getLogger(__name__)
SILENCE_S = 30.0
"""Where there is no terminal, a line says what is going on when none was printed for so long."""


@dataclass
class _Command:
    """What is known of the command that runs."""

    quiet: bool = False
    finished: list[str] = field(default_factory=list)
    """Titles of the stages that it has finished"""


_command = _Command()


def choose_progress() -> "Lines":
    """Bars on a terminal, plain lines in a file, a pipe or CI; nothing with --quiet."""
    return Bars() if sys.stdout.isatty() and not _command.quiet else Lines(_command.quiet)


@contextmanager
def progress_of_run() -> Iterator[Progress]:
    """Show the stages of a whole run, and what goes on between them."""
    progress = choose_progress()
    with progress.watched():
        yield progress


def announce(text: str) -> None:
    """Print lines before the work begins, or while it goes on, unless --quiet is given."""
    if not _command.quiet:
        print("\n".join(printable(line) for line in text.split("\n")), flush=True)


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
    """One line when a stage is done, and one now and then while it goes on; ``quiet``: none."""

    def __init__(self, quiet: bool = False) -> None:
        self._is_quiet, self._is_watched = quiet, False
        self._start = self._printed = perf_counter()
        self._stages: list[_Stage] = []
        """Those that are open, each within the one before"""

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Show what goes on while the block runs, also between its stages."""
        if self._is_watched or self._is_quiet:
            yield
            return
        self._is_watched = True
        try:
            with self._watch():
                yield
        finally:
            self._is_watched = False

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Advance]:
        """Show a stage of ``total`` steps; call what it yields once per step."""
        raise_if_received()
        stage = _Stage(printable(title), total, perf_counter())

        def advance() -> None:
            raise_if_received()
            stage.steps += 1
            self._show_step()

        with self.watched(), self._open(stage):
            yield advance
        seconds = perf_counter() - stage.start
        self._show_end(stage, seconds)
        _command.finished.append(title)
        _log.info("%s: %.1f s", title, seconds)

    @contextmanager
    def line(self) -> Iterator[Show]:
        """Show a line of text, which the next one replaces or follows."""
        with self._text() as show:

            def checked(text: str) -> None:
                raise_if_received()
                show(printable(text))

            yield checked

    @contextmanager
    def _watch(self) -> Iterator[None]:
        """Print a line whenever none was printed for ``SILENCE_S``."""
        done = threading.Event()

        def watch() -> None:
            while not done.wait(max(self._printed + SILENCE_S - perf_counter(), 0.01)):
                now = perf_counter()
                if now - self._printed < SILENCE_S:
                    continue
                if not self._stages:
                    self._print(f"working, {duration(now - self._start)} since the start")
                    continue
                stage = self._stages[-1]
                passed = now - stage.start
                text = f"{stage.steps} of {stage.total}" if stage.total else "working"
                text = f"{stage.title}: {text} after {duration(passed)}"
                if 0 < stage.steps <= stage.total:
                    text += f"; about {duration(passed * (stage.total / stage.steps - 1.0))} left"
                self._print(text)

        self._printed = perf_counter()
        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            yield
        finally:
            done.set()
            watcher.join()

    @contextmanager
    def _open(self, stage: _Stage) -> Iterator[None]:
        self._stages.append(stage)
        try:
            yield
        finally:
            self._stages.remove(stage)

    def _show_step(self) -> None:
        """Nothing: lines come when time has passed."""

    def _show_end(self, stage: _Stage, seconds: float) -> None:
        self._print(f"{stage.title}: {f'{stage.steps} in ' if stage.steps else ''}{seconds:.1f} s")

    def _text(self) -> AbstractContextManager[Show]:
        return nullcontext(self._print)

    def _print(self, text: str) -> None:
        self._printed = perf_counter()
        if not self._is_quiet:
            print(text, flush=True)


class Bars(Lines):
    """A live bar for each stage, with the time that it still takes, which stays when the stage is done."""

    @contextmanager
    def _watch(self) -> Iterator[None]:
        columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        console = Console(file=sys.stdout)
        with RichProgress(TextColumn("{task.description:<28}"), *columns, console=console) as self._bars:
            yield

    @contextmanager
    def _open(self, stage: _Stage) -> Iterator[None]:
        self._task = task = self._bars.add_task(escape(stage.title), total=stage.total or None)
        yield
        done = max(stage.total, 1)
        self._bars.update(task, total=done, completed=done)

    def _show_step(self) -> None:
        self._bars.advance(self._task)

    def _show_end(self, stage: _Stage, seconds: float) -> None:
        """Nothing: the bar has it."""

    @contextmanager
    def _text(self) -> Iterator[Show]:
        with Live(Text(""), console=Console(file=sys.stdout), refresh_per_second=8) as live:
            yield lambda text: live.update(Text(text))


def duration(seconds: float) -> str:
    """As people say it: 40 s, 5 min."""
    return f"{round(seconds)} s" if seconds < 100.0 else f"{round(seconds / 60.0)} min"


class _PlainWarnings(logging.Handler):
    """Notes and warnings on standard output, whatever that is at the time: one line each, and each once.

    Errors are left out: the last line on standard error reports them.
    """

    def __init__(self, warnings: list[str]) -> None:
        super().__init__(NOTE)
        self._warnings = warnings
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        message = one_line(record.getMessage())
        line = f"{record.levelname.lower()}: {message}"
        if line in self._printed or record.levelno >= logging.ERROR:
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
    if verbose:
        log = logging.StreamHandler(sys.stderr)
        log.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
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
