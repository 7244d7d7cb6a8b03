"""``polhode simulate`` at the command line: what it says, what it refuses, and that it goes on."""

import re
from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.simulation.dataset.frame_renderer import FrameRenderer

SCENE = """
seed: 4
scene:
  frames: 4
  truth_horizon_s: 0
  rig: {width_px: 48, height_px: 36, focal_px: 35.0}
  motion: {position_m: [0.04, 0.0, 0.6]}
  light: {earth: 0.0}
  render: {samples: 1, bounces: 0}
  sensor: {dropped_frames: [2]}
runtime: {workers: 1}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_the_first_line_tells_the_bodys_size_and_the_last_the_pairs_and_the_path(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "S"
    assert main(["simulate", str(config), "-o", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert re.match(r"body [\d.]+ x [\d.]+ x [\d.]+ m along x, y, z; \d+ faces", lines[0])
    assert lines[-1] == f"3 stereo pairs with truth: {folder}"


def test_an_interrupt_is_one_line_and_the_same_command_goes_on(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["simulate", str(config), "-o", str(tmp_path / "S")]
    write_pair = FrameRenderer.write_pair
    with monkeypatch.context() as patch:

        def interrupted(self: FrameRenderer, k: int, mav0: Path) -> None:
            if k == 3:
                raise KeyboardInterrupt
            write_pair(self, k, mav0)

        patch.setattr(FrameRenderer, "write_pair", interrupted)
        assert main(command) == 130
    error = capsys.readouterr().err
    kept = "2 of 3 pairs are kept, the same command goes on from there"
    assert error == f"polhode: error: simulate interrupted; {kept}\n"
    assert main(command) == 0
    assert "rendering (2 of 3 were there): 1 in" in capsys.readouterr().out


def test_a_folder_that_is_no_dataset_is_never_overwritten(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "thesis"
    mine.mkdir()
    (mine / "chapter.tex").write_text("x")
    assert main(["simulate", str(config), "-o", str(mine), "--overwrite"]) == 2
    error = capsys.readouterr().err
    assert "no dataset that polhode simulate made" in error and error.count("\n") == 1
    assert (mine / "chapter.tex").read_text() == "x"
