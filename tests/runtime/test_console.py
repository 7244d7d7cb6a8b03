"""What a person sees while it works, on standard output, and how long a whole run still takes."""

import logging
import re
import time
from pathlib import Path

import pytest

from polhode.runtime import console
from polhode.runtime.console import (
    Bars,
    Lines,
    Quiet,
    choose_progress,
    duration,
    progress_of_run,
    show_warnings,
)
from polhode.runtime.time_left import RUN_SHARES, StageShare, TimeLeft

Capture = pytest.CaptureFixture[str]
SHARES = (StageShare("first", 0.1, 0.4), StageShare("again", 0.4, 0.5), StageShare("again", 0.6, 0.8))


class Clock:
    """A clock that a test sets."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def test_a_run_is_never_silent(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    assert isinstance(choose_progress(), Lines)
    monkeypatch.setattr(console, "SILENCE_S", 0.1)
    with progress_of_run() as progress:
        time.sleep(0.3)
        with progress.stage("features", 3) as advance:
            advance()
            time.sleep(0.3)
        with progress.stage("matching", 0):
            time.sleep(0.3)
    with Quiet().stage("features", 3):
        time.sleep(0.2)
    text, error = capsys.readouterr()
    assert error == ""
    assert re.match(r"working, \d s since the start\n", text)
    assert re.search(r"\nfeatures: 1 of 3 after \d s", text)
    assert re.search(r"\nfeatures: 1 in 0\.\d s", text)
    assert re.search(r"\nmatching: working after \d s", text)
    assert re.search(r"\nmatching: 0\.\d s.*\n$", text)


@pytest.mark.parametrize("left", [None, TimeLeft(SHARES)])
def test_bars_count_and_write_to_standard_output_only(left: TimeLeft | None, capsys: Capture) -> None:
    with Bars(left).stage("first", 2) as advance:
        advance()
        advance()
    captured = capsys.readouterr()
    assert "first" in captured.out and "2/2" in captured.out and captured.err == ""
    assert ("whole run" in captured.out) == (left is not None)


def test_warnings_are_one_line_on_standard_output(capsys: Capture) -> None:
    with show_warnings() as warnings:
        logging.getLogger("polhode.frontend.any").warning("two\nlines")
        logging.getLogger("polhode.frontend.any").warning("two lines")
        logging.getLogger("polhode.frontend.any").error("the caller tells errors")
    logging.getLogger("polhode.frontend.any").error("later")
    assert capsys.readouterr().out == "warning: two lines\n" and warnings == ["two lines"]


def test_the_time_left_is_right_when_the_shares_are() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    assert left.seconds() is None
    clock.seconds = 10.0
    left.begin("first (rootsift)")
    clock.seconds = 25.0
    left.advance(0.5)
    assert left.seconds() == pytest.approx(75.0)
    # between steps it goes down by itself
    clock.seconds = 30.0
    assert left.seconds() == pytest.approx(70.0)
    clock.seconds = 40.0
    left.advance(1.0)
    assert left.seconds() == pytest.approx(60.0) and left.share == pytest.approx(0.4)


def test_a_slow_machine_is_noticed_and_a_stage_that_hangs_leaves_what_follows_it() -> None:
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    left.begin("first")
    clock.seconds = 60.0
    left.advance(1.0)
    # three tenths of the whole took a minute, six are left
    assert left.seconds() == pytest.approx(120.0)
    left.begin("again")
    clock.seconds = 1000.0
    # the stage was to end at half of the whole
    assert left.seconds() == pytest.approx(120.0 * 0.5 / 0.6)
    left.advance(1.0)
    clock.seconds = 5000.0
    # the next one was to begin a tenth of the whole later
    assert left.seconds() == pytest.approx((1000.0 / 0.4 * 0.5) * 0.4 / 0.5)
    # a resumed run counts from the first stage that it does, and an unknown one changes nothing
    clock = Clock()
    left = TimeLeft(SHARES, clock)
    for title, share in (("again", 0.5), ("something else", 0.5), ("again", 0.8), ("again", 0.8)):
        left.begin(title)
        clock.seconds = 10.0
        left.advance(1.0)
        assert left.share == pytest.approx(share)
        assert share != 0.5 or left.seconds() == pytest.approx(50.0)


def test_the_lines_of_a_run_say_what_is_left(capsys: Capture) -> None:
    clock = Clock()
    with Lines(TimeLeft(SHARES, clock)).stage("first", 2) as advance:
        clock.seconds = 30.0
        advance()
        advance()
    assert capsys.readouterr().out.endswith("s; about 60 s left\n")
    assert duration(99.0) == "99 s" and duration(150.0) == "2 min"


def test_the_table_goes_forward_and_its_stages_are_those_of_the_program() -> None:
    times = [time for share in RUN_SHARES for time in (share.begins, share.ends)]
    assert times == sorted(times) and times[0] >= 0.0 and times[-1] == 1.0
    root = Path(__file__).parents[2] / "polhode"
    files = [path for room in ("pipeline", "backend", "mapping") for path in (root / room).rglob("*.py")]
    code = "".join(path.read_text() for path in files)
    for share in RUN_SHARES:
        assert f'stage("{share.title}' in code or f'stage(f"{share.title}' in code
