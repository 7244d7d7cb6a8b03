"""The benchmark of kills: its own judgement, on results that are whole, old, mixed or half."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.robustness import kills
from benchmarks.robustness.disturbed_commands import JOBS, Job
from benchmarks.robustness.kills import FULL, KILLS, MARK, print_tables
from benchmarks.robustness.results import contents, is_failed_run, judged, names_of, size_of
from benchmarks.robustness.small_data import write_boards
from benchmarks.robustness.stage import Stage
from polhode.calibration.boards import make_board
from polhode.calibration.detection import Found, find_board
from polhode.cli.main import COMMANDS

NEW, OLD = {"R/a": "1", "R/b": "2"}, {"R/a": "0", "R/c": "0"}


def test_every_command_that_writes_is_killed_and_finds_its_disk_full() -> None:
    assert (sum(KILLS.values()), sum(FULL.values())) == (66, 25)
    assert KILLS.keys() == JOBS.keys() and FULL.keys() < JOBS.keys()
    # `view` writes its one file at the end, by the function that writes the others' single files; `sweep`,
    # its workers and its scheduler are killed by tests of their own (tests/studies/test_cluster.py).
    printing = {"threshold", "doctor", "completion", "expect"}
    assert {job.words[0] for job in JOBS.values()} == set(COMMANDS) - printing - {"view", "sweep"}


def test_a_result_is_whole_old_or_something_worse() -> None:
    assert judged(NEW, OLD, NEW, False) == "new"
    assert judged(OLD, OLD, NEW, False) == "old"
    for mixed in ({}, {"R/a": "1"}, OLD | NEW, {"R/a": "1", "R/c": "0"}):
        assert judged(mixed, OLD, NEW, False) == "lost"
    assert judged({}, {}, NEW, False) == "absent"
    assert judged({"R/.polhode-output": "x"}, {}, NEW, False) == "absent"
    assert judged({"R/a": "1"}, {}, NEW, False) == "half"
    assert judged({"R/a": "1"}, {}, NEW, True) == "unfinished"


def test_times_and_the_place_do_not_count_but_everything_else_does(tmp_path: Path) -> None:
    def made(name: str, seconds: float, value: float) -> dict[str, str]:
        place = tmp_path / name
        (place / "R").mkdir(parents=True)
        (place / "R" / "log.txt").write_text(f"{seconds}")
        (place / "R" / "config.yaml").write_text(f"output: {place}/R\n")
        (place / "R" / "summary.json").write_text(
            json.dumps({"timing_s": {"a": seconds}, "own_sha256": f"{seconds}", "value": value})
        )
        return contents(place, ("R",))

    assert made("a", 1.0, 5.0) == made("b", 2.0, 5.0)
    assert made("c", 1.0, 6.0) != made("d", 1.0, 5.0)


def test_the_folder_of_a_case_is_emptied_before_it_is_laid_out(tmp_path: Path) -> None:
    stage, job = Stage(tmp_path), Job("x", ("report",), ("page.html",), inputs=("in",))
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a").write_text("a")
    (tmp_path / "jobs" / "x" / "old").mkdir(parents=True)
    (tmp_path / "jobs" / "x" / "old" / "page.html").write_text("old")
    place = tmp_path / "place"
    (place / "left").mkdir(parents=True)
    stage.lay_out(job, place)
    assert names_of(place) == ("in", "in/a", "page.html")
    assert size_of(place) == 3 * 4096
    assert stage.filled_in(("{place}/x", "{stage}"), place) == [f"{place}/x", str(tmp_path)]


def test_a_run_that_says_that_it_failed_is_no_half_result(tmp_path: Path) -> None:
    assert not is_failed_run(tmp_path)
    (tmp_path / "summary.json").write_text('{"status": "failed"}')
    assert is_failed_run(tmp_path)


def test_processes_that_are_left_are_found_by_the_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kills, "GONE_S", 0.2)
    words = [sys.executable, "-c", "print(flush=True); input()"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    child = subprocess.Popen(words, env=os.environ | {MARK: str(tmp_path)}, **pipes)  # type: ignore[call-overload]
    assert child.stdout.readline() and not kills._gone(tmp_path)
    child.communicate()
    assert kills._gone(tmp_path)


def test_the_tables_count_what_holds_and_show_what_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    case = {"fault": "kill", "job": "run", "seed": 0}
    lines = [
        {"case": case, "moment": "1.00 s", "state": "absent", "failures": []},
        {"case": case | {"seed": 1}, "moment": "change 3", "state": "half", "failures": ["kept: half"]},
    ]
    print_tables(lines)
    out = capsys.readouterr().out
    assert "| killed | run | 2 | 1 | 1 absent, 1 half | 1 |" in out
    assert "1 of 2 hold" in out and "kill run 1 (change 3): kept: half" in out


def test_inputs_are_made_for_the_commands_that_read_them() -> None:
    of = {name: {job for job in JOBS if JOBS[job].reads(name)} for name in ("S", "R", "corpus", "boards")}
    assert of["boards"] == {"calibrate"} and of["corpus"] == {"train"}
    assert {"run", "evaluate", "checkout", "import"} <= of["S"] and "import" not in of["R"]
    assert {"plan", "predict", "compare", "evaluate"} <= of["R"]


def test_the_boards_that_are_calibrated_show_a_board(tmp_path: Path) -> None:
    board = make_board("chessboard", "7x5", 0.03)
    folder = write_boards(tmp_path / "boards")
    for side in ("left", "right"):
        images = sorted((folder / side).iterdir())
        assert len(images) == 8
        assert isinstance(find_board(np.asarray(Image.open(images[0])), board), Found)
