"""A plain background that stays the same while a target moves before a camera at rest."""

import numpy as np
import pytest

from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.background.still_background import is_still, still_background
from polhode.frontend.rectification import Image, Rectifier
from polhode.geometry.lie import Bools
from polhode.records.dataset import StereoImages, StereoSequence
from tests.frontend.background.synthetic_pairs import (
    HEIGHT,
    RIG,
    WIDTH,
    U,
    V,
    drawn,
    overlap,
    read_at,
    texture,
)

RECTIFIER = Rectifier(RIG, np.eye(4), None, ((WIDTH, HEIGHT),) * 2)
FRAMES = 12
NEAR = texture(2, 110.0, 30.0)


def image(k: int, side: int, plain: bool = True, exposure: float = 1.0) -> tuple[Image, Bools]:
    """A textured disk before a plain grey that falls off to one side, and the disk's mask."""
    at = U - (160.0 + 60.0 * np.cos(2.0 * np.pi * k / FRAMES)) + side * 40.0
    disk = np.hypot(at, V - 115.0) < 45.0
    far = 90.0 + 0.1 * U if plain else read_at(texture(7 + k + 50 * side, 110.0, 30.0), U)
    noise = np.random.default_rng([k, side]).normal(0.0, 1.0, U.shape)
    level = exposure * np.where(disk, read_at(NEAR, at + 170.0), far) + noise
    return np.clip(np.round(level), 0, 255).astype(np.uint8), disk


def turntable(plain: bool = True, moving: bool = False) -> StereoSequence:
    """The lamp flickers."""
    X_NC = np.tile(np.eye(4), (FRAMES, 1, 1))
    X_NC[:, 0, 3] = 0.01 * moving * np.arange(FRAMES)

    def pair(k: int) -> StereoImages:
        left, right = (image(k, side, plain, 1.0 + 0.05 * (k % 3))[0] for side in (0, 1))
        return StereoImages(left, right, None, None)

    return drawn(pair, X_NC)


def test_a_plain_background_is_what_stays_the_same_and_the_target_what_differs() -> None:
    background = find_background(turntable(), RECTIFIER)
    assert background is not None and background.description == "the same in all images"
    found = find_masks(turntable(), RECTIFIER, background, range(FRAMES), 1, lambda: None)
    assert found is not None and doubtful_frames(found) == []
    for k in range(FRAMES):
        masks = found.masks(k)
        assert masks is not None
        assert min(overlap(mask, image(k, side)[1]) for side, mask in enumerate(masks)) > 0.93


@pytest.mark.parametrize("changes", [{"moving": True}, {"plain": False}], ids=str)
def test_a_camera_that_moves_or_a_view_that_changes_all_over_has_no_such_background(
    changes: dict[str, bool],
) -> None:
    assert find_background(turntable(**changes), RECTIFIER) is None


def test_the_background_is_known_where_a_quarter_of_the_images_show_it() -> None:
    images = [image(k, 0)[0] for k in range(FRAMES)]
    whole = np.ones((HEIGHT, WIDTH), dtype=bool)
    still = still_background(images, whole)
    seen = np.mean([image(k, 0)[1] for k in range(FRAMES)], axis=0) <= 0.5
    assert still.known[seen].mean() > 0.99
    assert np.abs(still.image - (90.0 + 0.1 * U))[seen & still.known].max() < 6.0
    assert is_still(images, still, whole)
    assert not still_background(images[:5], whole).known.any()
