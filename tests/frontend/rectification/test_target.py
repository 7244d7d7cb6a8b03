"""Finding the target against the sky."""

import cv2
import numpy as np

from polhode.frontend.rectification.target import Crop, Image, target_crop, target_mask


def scene(seed: int = 0) -> Image:
    """Read noise, a few stars, one bright disk at (200, 150) of 60 px radius, half of it in shadow."""
    rng = np.random.default_rng(seed)
    image = rng.normal(2.0, 1.5, (300, 400))
    for u, v in rng.integers(5, 295, (12, 2)):
        if np.hypot(u - 200, v - 150) > 80:
            image[v, u] = 220.0
    v, u = np.mgrid[0:300, 0:400]
    disk = np.hypot(u - 200, v - 150) < 60
    image[disk & (u < 205)] += 120.0
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def test_the_mask_holds_the_lit_target_and_no_star() -> None:
    mask = target_mask(scene())
    v, u = np.mgrid[0:300, 0:400]
    lit = (np.hypot(u - 200, v - 150) < 57) & (u < 203)
    far = np.hypot(u - 200, v - 150) > 66
    assert mask[lit].mean() > 0.99
    assert not mask[far].any()


def test_two_parts_of_one_craft_are_kept() -> None:
    image = np.zeros((300, 400), dtype=np.uint8)
    cv2.rectangle(image, (50, 100), (150, 200), 90, -1)
    cv2.rectangle(image, (180, 120), (230, 180), 90, -1)
    mask = target_mask(image)
    assert mask[150, 100]
    assert mask[150, 205]


def test_a_given_mask_is_taken_as_it_is() -> None:
    given = np.zeros((300, 400), dtype=bool)
    given[10:20, 30:50] = True
    assert target_mask(scene(), given) is given
    assert target_crop(given, margin_px=5) == Crop(25, 5, 55, 25)


def test_black_sky_has_no_target() -> None:
    noise = np.clip(np.random.default_rng(0).normal(1.0, 0.8, (300, 400)), 0, 255).astype(np.uint8)
    assert target_crop(target_mask(noise)) is None
    assert target_crop(target_mask(np.zeros((300, 400), dtype=np.uint8))) is None
