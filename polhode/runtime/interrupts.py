"""SIGINT, SIGTERM and SIGHUP: each ends a command in order, by one KeyboardInterrupt."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals that ask a program to end."""

_received: signal.Signals | None = None
"""The signal that is ending the block of ``interrupts_raised``"""
_at_once: Callable[[], object] | None = None
"""What the block of ``interrupts_raised`` does first; None: there is no such block"""
_is_kept = False
"""Whether the signal has raised nothing yet"""


@contextmanager
def interrupts_raised(first: Callable[[], object]) -> Iterator[None]:
    """The first signal within the block calls ``first`` and raises KeyboardInterrupt; later ones do nothing.

    So nothing interrupts the clean-up. A signal that is ignored already (SIGHUP under nohup) stays ignored,
    and one that has a handler of its own keeps it. Other threads than the main one cannot set handlers: there
    the block changes nothing.
    """
    global _received, _at_once, _is_kept

    def raise_once(number: int, frame: FrameType | None) -> None:
        del frame
        global _received, _is_kept
        if _received is None or _is_kept:
            _received, _is_kept = _received or signal.Signals(number), False
            first()
            raise KeyboardInterrupt

    _at_once = first
    try:
        with _handlers(raise_once, replacing=(signal.SIG_DFL, signal.default_int_handler)):
            yield
    finally:
        _received, _at_once, _is_kept = None, None, False


def received() -> signal.Signals | None:
    """The signal that is ending the present block of ``interrupts_raised``."""
    return _received


def raise_if_received() -> None:
    """Raise KeyboardInterrupt for a signal that was kept, and again in case a library has swallowed the first
    one."""
    global _is_kept
    if _received is not None:
        if _is_kept and _at_once is not None:
            _is_kept = False
            _at_once()
        raise KeyboardInterrupt


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """A signal within the block raises nothing: ``raise_if_received`` does, or the next signal.

    For a clean-up that Python calls itself, such as that of a generator which nobody asks any more: what is
    raised there is printed and lost. Outside of ``interrupts_raised`` the signal takes effect at the end.
    """
    global _received, _is_kept
    waiting: list[int] = []
    try:
        with _collected() as waiting:
            yield
    finally:
        if waiting and _at_once is None:
            signal.raise_signal(waiting[0])
        elif waiting and _received is None:
            _received, _is_kept = signal.Signals(waiting[0]), True


@contextmanager
def interrupts_delayed() -> Iterator[None]:
    """A signal within the block takes effect at its end: for the few steps that belong together."""
    waiting: list[int] = []
    try:
        with _collected() as waiting:
            yield
    finally:
        if waiting:
            signal.raise_signal(waiting[0])


@contextmanager
def interrupt_noted() -> Iterator[Callable[[], bool]]:
    """Ctrl-C within the block is noted, and ends nothing: what it yields says whether it has come.

    For work that is to be finished with what there is. SIGTERM and SIGHUP end the command as always.
    """
    with _collected((signal.SIGINT,)) as noted:
        yield lambda: bool(noted)


@contextmanager
def _collected(of: tuple[signal.Signals, ...] = SIGNALS) -> Iterator[list[int]]:
    """The signals that come within the block, which do nothing else."""
    found: list[int] = []
    with _handlers(lambda number, frame: found.append(number), of=of):
        yield found


@contextmanager
def _handlers(
    handler: Callable[[int, FrameType | None], object],
    replacing: tuple[object, ...] | None = None,
    of: tuple[signal.Signals, ...] = SIGNALS,
) -> Iterator[None]:
    """Handle the signals within the block; ``replacing``: only those that have one of these handlers."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in of:
            present = signal.getsignal(number)
            kept = present not in replacing if replacing else present in (signal.SIG_IGN, None)
            if not kept:
                before[number] = present
                signal.signal(number, handler)
    try:
        yield
    finally:
        for number, present in before.items():
            signal.signal(number, present)
