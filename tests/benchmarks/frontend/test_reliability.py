"""Values of candidates are compared among those that the other frame shows."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.frontend.reliability import (
    AFTER,
    Descriptor,
    areas_of_pair,
    configured,
    value_names,
    values_after,
    values_before,
)
from benchmarks.frontend.scenes import scene_of
from polhode.frontend.features.surface_features import SurfaceFeatureMethod, with_patch_size

SAMPLE = Path(__file__).parents[3] / "sample"


def test_only_candidates_that_are_shown_are_compared() -> None:
    value = np.arange(20.0)[:, None]
    right = value[:, 0] >= 10
    shown = np.ones(20, dtype=bool)
    assert areas_of_pair(value, shown, right) == [1.0]
    assert areas_of_pair(-value, shown, right) == [0.0]
    # wrong ones of high value count no longer when they are not shown
    wrong = np.concatenate([value, value + 100.0])
    both = np.concatenate([shown, ~shown])
    assert areas_of_pair(wrong, both, np.concatenate([right, ~shown])) == [1.0]
    assert np.isnan(areas_of_pair(value, value[:, 0] < 12, right)).all()


def test_points_of_a_frame_are_shown_in_it_and_in_fewer_others() -> None:
    scene = scene_of(SAMPLE / "scene.yaml", SAMPLE)
    bright = np.argwhere(scene.pair(0).left > 60)[::40, ::-1].astype(np.float64)
    disparity = np.full(len(bright), 40.0)
    p_G, _ = scene.body_points(0, np.column_stack([bright, disparity]))
    own, later = scene.shown_in_light(p_G, 0), scene.shown_in_light(p_G, len(scene) // 2)
    assert own.mean() > 0.9 > later.mean()
    assert not scene.shown_in_light(np.full((3, 3), np.nan), 0).any()


@pytest.mark.parametrize("descriptor", ["network", "surface"])
def test_a_match_knows_more_than_a_candidate(descriptor: Descriptor) -> None:
    """Of two frames of the sample: the values are in the order of their names."""
    scene = scene_of(SAMPLE / "scene.yaml", SAMPLE)
    config = with_patch_size(configured(descriptor), scene.sequence, scene.rectifier)
    method = SurfaceFeatureMethod(config)
    pairs = [scene.pair(k) for k in (24, 35)]
    a, b = (method(pair, scene.rig) for pair in pairs)
    before = values_before(pairs[0], a, scene, config)
    best, after = values_after(a, b)
    p_G = [scene.body_points(k, frame.uvd_px)[0] for k, frame in ((24, a), (35, b))]
    right = np.linalg.norm(p_G[0] - p_G[1][best], axis=1) < 5e-3
    areas = areas_of_pair(np.column_stack([before, after]), scene.shown_in_light(p_G[0], 35), right)
    assert len(areas) == len(value_names(config))
    after_from = len(areas) - len(AFTER)
    assert min(areas[after_from:]) > 0.75 > max(areas[:after_from])
