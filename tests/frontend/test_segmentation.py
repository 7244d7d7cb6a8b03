"""The target's mask in an image: before a dark sky, with dim surroundings and without."""

import cv2
import numpy as np

from polhode.frontend.rectification import Crop, Image, target_crop
from polhode.frontend.segmentation import border_of, has_surroundings, target_mask

BORDER = border_of(np.ones((300, 400), dtype=bool))
V, U = np.mgrid[0:300, 0:400]
TARGET = np.hypot(U - 200, V - 130) < 70


def laboratory(seed: int, floor: float = 22.0, u: float = 200.0) -> Image:
    """A bright disk on a dim cloth that fills the lower part of the image, behind it the dark."""
    rng = np.random.default_rng(seed)
    image = rng.normal(2.0, 1.0, (300, 400))
    image[170:] += floor * rng.uniform(0.6, 1.4, (130, 400))
    target = np.hypot(U - u, V - 130) < 70
    image[target] = 120.0 * rng.uniform(0.6, 1.4, int(target.sum()))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def test_the_mask_holds_the_lit_target_and_no_star() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(2.0, 1.5, (300, 400))
    away = np.hypot(U - 200, V - 150)
    for u, v in rng.integers(5, 295, (12, 2)):
        if away[v, u] > 80:
            image[v, u] = 220.0
    # half of the disk is in shadow
    image[(away < 60) & (U < 205)] += 120.0
    scene = np.clip(np.round(image), 0, 255).astype(np.uint8)
    mask = target_mask(scene)
    assert mask[(away < 57) & (U < 203)].mean() > 0.99 and not mask[away > 66].any()
    given = np.zeros((300, 400), dtype=bool)
    given[10:20, 30:50] = True
    assert target_mask(scene, given) is given
    assert target_crop(given, margin_px=5) == Crop(25, 5, 55, 25)


def test_dim_surroundings_that_reach_the_border_are_left_out() -> None:
    whole, alone = target_mask(laboratory(0)), target_mask(laboratory(0), border=BORDER)
    assert whole[250, 20] and whole[TARGET].mean() > 0.99
    assert not alone[250, 20] and (alone & TARGET).sum() / (alone | TARGET).sum() > 0.95


def test_the_mask_of_a_blurred_target_ends_at_its_edge_and_keeps_thin_parts() -> None:
    """What blur carries outwards is brighter than the surroundings, but is none of the target."""
    image = laboratory(0, floor=10.0).astype(np.float32)
    image[40:47, 270:360] = 120.0
    alone = target_mask(cv2.GaussianBlur(image, (0, 0), 2.5).astype(np.uint8), border=BORDER)
    outside, inside = (cv2.distanceTransform(m.astype(np.uint8), cv2.DIST_L2, 5) for m in (~TARGET, TARGET))
    on_cloth = (V > 175) & (np.abs(U - 200) < 60)
    assert not (alone & on_cloth & (outside > 1.2)).any()
    assert alone[TARGET & (inside > 3)].all() and alone[43, 280:350].all()


def test_surroundings_show_in_every_image_or_are_none() -> None:
    seen = [laboratory(seed) for seed in range(4)]
    assert has_surroundings(seen, BORDER)
    assert not has_surroundings([*seen, laboratory(4, floor=0.0)], BORDER)
    assert not has_surroundings([], BORDER)
    # what is half as bright belongs to the target
    bright = laboratory(0, floor=60.0)
    assert not has_surroundings([bright], BORDER) and target_mask(bright, border=BORDER)[250, 20]
    # a target that reaches the border itself is whole
    beside = laboratory(0, floor=0.0, u=20.0)
    assert not has_surroundings([beside], BORDER)
    np.testing.assert_array_equal(target_mask(beside, border=BORDER), target_mask(beside))


def test_a_black_image_has_neither_target_nor_surroundings() -> None:
    noise = np.clip(np.random.default_rng(0).normal(1.0, 0.8, (300, 400)), 0, 255).astype(np.uint8)
    black = np.zeros((300, 400), dtype=np.uint8)
    for image in (noise, black):
        assert target_crop(target_mask(image)) is None
    assert not has_surroundings([black], BORDER) and not target_mask(black, border=BORDER).any()


def test_the_border_is_that_of_what_the_camera_sees() -> None:
    seen = np.zeros((60, 80), dtype=bool)
    seen[10:50, 20:70] = True
    border = border_of(seen)
    assert border[10:50, 20:23].all() and border[47:50, 20:70].all()
    assert not border[13:47, 23:67].any() and not border[~seen].any()
