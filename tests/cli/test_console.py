"""What a person sees while it works: on standard output, and in plain lines where there is no terminal."""

import logging
import re
import time

import pytest

from polhode.cli import console
from polhode.cli.console import Bars, Lines, Quiet, choose_progress, progress_of_run, show_warnings


def test_a_stage_is_one_line_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    progress = choose_progress()
    assert isinstance(progress, Lines)
    with progress.stage("features", 3) as advance:
        for _ in range(3):
            advance()
    captured = capsys.readouterr()
    assert re.fullmatch(r"features: 3 in \d+\.\d s\n", captured.out)
    assert captured.err == ""


def test_a_line_says_how_far_a_long_stage_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "SILENCE_S", 0.1)
    for progress in (Lines(), Quiet()):
        with progress.stage("features", 3) as advance:
            advance()
            time.sleep(0.4)
        time.sleep(0.2)
    lines = capsys.readouterr().out.splitlines()
    assert 2 <= len(lines) <= 5
    assert all(re.fullmatch(r"features: 1 of 3 after \d s", line) for line in lines[:-1])
    assert re.fullmatch(r"features: 1 in 0\.\d s", lines[-1])


def test_a_run_is_not_silent_between_its_stages_either(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "SILENCE_S", 0.1)
    with progress_of_run() as progress:
        time.sleep(0.3)
        with progress.stage("features", 0):
            time.sleep(0.3)
    text = capsys.readouterr().out
    assert re.match(r"working, \d s since the start\n", text)
    assert re.search(r"\nfeatures: working after \d s", text)


def test_bars_count_and_write_to_standard_output_only(capsys: pytest.CaptureFixture[str]) -> None:
    with Bars().stage("features", 2) as advance:
        advance()
        advance()
    captured = capsys.readouterr()
    assert "features" in captured.out
    assert "2/2" in captured.out
    assert captured.err == ""


def test_warnings_are_one_line_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    with show_warnings():
        logging.getLogger("polhode.frontend.any").warning("two\nlines")
        logging.getLogger("polhode.frontend.any").error("the caller tells errors")
    logging.getLogger("polhode.frontend.any").error("later")
    captured = capsys.readouterr()
    assert captured.out == "warning: two lines\n"
