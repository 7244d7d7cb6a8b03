"""Parts of checkout by themselves: one image, the stamps, the motion behind a relative pose."""

import cv2
import numpy as np
import pytest

from polhode.frontend.rectification import Image
from polhode.geometry.lie import Array, Ints, exp_so3, make_pose
from polhode.pipeline.checkout.image_quality import image_quality
from polhode.pipeline.checkout.target_motion import twist
from polhode.pipeline.checkout.timing import Stamps, stamp_checks

LEFT = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(20, dtype=np.int64)


def picture(blur_px: float = 0.0, noise: float = 1.0, smear_px: int = 1, level: float = 160.0) -> Image:
    """Bricks of different grey before a black sky, each with sharp edges."""
    rng = np.random.default_rng(3)
    bricks = np.kron(rng.uniform(0.3, 1.0, (8, 8)), np.ones((20, 20))) * level
    image = np.zeros((240, 320))
    image[40:200, 80:240] = bricks
    # as a lens and a pixel blur it
    blurred = cv2.GaussianBlur(image, (0, 0), float(np.hypot(0.5, blur_px)))
    smeared = np.asarray(cv2.filter2D(blurred, -1, np.full((1, smear_px), 1.0 / smear_px)))
    return np.clip(np.rint(smeared + 2.0 + noise * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def test_the_width_of_edges_follows_the_blur() -> None:
    widths = [image_quality(picture(blur), None).edge_px for blur in (0.0, 1.0, 2.0, 3.0)]
    assert widths == sorted(widths)
    assert widths[0] == pytest.approx(0.85, abs=0.2) and widths[2] == pytest.approx(2.1, abs=0.4)


def test_motion_blur_shows_in_the_edges_across_it() -> None:
    sharp = image_quality(picture(), None).edge_by_direction_px
    smeared = image_quality(picture(smear_px=7), None).edge_by_direction_px
    assert sharp[0] / sharp[2] < 1.3 and smeared[0] / smeared[2] > 1.8


def test_noise_is_measured_beside_texture() -> None:
    for noise in (1.0, 3.0, 8.0):
        assert image_quality(picture(noise=noise), None).noise == pytest.approx(noise, rel=0.3)


def test_saturation_and_brightness_are_those_of_the_target() -> None:
    quality = image_quality(picture(level=600.0), None)
    assert quality.saturated > 0.5 and quality.bright_level == 255
    dark = image_quality(picture(level=30.0), None)
    assert dark.saturated == 0.0 and dark.bright_level < 40


def test_the_target_and_its_surroundings() -> None:
    quality = image_quality(picture(), None)
    assert quality.extent_px == pytest.approx((160.0, 160.0), abs=8)
    assert (quality.touches_border, quality.border_bright) == (False, 0.0)
    image = picture()
    image[:, :60] = 90
    wall = image_quality(image, None)
    assert wall.touches_border and wall.border_bright > 0.2


def test_a_given_mask_is_the_target() -> None:
    mask = np.zeros((240, 320), dtype=np.bool_)
    mask[40:200, 80:160] = True
    quality = image_quality(picture(), mask)
    assert quality.extent_px == (80.0, 160.0) and quality.around_bright > 0.1


def test_an_image_without_a_target_has_no_numbers() -> None:
    quality = image_quality(np.zeros((48, 64), dtype=np.uint8), None)
    assert quality.extent_px == (0.0, 0.0) and quality.target_share == 0.0
    assert np.isnan([quality.edge_px, quality.noise, quality.saturated, quality.bright_level]).all()


@pytest.mark.parametrize("w", [(0.0, 0.0, 0.0), (0.1, -0.3, 0.2), (0.0, 2.0, 0.0)])
def test_twist_moves_points_as_the_pose_does(w: tuple[float, float, float]) -> None:
    rate, velocity, seconds = np.array(w), np.array([0.2, -0.1, 0.05]), 0.5
    steps = 20_000
    X: Array = np.eye(4)
    small = make_pose(exp_so3(rate * seconds / steps), velocity * seconds / steps)
    for _ in range(steps):
        X = small @ X
    found_w, found_v = twist(X, seconds)
    np.testing.assert_allclose(found_w, rate, atol=1e-6)
    np.testing.assert_allclose(found_v, velocity, atol=1e-4)


@pytest.mark.parametrize(
    ("offset_ns", "microseconds", "words"),
    [(4_000, 4.0, "4 us"), (-4_000, 4.0, "before"), (200_000_000, 200_000.0, "(0.4 frames) after")],
)
def test_an_offset_of_the_clocks_is_stated(offset_ns: int, microseconds: float, words: str) -> None:
    offset, partners = stamp_checks(Stamps(LEFT, LEFT + offset_ns))
    assert (offset.value, offset.status, offset.unit) == (microseconds, "WARN", "us")
    assert words in offset.finding and partners.status == "PASS"


@pytest.mark.parametrize(
    ("right", "found"),
    [
        (LEFT, [(0.0, "PASS"), (0.0, "PASS")]),
        (LEFT[:-1], [(0.0, "PASS"), (5.0, "PASS")]),
        (LEFT[::2], [(0.0, "PASS"), (50.0, "WARN")]),
        (LEFT[::4], [(0.0, "PASS"), (75.0, "FAIL")]),
        (LEFT + 10**15, [(None, "FAIL"), (100.0, "FAIL")]),
    ],
)
def test_unpaired_images_are_counted(right: Ints, found: list[tuple[float | None, str]]) -> None:
    assert [(check.value, check.status) for check in stamp_checks(Stamps(LEFT, right))] == found


def test_stamps_that_scatter_too_much_have_no_partner() -> None:
    late = np.where(np.arange(20) % 2, 100_000_000, 0)
    offset, partners = stamp_checks(Stamps(LEFT, LEFT + late))
    assert partners.value is not None and partners.value > 50.0 and partners.status != "PASS"
    assert "5 ms are allowed" in offset.finding
