"""Every command and every signal that ends it: one line, the exit code 128 + n, nothing half-written."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from polhode.cli.main import COMMANDS, main
from polhode.simulation.dataset.frame_renderer import FrameRenderer

Capture = pytest.CaptureFixture[str]
ENDING = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
WORDS = {
    "simulate": "C -o S",
    "calibrate": "C -o D --board 9x6 --square-mm 20",
    "checkout": "S -o D",
    "import": "C -o S",
    "run": "C --data S -o R",
    "evaluate": "R S",
    "compare": "C -o D",
    "sweep": "C -o D",
    "predict": "R --horizon 60",
    "threshold": "--radius-m 2 --mass-kg 100 --force-n 1 --isp-s 220 --duration-s 60 --fuel-fraction 0.1",
    "expect": "--rules F --size 1 --range 4 --rpm 2 --focal-px 600 --baseline 0.1",
    "plan": "R -o D",
    "observability": "R -o D",
    "export": "R --to stl -o F",
    "report": "R -o F",
    "view": "R",
    "train": "C",
    "doctor": "",
    "completion": "bash",
}
KEPT = {
    "compare": "finished rows are kept",
    "sweep": "points that are done are kept",
    "train": "finished scenes and the last checkpoint are kept",
}


@pytest.mark.parametrize(
    ("command", "number"),
    [*((command, signal.SIGTERM) for command in COMMANDS), *(("run", number) for number in ENDING)],
)
def test_each_command_ends_in_order_by_each_signal(
    command: str, number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("C").write_text("seed: 1\n")
    cleaned: list[int] = []

    def interrupted(self: Any) -> int:
        try:
            os.kill(os.getpid(), number)
            pytest.fail("not interrupted")
        finally:
            for other in ENDING:
                os.kill(os.getpid(), other)
            cleaned.append(1)

    monkeypatch.setattr(COMMANDS[command], "execute", interrupted)
    assert main([command, *WORDS[command].split()]) == ENDING[number]
    kept = KEPT.get(command, "nothing was written or replaced")
    error = capsys.readouterr().err
    assert error.startswith(f"polhode: error: {command} interrupted by {number.name}; {kept}")
    assert error.count("\n") == 1
    assert cleaned == [1]


@pytest.mark.parametrize("number", ENDING)
def test_an_interrupted_run_leaves_nothing_and_what_was_there(
    number: signal.Signals,
    small_sequence: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.setattr(
        "polhode.pipeline.correspondences.extract_features", lambda *_: os.kill(os.getpid(), number)
    )
    before = sorted(tmp_path.iterdir())
    assert main(["run", "--data", str(small_sequence), "-o", str(tmp_path / "R")]) == ENDING[number]
    assert sorted(tmp_path.iterdir()) == before
    assert f"run interrupted by {number.name}" in capsys.readouterr().err


SCENE = """
seed: 4
scene:
  frames: 6
  truth_horizon_s: 0
  rig: {width_px: 48, height_px: 36, focal_px: 35.0}
  motion: {position_m: [0.04, 0.0, 0.6]}
  light: {earth: 0.0}
  render: {samples: 1, bounces: 0}
"""


def test_a_terminated_simulation_tells_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    write_pair = FrameRenderer.write_pair

    def interrupted(self: FrameRenderer, k: int, mav0: Path) -> None:
        if k == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        write_pair(self, k, mav0)

    words = ["simulate", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "S"), "--runtime.workers", "1"]
    with monkeypatch.context() as patch:
        patch.setattr(FrameRenderer, "write_pair", interrupted)
        assert main(words) == 143
    error = capsys.readouterr().err
    assert "simulate interrupted by SIGTERM; 3 of 6 pairs are kept, the same command goes on" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == [".S.partial", "scene.yaml"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert re.match(r"body [\d.]+ x [\d.]+ x [\d.]+ m along x, y, z; \d+ faces", lines[0])
    assert any(line.startswith("rendering (3 of 6 were there): 3 in") for line in lines)
    assert lines[-1] == f"6 stereo pairs with truth: {tmp_path / 'S'}"


def test_a_signal_to_the_whole_group_of_processes_is_one_line(tmp_path: Path) -> None:
    """Such as that of a batch system; the workers leave it to the program."""
    (tmp_path / "scene.yaml").write_text(SCENE.replace("frames: 6", "frames: 500"))
    words = ["simulate", "scene.yaml", "-o", "S", "--runtime.workers", "2"]
    program = subprocess.Popen(
        [sys.executable, "-m", "polhode", *words],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        while not list(tmp_path.glob(".S.partial/.frames/*.done")):
            assert program.poll() is None
            time.sleep(0.01)
        os.killpg(program.pid, signal.SIGHUP)
        _, error = program.communicate(timeout=60)
    finally:
        program.kill()
    assert program.returncode == 129
    assert error.startswith("polhode: error: simulate interrupted by SIGHUP; ")
    assert "of 500 pairs are kept" in error
    assert error.count("\n") == 1
