"""Parts of checkout by themselves: one image, the stamps, the motion behind a relative pose."""

import cv2
import numpy as np
import pytest

from polhode.frontend.rectification import Image
from polhode.geometry.lie import Ints, exp_so3, make_pose
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


def test_widths_of_edges_noise_and_levels_follow_blur_noise_and_exposure() -> None:
    widths = [image_quality(picture(blur), None).edge_px for blur in (0.0, 1.0, 2.0, 3.0)]
    assert widths == sorted(widths)
    assert widths[0] == pytest.approx(0.85, abs=0.2) and widths[2] == pytest.approx(2.1, abs=0.4)
    sharp, smeared = (image_quality(picture(smear_px=px), None).edge_by_direction_px for px in (1, 7))
    assert sharp[0] / sharp[2] < 1.3 and smeared[0] / smeared[2] > 1.8
    for noise in (1.0, 3.0, 8.0):
        assert image_quality(picture(noise=noise), None).noise == pytest.approx(noise, rel=0.3)
    bright, dark = (image_quality(picture(level=level), None) for level in (600.0, 30.0))
    assert bright.saturated > 0.5 and bright.bright_level == 255
    assert dark.saturated == 0.0 and dark.bright_level < 40


def test_the_target_its_surroundings_and_a_given_mask() -> None:
    quality = image_quality(picture(), None)
    assert quality.extent_px == pytest.approx((160.0, 160.0), abs=8)
    assert (quality.touches_border, quality.border_bright) == (False, 0.0)
    image, mask = picture(), np.zeros((240, 320), dtype=np.bool_)
    image[:, :60], mask[40:200, 80:160] = 90, True
    wall, given = image_quality(image, None), image_quality(picture(), mask)
    assert wall.touches_border and wall.border_bright > 0.2
    assert given.extent_px == (80.0, 160.0) and given.around_bright > 0.1
    nothing = image_quality(np.zeros((48, 64), dtype=np.uint8), None)
    assert nothing.extent_px == (0.0, 0.0) and nothing.target_share == 0.0
    assert np.isnan([nothing.edge_px, nothing.noise, nothing.saturated, nothing.bright_level]).all()


@pytest.mark.parametrize("w", [(0.0, 0.0, 0.0), (0.1, -0.3, 0.2), (0.0, 2.0, 0.0)])
def test_twist_moves_points_as_the_pose_does(w: tuple[float, float, float]) -> None:
    rate, velocity, seconds, doublings = np.array(w), np.array([0.2, -0.1, 0.05]), 0.5, 16
    X = make_pose(exp_so3(rate * seconds / 2**doublings), velocity * seconds / 2**doublings)
    for _ in range(doublings):
        X = X @ X
    found_w, found_v = twist(X, seconds)
    np.testing.assert_allclose(found_w, rate, atol=1e-6)
    np.testing.assert_allclose(found_v, velocity, atol=1e-4)


@pytest.mark.parametrize(
    ("right", "offset", "unpaired", "words"),
    [
        (LEFT + 4_000, (4.0, "WARN"), (0.0, "PASS"), "4 us"),
        (LEFT - 4_000, (4.0, "WARN"), (0.0, "PASS"), "before"),
        (LEFT + 200_000_000, (200_000.0, "WARN"), (0.0, "PASS"), "(0.4 frames) after"),
        (LEFT, (0.0, "PASS"), (0.0, "PASS"), "no constant difference"),
        (LEFT[:-1], (0.0, "PASS"), (5.0, "PASS"), ""),
        (LEFT[::2], (0.0, "PASS"), (50.0, "WARN"), ""),
        (LEFT[::4], (0.0, "PASS"), (75.0, "FAIL"), ""),
        (LEFT + 10**15, (None, "FAIL"), (100.0, "FAIL"), "near enough"),
    ],
)
def test_offsets_of_the_clocks_and_unpaired_images(
    right: Ints, offset: tuple[float | None, str], unpaired: tuple[float, str], words: str
) -> None:
    checks = stamp_checks(Stamps(LEFT, right))
    assert [(check.value, check.status) for check in checks] == [offset, unpaired]
    assert words in checks[0].finding and checks[0].unit == "us"


def test_stamps_that_scatter_too_much_have_no_partner() -> None:
    late = np.where(np.arange(20) % 2, 100_000_000, 0)
    offset, partners = stamp_checks(Stamps(LEFT, LEFT + late))
    assert partners.value is not None and partners.value > 50.0 and partners.status != "PASS"
    assert "5 ms are allowed" in offset.finding
