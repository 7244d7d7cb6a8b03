"""The thesis's figures 4-6 and 4-8, and what the scaling does to them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.solvers.conditioning import (
    draw,
    rotation_conditions,
    scaled_translation_conditions,
    translation_conditions,
)

STEPS_S = np.logspace(-3, 1, 41)


@pytest.mark.parametrize("alpha", [0.1, 1.0, 10.0])
def test_a_fixed_unit_is_best_at_one_step_and_bad_away_from_it(alpha: float) -> None:
    steps = np.logspace(-3, 3, 6001) / alpha
    conditions = translation_conditions(steps, alpha)
    assert steps[np.argmin(conditions)] == pytest.approx(np.sqrt(3.0) / alpha, rel=2e-3)
    assert conditions[0] > 1e5 * conditions.min() and conditions[-1] > 1e4 * conditions.min()


def test_units_that_follow_the_step_are_as_good_for_every_step() -> None:
    conditions = scaled_translation_conditions(STEPS_S)
    # of [1/3, 1/2; 1/2, 1]
    np.testing.assert_allclose(conditions, (4.0 + np.sqrt(13.0)) / (4.0 - np.sqrt(13.0)), rtol=1e-9)


def test_scaled_rotation_is_conditioned_by_the_motion_alone() -> None:
    plain, still = rotation_conditions(STEPS_S, 0.0)
    assert plain.max() > 1e7
    np.testing.assert_allclose(still, still[0], rtol=1e-6)
    assert still[0] < 100.0
    # at 20 RPM for 10 s a flip stretches errors e-fold several times: that is the body, not the units
    plain, fast = rotation_conditions(STEPS_S, 20.0)
    assert fast[STEPS_S <= 1.0].max() < 100.0 and fast.max() < 1e5


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    draw(tmp_path / "conditioning.png")
    with Image.open(tmp_path / "conditioning.png") as picture:
        assert picture.width > 1000 and len(picture.getcolors(1 << 24) or []) > 10
