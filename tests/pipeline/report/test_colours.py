"""Colours that stand beside each other differ for every reader, and from the ground below them."""

from itertools import combinations

import numpy as np
import pytest
from skimage.color import rgb2lab

from polhode.pipeline.report.comparison import RUN_COLORS
from polhode.pipeline.report.plot_style import AXIS_COLORS, DARK, INK, PAPER

SEEN_BY = {
    "everyone": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}  # fmt: skip
"""Linear RGB as dichromats see it: Machado, Oliveira, Fernandes 2009, severity 1."""
MIN_DISTANCE = 14.0
"""In CIE Lab; a just noticeable difference is 2.3."""
MIN_CONTRAST = 3.0
"""Of a curve with the ground: WCAG 2.1, success criterion 1.4.11."""


def linear(color: str) -> np.ndarray:
    value = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def distance(a: str, b: str, seen_by: str) -> float:
    seen = (np.array([linear(a), linear(b)]) @ np.array(SEEN_BY[seen_by]).T).clip(0.0, 1.0)
    encoded = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    lab = rgb2lab(encoded[None])[0]
    return float(np.linalg.norm(lab[0] - lab[1]))


def contrast(a: str, b: str) -> float:
    dark, light = sorted(float(linear(each) @ [0.2126, 0.7152, 0.0722]) for each in (a, b))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("seen_by", SEEN_BY)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axes_differ_for_colour_blind_readers_too(scheme: str, seen_by: str) -> None:
    colors = [*AXIS_COLORS, INK]
    if scheme == "dark":
        colors = [DARK[each] for each in colors]
    for a, b in combinations(colors, 2):
        assert distance(a, b, seen_by) > MIN_DISTANCE, (a, b)


@pytest.mark.parametrize("palette", [AXIS_COLORS, RUN_COLORS[:4], (INK,)])
def test_curves_stand_out_from_the_ground(palette: tuple[str, ...]) -> None:
    for color in palette:
        assert contrast(color, PAPER) >= MIN_CONTRAST, color
        assert contrast(DARK[color], DARK[PAPER]) >= MIN_CONTRAST, color
