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


@contextmanager
def interrupts_raised(first: Callable[[], object]) -> Iterator[None]:
    """The first signal within the block calls ``first`` and raises KeyboardInterrupt; later ones do nothing.

    So nothing interrupts the clean-up. A signal that is ignored already (SIGHUP under nohup) stays ignored,
    and one that has a handler of its own keeps it. Other threads than the main one cannot set handlers: there
    the block changes nothing.
    """
    global _received

    def raise_once(number: int, frame: FrameType | None) -> None:
        del frame
        global _received
        if _received is None:
            _received = signal.Signals(number)
            first()
            raise KeyboardInterrupt

    try:
        with _handlers(raise_once, replacing=(signal.SIG_DFL, signal.default_int_handler)):
            yield
    finally:
        _received = None


def received() -> signal.Signals | None:
    """The signal that is ending the present block of ``interrupts_raised``."""
    return _received


def raise_if_received() -> None:
    """Raise KeyboardInterrupt again, in case a library has swallowed the first one."""
    if _received is not None:
        raise KeyboardInterrupt


@contextmanager
def interrupts_delayed() -> Iterator[None]:
    """A signal within the block takes effect at its end: for the few steps that belong together."""
    waiting: list[int] = []
    try:
        with _handlers(lambda number, frame: waiting.append(number)):
            yield
    finally:
        for number in waiting[:1]:
            signal.raise_signal(number)


@contextmanager
def interrupt_noted() -> Iterator[Callable[[], bool]]:
    """Ctrl-C within the block is noted, and ends nothing: what it yields says whether it has come.

    For work that is to be finished with what there is. SIGTERM and SIGHUP end the command as always.
    """
    noted: list[int] = []
    with _handlers(lambda number, frame: noted.append(number), of=(signal.SIGINT,)):
        yield lambda: bool(noted)


Handler = Callable[[int, FrameType | None], object]


@contextmanager
def _handlers(
    handler: Handler,
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
