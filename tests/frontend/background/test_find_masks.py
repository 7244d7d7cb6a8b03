"""Masks of whole sequences: when they are looked for, where the background is, and when they are doubtful."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.frontend.background.far_plane import FarPlane, plane_seen_from
from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.found_masks import FoundMasks, MaskQuality, encoded
from polhode.frontend.rectification import Rectifier, make_rectifier, rectified_left, rectified_pair
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.records.dataset import StereoImages, StereoSequence, open_sequence
from tests.frontend.background.synthetic_pairs import (
    HEIGHT,
    INFINITY,
    RIG,
    WIDTH,
    drawn,
    overlap,
    pair_of,
    texture,
)

SAMPLE = Path(__file__).parents[3] / "examples" / "sample"
SIZE = (WIDTH, HEIGHT)
RECTIFIER = Rectifier(replace(RIG, disparity_offset_px=0.0), np.eye(4), None, (SIZE, SIZE))
FAR, NEAR = texture(1, 110.0, 30.0), texture(2, 110.0, 30.0)
CLOUDS = np.full_like(FAR, 34.0)
CLOUDS[20:60] = texture(3, 60.0, 10.0)[20:60]
GOOD = MaskQuality(area=0.1, agreement=0.98, contradicted=0.02, far_share=0.95)


def before(
    planes: list[FarPlane],
    X_NC: Array | None = None,
    far: Array = FAR,
    radius_px: float = 50.0,
    masked: bool = False,
) -> StereoSequence:
    """A disk before planes, by default of cameras at rest."""

    def pair(k: int) -> StereoImages:
        left, right, mask, mask_right = pair_of(planes[k], far, NEAR, radius_px=radius_px)
        return StereoImages(left, right, *((mask, mask_right) if masked else (None, None)))

    return drawn(pair, np.tile(np.eye(4), (len(planes), 1, 1)) if X_NC is None else X_NC)


@pytest.mark.parametrize("moving", [False, True], ids=["at_rest", "moving"])
def test_a_wall_is_found_where_it_is_in_N_and_the_target_before_it(moving: bool) -> None:
    wall_N = np.array([0.02, -0.03, 0.4])
    X_NC = np.array(
        [
            make_pose(exp_so3([0.0, 0.03 * moving * k, 0.0]), [0.1 * moving * k, 0.0, 0.05 * moving * k])
            for k in range(4)
        ]
    )
    planes = [plane_seen_from(wall_N, RECTIFIER.rig, each) for each in X_NC]
    sequence = before(planes, X_NC)
    background = find_background(sequence, RECTIFIER)
    assert background is not None and not background.at_infinity
    seen = plane_seen_from(background.m_N, RECTIFIER.rig, X_NC[2])
    np.testing.assert_allclose(seen.corners(*SIZE), planes[2].corners(*SIZE), atol=1.0)
    assert background.description.startswith("in a plane 2.")
    ticks: list[int] = []
    found = find_masks(sequence, RECTIFIER, background, range(3), 1, lambda: ticks.append(1))
    assert found is not None and len(ticks) == 3 and found.masks(3) is None
    masks = found.masks(2)
    assert masks is not None
    _, _, mask, mask_right = pair_of(planes[2], FAR, NEAR)
    assert min(overlap(masks[0], mask), overlap(masks[1], mask_right)) > 0.95
    assert doubtful_frames(found) == []


@pytest.mark.parametrize(
    ("far", "radius_px"), [(FAR, 150.0), (CLOUDS, 50.0)], ids=["mostly hidden", "plain but for clouds"]
)
def test_the_earth_is_found_where_little_of_it_is_seen(far: Array, radius_px: float) -> None:
    """A target across the border, at another distance in each pair; a ground as dark as the darkest tenth."""

    def pair(k: int) -> StereoImages:
        images = pair_of(INFINITY, far, NEAR, disparity_px=30.0 + 8.0 * k, radius_px=radius_px)
        return StereoImages(*images[:2], None, None)

    background = find_background(drawn(pair, np.tile(np.eye(4), (4, 1, 1))), RECTIFIER)
    assert background is not None and background.at_infinity


def test_the_earth_is_found_at_infinity_and_nothing_before_a_dark_sky_or_a_turning_plane() -> None:
    background = find_background(before([INFINITY] * 3), RECTIFIER)
    assert background is not None and background.at_infinity and background.description == "at infinity"
    for sequence in (
        before([FarPlane(0.02 * k, -0.01 * k, 20.0 - 5.0 * k) for k in range(4)]),
        before([INFINITY] * 3, far=np.full_like(FAR, 2.0)),
        before([INFINITY] * 3, masked=True),
    ):
        assert find_background(sequence, RECTIFIER) is None
    alone = before([INFINITY] * 3, radius_px=0.0)
    assert find_masks(alone, RECTIFIER, background, range(3), 1, lambda: None) is None


def test_the_sample_is_before_a_dark_sky_and_keeps_its_masks() -> None:
    sequence = open_sequence(SAMPLE)
    rectifier = make_rectifier(sequence.calibration)
    assert find_background(sequence, rectifier) is None
    pair, raw = rectified_pair(sequence, rectifier, 30), sequence.read_pair(30)
    np.testing.assert_array_equal(pair.left, rectifier(raw.left, 0))
    np.testing.assert_array_equal(pair.mask_left, target_mask(rectifier(raw.left, 0)))
    np.testing.assert_array_equal(pair.mask_right, target_mask(rectifier(raw.right, 1)))


def test_found_masks_black_the_background_out_and_given_ones_come_first() -> None:
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[60:150, 100:200] = True
    rectifier = replace(RECTIFIER, found=FoundMasks({0: (encoded(mask), encoded(~mask))}, {0: GOOD}))
    sequence = before([INFINITY] * 2)
    pair, raw = rectified_pair(sequence, rectifier, 0), sequence.read_pair(0)
    np.testing.assert_array_equal(pair.mask_left, mask)
    np.testing.assert_array_equal(pair.left, np.where(mask, raw.left, 0))
    np.testing.assert_array_equal(pair.right, np.where(~mask, raw.right, 0))
    image, found_left = rectified_left(sequence, rectifier, 0)
    np.testing.assert_array_equal(image, pair.left)
    np.testing.assert_array_equal(found_left, mask)
    # without a found mask, as before
    np.testing.assert_array_equal(rectified_pair(sequence, rectifier, 1).left, raw.left)
    given = rectified_pair(before([INFINITY] * 2, masked=True), rectifier, 0)
    np.testing.assert_array_equal(given.left, raw.left)
    assert overlap(given.mask_left, mask) < 0.9


@pytest.mark.parametrize(
    "changes",
    [
        {"area": 0.3},
        {"area": 0.0, "agreement": np.nan, "contradicted": np.nan},
        {"agreement": 0.5},
        {"contradicted": 0.6},
        {"contradicted": np.nan},
        {"far_share": 0.2},
    ],
    ids=str,
)
def test_a_pair_that_stands_out_is_doubtful(changes: dict[str, float]) -> None:
    def doubtful(*quality: MaskQuality) -> list[int]:
        return doubtful_frames(FoundMasks({}, dict(enumerate(quality))))

    assert doubtful(*[GOOD] * 6) == []
    assert doubtful(GOOD, GOOD, GOOD, replace(GOOD, **changes), GOOD, GOOD) == [3]
    # a target that is out of view is not doubtful
    away = replace(GOOD, area=0.0, agreement=np.nan, contradicted=np.nan)
    assert doubtful(*[GOOD] * 5, *[away] * 5) in ([], [4], [5], [4, 5])
