"""The animation: what its panels show, and that a run without a surface is refused."""

import numpy as np
import pytest

from benchmarks.end_to_end.animation import TIP_RGB, PolhodePanel, camera_panel
from benchmarks.end_to_end.readme_picture import FINE, PAPER
from polhode.frontend.rectification import Crop

SIDE = FINE * 290
MOMENTS = np.array([1.2, 1.0, 0.8])
W_P = np.array([[0.9, 0.3, 0.1], [0.9, 0.0, 0.3], [0.9, -0.3, 0.1], [0.9, 0.0, -0.3]])


def test_the_tip_is_where_the_angular_velocity_is() -> None:
    panel = PolhodePanel(W_P, MOMENTS, SIDE)
    for k in range(len(W_P)):
        picture = panel.at(k)
        column, row = panel.places[k]
        assert tuple(picture[row, column]) == TIP_RGB
        assert picture.shape == (SIDE, SIDE, 3)
    assert len({tuple(place) for place in panel.places.tolist()}) == len(W_P)


def test_the_path_is_brighter_as_far_as_it_has_come() -> None:
    panel = PolhodePanel(W_P, MOMENTS, SIDE)
    column, row = np.mean(panel.places[:2], axis=0).round().astype(int)
    before, after = (panel.at(k)[row - 3 : row + 4, column - 3 : column + 4].max() for k in (0, 2))
    assert after > before


def test_what_lies_beyond_the_image_has_the_colour_of_the_ground() -> None:
    picture = camera_panel(np.full((40, 60), 200, dtype=np.uint8), Crop(-20, -20, 60, 60))
    assert tuple(picture[0, 0]) == PAPER
    assert picture[SIDE // 2, SIDE // 2] == pytest.approx([200, 200, 200], abs=1)
