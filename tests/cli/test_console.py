"""What a person sees while it works: on standard output, and in plain lines where there is no terminal."""

import logging
import re

import pytest

from polhode.cli.console import Bars, Lines, choose_progress, show_warnings


def test_a_stage_is_one_line_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    progress = choose_progress()
    assert isinstance(progress, Lines)
    with progress.stage("features", 3) as advance:
        for _ in range(3):
            advance()
    captured = capsys.readouterr()
    assert re.fullmatch(r"features: 3 in \d+\.\d s\n", captured.out)
    assert captured.err == ""


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
