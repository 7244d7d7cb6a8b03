"""The picture of a motion names its sense and its numbers, and comes from the command line.

Surfaces are composed by depth and opacity; lines dim behind them.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError
from polhode.simulation.figures.motion_plot import Drawing, headline, main, motion_figure, numbers, save
from polhode.simulation.motion.poinsot import poinsot

MOMENTS = np.array([1.4e-2, 1.1e-2, 0.8e-2])


UP = np.array([0.0, 0.0, 1.0])
FROM_Y = np.array([0.0, -1.0, 0.0])


def _scene(spin_rpm: list[float], **motion: object) -> Scene:
    mass = {"inertia_kg_m2": np.diag(MOMENTS).tolist(), "mass_kg": 4.0, "com_m": [0, 0, 0]}
    return Scene.model_validate(
        {
            "frames": 10,
            "truth_horizon_s": 0.0,
            "mass": mass,
            "motion": {"spin_rpm": spin_rpm, "spin_axes": "principal", **motion},
        }
    )


@pytest.mark.parametrize(
    ("w_P", "words"),
    [
        ([1.0, 0.2, 0.1], "retrograde precession about the axis of greatest inertia"),
        ([0.1, 0.2, 1.0], "prograde precession about the axis of least inertia"),
        ([0.0, 1.0, 0.0], "no precession"),
    ],
)
def test_the_headline_states_the_sense(w_P: list[float], words: str) -> None:
    assert headline(poinsot(MOMENTS, np.array(w_P)), "name") == f"name: {words}"


def test_the_numbers_of_a_disc_are_the_textbooks() -> None:
    """h = (0.6, 0, 0.8): tilt 36.9 deg; precession 2 pi J_t / h; spin 2 pi / (w_a (J_a / J_t - 1))."""
    text = numbers(poinsot(np.array([1.6, 1.0, 1.0]), np.array([0.5, 0.6, 0.0])))
    for part in ("rate 7.46 RPM", "wobble 36.9°", "precession period 6.3 s", "moments 1.600 : 1.000 : 1.000"):
        assert part in text
    assert f"spin period (polhode) {2 * np.pi / 0.3:.1f} s" in text


def test_cones_and_rate_are_drawn_in_their_colours(tmp_path: Path) -> None:
    figure = motion_figure(_scene([6.0, 1.8, 1.2]), 0, "major", pixels=60)
    save(figure, tmp_path / "major.png")
    image = Image.open(tmp_path / "major.png")
    colors = np.asarray(image.convert("HSV"))
    for hue_deg in (216, 33, 349):  # body cone, space cone, rate
        near = abs(colors[..., 0] * 360.0 / 255.0 - hue_deg) < 12
        assert np.count_nonzero(near & (colors[..., 1] > 90)) > 500


def test_a_target_at_rest_is_refused() -> None:
    with pytest.raises(InputError, match="spin_rpm is zero"):
        motion_figure(_scene([0.0, 0.0, 0.0]), 0, "still")


def test_a_config_without_a_scene_gives_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "empty.yaml"
    config.write_text("seed: 1\n")
    monkeypatch.setattr(sys, "argv", ["motion_plot", str(config), "-o", str(tmp_path / "x.png")])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    error = capsys.readouterr().err
    assert "has no scene: give a configuration for polhode simulate" in error
    assert len(error.splitlines()) == 1


def _wall(y: float, width: float) -> Array:
    """A square across the view, (2, 2, 3)."""
    x, z = np.meshgrid([-width, width], [-width, width], indexing="ij")
    return np.stack([x, np.full_like(x, y), z], axis=-1)


def _painted(drawing: Drawing, pixels: int = 40) -> Axes:
    axes = Figure().add_subplot()
    drawing.paint(axes, pixels)
    return axes


def _middle(axes: Axes) -> Array:
    picture = np.asarray(axes.images[0].get_array(), dtype=np.float64)
    return np.asarray(picture[picture.shape[0] // 2, picture.shape[1] // 2])


def test_the_viewer_sees_x_to_the_right_and_z_up() -> None:
    seen = Drawing(FROM_Y, UP).seen(np.eye(3))
    np.testing.assert_allclose(seen, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)


def test_an_opaque_surface_hides_what_is_behind_it_whatever_the_order() -> None:
    for order in (1, -1):
        drawing = Drawing(FROM_Y, UP)
        for y, color in [(0.0, "#ff0000"), (1.0, "#0000ff")][::order]:
            drawing.surface(_wall(y, 1.0), color, 1.0)
        red, _, blue, opacity = _middle(_painted(drawing))
        assert red > 3 * blue
        assert opacity == 1.0


def test_translucent_surfaces_mix() -> None:
    drawing = Drawing(FROM_Y, UP)
    drawing.surface(_wall(0.0, 1.0), "#ff0000", 0.5)
    assert _middle(_painted(drawing))[3] == 0.5
    drawing.surface(_wall(1.0, 1.0), "#ff0000", 0.5)
    assert _middle(_painted(drawing))[3] == 0.75


def test_a_line_dims_where_a_surface_is_before_it() -> None:
    drawing = Drawing(FROM_Y, UP)
    drawing.surface(_wall(0.0, 1.0), "#808080", 1.0)
    drawing.line(np.linspace([-3.0, 1.0, 0.0], [3.0, 1.0, 0.0], 61), "#000000", 1.0, hidden=0.2)
    drawing.line(np.linspace([-3.0, -1.0, 0.5], [3.0, -1.0, 0.5], 61), "#000000", 1.0, hidden=0.2)
    behind, before = _painted(drawing).lines[:3], _painted(drawing).lines[3:]
    assert [_opacity(line.get_color()) for line in behind] == [1.0, 0.2, 1.0]
    np.testing.assert_allclose(np.asarray(behind[1].get_xdata())[[0, -1]], [-1.0, 1.0], atol=0.11)
    assert [_opacity(line.get_color()) for line in before] == [1.0]


def _opacity(color: object) -> float:
    assert isinstance(color, tuple)
    return float(color[3])
