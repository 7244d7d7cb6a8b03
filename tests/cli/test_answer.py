"""What a program reads: with --json one object on standard output, always with the same keys."""

import json
import logging
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.answer import SCHEMA, Answer, Outcome, plain
from polhode.cli.evaluate import EvaluateCommand
from polhode.cli.main import main
from polhode.runtime.console import announce, choose_progress, progress_of_run
from polhode.runtime.errors import RunFailure

Capture = pytest.CaptureFixture[str]
PAGE = Path(__file__).parents[2] / "docs" / "command_line.md"
KEYS = ["schema", "command", "status", "exit_code", "error", "paths", "figures", "warnings"]
THRESHOLD = "threshold --radius-m 2 --mass-kg 100 --force-n 1 --isp-s 220 --duration-s 60 --fuel-fraction 0.1"
EVALUATE = "evaluate R S"


def answered(words: str, capsys: Capture) -> tuple[dict[str, Any], str]:
    """The object on standard output, and what is on standard error."""
    code = main([*words.split(), "--json"])
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    answer: dict[str, Any] = json.loads(captured.out)
    assert list(answer) == KEYS
    assert (answer["schema"], answer["exit_code"]) == (SCHEMA, code)
    return answer, captured.err


def test_a_result_is_one_object_and_the_rest_goes_to_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    answer, stderr = answered(THRESHOLD, capsys)
    assert answer["status"] == "ok" and answer["error"] is None and stderr == ""
    rates = answer["figures"]
    assert rates["both_rad_s"] == min(rates["by_thrust_rad_s"], rates["by_fuel_rad_s"])

    def noisy(command: EvaluateCommand) -> Answer:
        print("a library prints")
        for _ in range(2):
            logging.getLogger("polhode.any").warning("the light is poor")
        warnings = ("the light is poor", "few frames")
        return Answer("m", "a table", (command.run,), figures={"x": np.float64(np.inf)}, warnings=warnings)

    monkeypatch.setattr(EvaluateCommand, "execute", noisy)
    answer, stderr = answered(EVALUATE, capsys)
    assert stderr == "a library prints\nwarning: the light is poor\n"
    assert answer["warnings"] == ["the light is poor", "few frames"], "each once"
    assert (answer["paths"], answer["figures"]) == (["R"], {"x": None})


def test_an_error_is_in_the_object_and_one_line_of_standard_error(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for words, command in (
        ("", None),
        ("run", "run"),
        ("predict none --horizon 5", "predict"),
        ("rnu", None),
    ):
        answer, stderr = answered(words, capsys)
        assert (answer["command"], answer["status"], answer["exit_code"]) == (command, "refused", 2)
        assert stderr == f"polhode: error: {answer['error']}\n"

    def failed(command: EvaluateCommand) -> Answer:
        return Answer("the best: R", paths=(command.run,), status="failed", failure="no motion fits")

    def raised(command: EvaluateCommand) -> Answer:
        raise RunFailure("no motion fits")

    def interrupted(command: EvaluateCommand) -> Answer:
        raise KeyboardInterrupt

    for execute, code, status, paths in (
        (failed, 1, "failed", ["R"]),
        (raised, 1, "failed", []),
        (interrupted, 130, "interrupted", []),
    ):
        monkeypatch.setattr(EvaluateCommand, "execute", execute)
        answer, _ = answered(EVALUATE, capsys)
        assert (answer["exit_code"], answer["status"], answer["paths"]) == (code, status, paths)


def test_quiet_leaves_the_last_line_and_verbose_adds_the_log(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def work(command: EvaluateCommand) -> Answer:
        announce("a target")
        with choose_progress().stage("features", 1) as advance, progress_of_run() as run:
            advance()
            with run.stage("matching frames", 1), choose_progress().line() as show:
                show("now")
        logging.getLogger("polhode.any").info("402 pairs matched")
        logging.getLogger("polhode.any").warning("poor light")
        return Answer("Metrics: m", "a table")

    monkeypatch.setattr(EvaluateCommand, "execute", work)
    assert main([*EVALUATE.split(), "--quiet"]) == 0
    assert capsys.readouterr() == ("Metrics: m\n", "")
    assert main(EVALUATE.split()) == 0
    captured = capsys.readouterr()
    assert captured.err == "" and captured.out.endswith("a table\nMetrics: m\n")
    assert all(text in captured.out for text in ("a target", "features: 1 in", "now", "warning: poor light"))
    assert main(["-v", *EVALUATE.split()]) == 0
    captured = capsys.readouterr()
    assert "INFO polhode.any: 402 pairs matched" in captured.err and "402" not in captured.out
    assert main([*EVALUATE.split(), "-q", "-v"]) == 2
    assert "--quiet and --verbose contradict each other" in capsys.readouterr().err


def test_what_json_does_not_have_becomes_null_or_text() -> None:
    value = {"path": Path("a"), "array": np.array([1.0, np.nan]), "deep": ({"x": np.int64(3)},), 1: None}
    assert plain(value) == {"path": "a", "array": [1.0, None], "deep": [{"x": 3}], "1": None}
    outcome = json.loads(Outcome("run", 0, Answer("", figures={"x": float("inf")})).as_json([]))
    expected = [SCHEMA, "run", "ok", 0, None, [], {"x": None}, []]
    assert outcome == dict(zip(KEYS, expected, strict=True))


def test_the_page_shows_the_object_as_it_is_and_the_version_is_an_answer_too(capsys: Capture) -> None:
    """The last example of docs/command_line.md is what the program prints."""
    blocks = PAGE.read_text().split("```json\n")[1:]
    shown = [json.loads(block.partition("```")[0]) for block in blocks]
    assert [list(each) for each in shown] == [KEYS] * len(shown)
    assert [each["command"] for each in shown] == ["run", "export", "predict"]
    assert answered("predict none --horizon 60", capsys)[0] == shown[-1]
    assert answered("--version", capsys)[0]["figures"] == {"version": version("polhode")}
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"polhode {version('polhode')}\n"
