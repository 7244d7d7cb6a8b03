"""The command that writes correspondences and their picture."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.runtime.errors import InputError
from polhode.simulation.figures.correspondence_picture import main

CONFIG = """
seed: 4
scene:
  frames: 3
  rig: {width_px: 96, height_px: 72, focal_px: 100.0}
  motion: {position_m: [0.04, 0.0, 0.5], spin_rpm: [0, 6, 0]}
  light: {earth: 0}
  render: {bounces: 0}
"""


def test_the_command_writes_points_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, file, picture = tmp_path / "scene.yaml", tmp_path / "points.npz", tmp_path / "points.png"
    path.write_text(CONFIG)
    words = ["--frames", "0", "1", "--cameras", "0", "1", "-o", str(file), "--picture", str(picture)]
    main([str(path), *words])
    assert "visible in both" in capsys.readouterr().out
    with np.load(file) as found:
        assert found["uv_a_px"].shape == found["uv_b_px"].shape == (len(found["visible"]), 2)
        assert 0 < found["visible"].sum() < len(found["visible"])
        assert np.isfinite(found["p_G"]).all()
    coloured = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    assert (np.ptp(coloured, axis=-1) > 60).sum() > 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--frames", "0", "9"], "no frame 9"),
        (["--frames", "-1", "1"], "no frame -1"),
        (["--frames", "0", "1", "--cameras", "0", "2"], "no camera 2"),
        (["--frames", "0", "1", "--picture", "nowhere/p.png"], "nowhere is not a folder"),
    ],
)
def test_a_wrong_request_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(CONFIG)
    with pytest.raises(SystemExit) as caught:
        main([str(path), *words, "-o", str(tmp_path / "points.npz")])
    assert caught.value.code == InputError.exit_code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
