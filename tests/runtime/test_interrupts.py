"""Signals that end a program: once, not in the clean-up, and not amid steps that belong together."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

from polhode.runtime.interrupts import (
    interrupts_delayed,
    interrupts_kept,
    interrupts_raised,
    raise_if_received,
    received,
)

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def handlers_stay() -> Iterator[None]:
    before = [signal.getsignal(number) for number in ENDING]
    yield
    assert [signal.getsignal(number) for number in ENDING] == before


def send(*numbers: int) -> None:
    for number in numbers:
        os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_raises_once_and_none_interrupts_the_clean_up(number: signal.Signals) -> None:
    called, cleaned = [], []

    def program() -> None:
        with interrupts_raised(first=lambda: called.append(1)):
            try:
                send(number)
                pytest.fail("not interrupted")
            finally:
                send(*ENDING)
                cleaned.append(received())

    with pytest.raises(KeyboardInterrupt):
        program()
    assert (called, cleaned) == ([1], [number])


def test_an_ignored_signal_stays_ignored_and_a_handler_of_its_own_is_kept() -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    own = signal.signal(signal.SIGTERM, lambda number, frame: seen.append(number))
    try:
        with interrupts_raised(first=lambda: None):
            send(signal.SIGHUP, signal.SIGTERM)
            assert received() is None
    finally:
        signal.signal(signal.SIGHUP, before)
        signal.signal(signal.SIGTERM, own)
    assert seen == [signal.SIGTERM]


def test_an_interrupt_that_a_library_has_swallowed_is_raised_again_by_who_asks() -> None:
    with interrupts_raised(first=lambda: None):
        raise_if_received()
        with suppress(KeyboardInterrupt):
            send(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            raise_if_received()


def test_a_signal_that_is_kept_is_raised_by_who_asks_or_by_the_next_one() -> None:
    called: list[int] = []
    for ask in (raise_if_received, lambda: send(signal.SIGINT)):
        with interrupts_raised(first=lambda: called.append(1)):
            with interrupts_kept():
                send(signal.SIGTERM)
            assert called == [] and received() == signal.SIGTERM
            with pytest.raises(KeyboardInterrupt):
                ask()
            assert called == [1] and received() == signal.SIGTERM
            called.clear()
    with pytest.raises(KeyboardInterrupt), interrupts_kept():  # where this package is a library
        send(signal.SIGINT)


def test_a_signal_amid_steps_that_belong_together_takes_effect_after_them() -> None:
    steps: list[str] = []

    def program() -> None:
        with interrupts_delayed():
            send(signal.SIGINT, signal.SIGINT)
            steps.append("done")
        steps.append("not reached")

    with pytest.raises(KeyboardInterrupt), interrupts_raised(first=lambda: steps.append("interrupted")):
        program()
    with pytest.raises(KeyboardInterrupt):  # by Python's own handler, where this package is a library
        program()
    assert steps == ["done", "interrupted", "done"]
