"""The target's mask in an image, with dim surroundings and without."""

import cv2
import numpy as np

from polhode.frontend.rectification import Image
from polhode.frontend.segmentation import border_of, has_surroundings, target_mask
from polhode.geometry.lie import Bools

BORDER = border_of(np.ones((300, 400), dtype=bool))


def shape_of_target(u: float = 200.0) -> Bools:
    rows, columns = np.mgrid[0:300, 0:400]
    return np.asarray(np.hypot(columns - u, rows - 130) < 70)


def laboratory(seed: int, floor: float = 22.0, u: float = 200.0) -> Image:
    """A bright disk on a dim cloth that fills the lower part of the image, behind it the dark."""
    rng = np.random.default_rng(seed)
    image = rng.normal(2.0, 1.0, (300, 400))
    image[170:] += floor * rng.uniform(0.6, 1.4, (130, 400))
    target = shape_of_target(u)
    image[target] = 120.0 * rng.uniform(0.6, 1.4, int(target.sum()))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def test_dim_surroundings_that_reach_the_border_are_left_out() -> None:
    image = laboratory(0)
    whole, alone = target_mask(image), target_mask(image, border=BORDER)
    target = shape_of_target()
    assert whole[250, 20] and whole[target].mean() > 0.99
    assert not alone[250, 20]
    assert (alone & target).sum() / (alone | target).sum() > 0.95


def test_the_mask_of_a_blurred_target_ends_at_its_edge_and_keeps_thin_parts() -> None:
    """What blur carries outwards is brighter than the surroundings, but is none of the target."""
    image = laboratory(0, floor=10.0).astype(np.float32)
    image[40:47, 270:360] = 120.0
    alone = target_mask(cv2.GaussianBlur(image, (0, 0), 2.5).astype(np.uint8), border=BORDER)
    target = shape_of_target()
    outline = cv2.distanceTransform((~target).astype(np.uint8), cv2.DIST_L2, 5)
    rows, columns = np.mgrid[0:300, 0:400]
    on_cloth = (rows > 175) & (np.abs(columns - 200) < 60)
    assert not (alone & on_cloth & (outline > 1.2)).any()
    assert alone[target & (cv2.distanceTransform(target.astype(np.uint8), cv2.DIST_L2, 5) > 3)].all()
    assert alone[43, 280:350].all()


def test_surroundings_show_in_every_image_or_are_none() -> None:
    seen = [laboratory(seed) for seed in range(4)]
    assert has_surroundings(seen, BORDER)
    assert not has_surroundings([*seen, laboratory(4, floor=0.0)], BORDER)
    assert not has_surroundings([], BORDER)


def test_what_is_half_as_bright_belongs_to_the_target() -> None:
    image = laboratory(0, floor=60.0)
    assert not has_surroundings([image], BORDER)
    assert target_mask(image, border=BORDER)[250, 20]


def test_a_target_that_reaches_the_border_itself_is_whole() -> None:
    image = laboratory(0, floor=0.0, u=20.0)
    assert not has_surroundings([image], BORDER)
    np.testing.assert_array_equal(target_mask(image, border=BORDER), target_mask(image))


def test_a_black_image_has_neither_target_nor_surroundings() -> None:
    black = np.zeros((300, 400), dtype=np.uint8)
    assert not has_surroundings([black], BORDER)
    assert not target_mask(black, border=BORDER).any()


def test_the_border_is_that_of_what_the_camera_sees() -> None:
    seen = np.zeros((60, 80), dtype=bool)
    seen[10:50, 20:70] = True
    border = border_of(seen)
    assert border[10:50, 20:23].all() and border[47:50, 20:70].all()
    assert not border[13:47, 23:67].any() and not border[~seen].any()
