"""The picture of a motion names its sense and its numbers, and comes from the command line."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.config.scene_settings import Scene
from polhode.runtime.errors import InputError
from polhode.simulation.figures.motion_plot import headline, main, motion_figure, numbers
from polhode.simulation.motion.poinsot import precession_of

MOMENTS = np.array([1.4e-2, 1.1e-2, 0.8e-2])


@pytest.mark.parametrize(
    ("w_P", "words"),
    [
        ([1.0, 0.2, 0.1], "retrograde precession about the axis of greatest inertia"),
        ([0.1, 0.2, 1.0], "prograde precession about the axis of least inertia"),
        ([0.0, 1.0, 0.0], "no precession"),
    ],
)
def test_the_headline_states_the_sense(w_P: list[float], words: str) -> None:
    assert headline(precession_of(MOMENTS, np.array(w_P)), "name") == f"name: {words}"


def test_the_numbers_of_a_disc_are_the_textbooks() -> None:
    """h = (0.6, 0, 0.8): tilt 36.9 deg; precession 2 pi J_t / h; spin 2 pi / (w_a (J_a / J_t - 1))."""
    moments, w_P = np.array([1.6, 1.0, 1.0]), np.array([0.5, 0.6, 0.0])
    text = numbers(precession_of(moments, w_P), moments, w_P[None])
    for part in ("rate 7.46 to 7.46 RPM", "wobble 36.9 to 36.9°", "precession period 6.3 s", "1.600 : 1.000"):
        assert part in text
    assert f"spin period (polhode) {2 * np.pi / 0.3:.1f} s" in text


def test_the_command_draws_cones_and_refuses_rest_and_configs_without_a_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config, picture = tmp_path / "major.yaml", tmp_path / "major.png"
    motion = "motion: {spin_rpm: [6.0, 1.8, 1.2], spin_axes: principal, torque_psd: 1.0e-6}"
    config.write_text(
        f"seed: 1\nscene:\n  frames: 10\n  truth_horizon_s: 0\n  {motion}\n"
        "  mass: {inertia_kg_m2: [[0.014, 0, 0], [0, 0.011, 0], [0, 0, 0.008]], com_m: [0, 0, 0]}\n"
    )
    monkeypatch.setattr(sys, "argv", ["motion_plot", str(config), "-o", str(picture)])
    main()
    colors = np.asarray(Image.open(picture).convert("RGB").convert("HSV"))
    for hue_deg in (216, 33, 349):  # body cone, space cone, rate
        near = abs(colors[..., 0] * 360.0 / 255.0 - hue_deg) < 12
        assert np.count_nonzero(near & (colors[..., 1] > 60)) > 500
    with pytest.raises(InputError, match="spin_rpm is zero"):
        motion_figure(Scene(), 0, "still")
    config.write_text("seed: 1\n")
    with pytest.raises(SystemExit) as caught:
        main()
    error = capsys.readouterr().err
    assert caught.value.code == 2 and len(error.splitlines()) == 1
    assert "has no scene: give a configuration for polhode simulate" in error
