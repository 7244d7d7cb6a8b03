"""Surfaces are composed by depth and opacity; lines dim behind them."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polhode.lie import Array
from polhode.simulation.figures.motion_drawing import Drawing

UP = np.array([0.0, 0.0, 1.0])
FROM_Y = np.array([0.0, -1.0, 0.0])


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


def test_lines_alone_are_drawn_too() -> None:
    drawing = Drawing(FROM_Y, UP)
    drawing.line(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]), "#000000", 1.0)
    axes = _painted(drawing)
    assert len(axes.lines) == 1
    assert len(axes.images) == 0
