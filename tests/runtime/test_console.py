"""What a person sees while it works, on standard output."""

import logging
import re
import time

import pytest

from polhode.runtime import console
from polhode.runtime.console import (
    Bars,
    Lines,
    choose_progress,
    duration,
    progress_of_run,
    show_warnings,
)

Capture = pytest.CaptureFixture[str]


def test_a_run_is_never_silent_and_says_how_long_a_stage_still_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    assert isinstance(choose_progress(), Lines)
    monkeypatch.setattr(console, "SILENCE_S", 0.1)
    with progress_of_run() as progress:
        time.sleep(0.3)
        with progress.stage("features", 3) as advance:
            advance()
            time.sleep(0.3)
        with progress.stage("matching", 0):
            time.sleep(0.3)
    with Lines(quiet=True).stage("features", 3):
        time.sleep(0.2)
    text, error = capsys.readouterr()
    assert error == ""
    assert re.match(r"working, \d s since the start\n", text)
    assert re.search(r"\nfeatures: 1 of 3 after \d s; about \d s left\n", text)
    assert re.search(r"\nfeatures: 1 in 0\.\d s\n", text)
    assert re.search(r"\nmatching: working after \d s\n", text)
    assert re.search(r"\nmatching: 0\.\d s\n$", text)
    assert duration(99.0) == "99 s" and duration(150.0) == "2 min"


def test_bars_count_and_write_to_standard_output_only(capsys: Capture) -> None:
    with Bars().stage("first", 2) as advance:
        advance()
        advance()
    captured = capsys.readouterr()
    assert "first" in captured.out and "2/2" in captured.out and captured.err == ""


def test_warnings_are_one_line_on_standard_output(capsys: Capture) -> None:
    with show_warnings() as warnings:
        logging.getLogger("polhode.frontend.any").warning("two\nlines")
        logging.getLogger("polhode.frontend.any").warning("two lines")
        logging.getLogger("polhode.frontend.any").error("the caller tells errors")
    logging.getLogger("polhode.frontend.any").error("later")
    assert capsys.readouterr().out == "warning: two lines\n" and warnings == ["two lines"]
