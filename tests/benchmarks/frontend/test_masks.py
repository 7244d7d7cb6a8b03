"""Rendered pairs before Earth and wall: the masks that are found are the target's."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.frontend.masks import SCENES, intersection_over_union, measure, rendered


@pytest.mark.parametrize("config", SCENES[:2], ids=lambda path: path.stem)
def test_masks_before_earth_and_wall_are_the_targets(config: Path) -> None:
    errors = measure(rendered(config, 2, quick=True))
    assert errors.background.startswith("at infinity" if config.stem == "earth_behind" else "in a plane 2.")
    assert errors.overlap.mean() > 0.95
    assert errors.doubtful == 0
    assert errors.by_brightness < 0.5


def test_overlap() -> None:
    a, b = np.zeros((4, 4), dtype=bool), np.zeros((4, 4), dtype=bool)
    assert intersection_over_union(a, b) == 1.0
    a[:2], b[1:3] = True, True
    assert intersection_over_union(a, b) == pytest.approx(1.0 / 3.0)
