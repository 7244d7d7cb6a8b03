"""The shipped weights of the disparity network, on slanted planes painted with noise."""

import cv2
import numpy as np
import pytest

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth, dense_disparity
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools

RIG = RectifiedRig(400.0, 159.5, 119.5, 0.1, 320, 240)
NETWORK = Depth(method="network")
Pair = tuple[np.ndarray, np.ndarray]
Found = tuple[np.ndarray, np.ndarray]


def slanted() -> Array:
    """True disparity (240, 320) [px], an affine function."""
    v, u = np.mgrid[:240, :320].astype(np.float64)
    return np.asarray(40.0 + 0.06 * (u - 160) - 0.04 * (v - 120))


@pytest.fixture(scope="module")
def mask() -> Bools:
    inside = np.zeros((240, 320), dtype=bool)
    inside[50:190, 90:240] = True
    return inside


@pytest.fixture(scope="module")
def bare() -> Bools:
    """A panel in the middle that carries no texture."""
    inside = np.zeros((240, 320), dtype=bool)
    inside[90:150, 135:195] = True
    return inside


@pytest.fixture(scope="module")
def pair(mask: Bools, bare: Bools) -> Pair:
    """Left and right image: the right one shows at u - d(u, v) what the left one shows at u."""
    rng = np.random.default_rng(2)
    noise = [cv2.GaussianBlur(rng.normal(size=(240, 320)), (0, 0), s) * s for s in (1.2, 2.5, 6.0)]
    painted = sum(noise[1:], noise[0])
    painted = 110.0 + 35.0 * painted / painted.std()
    painted[bare] = 140.0
    left = np.where(mask, painted, 0.0)
    v, u = np.mgrid[:240, :320].astype(np.float32)
    disparity = slanted()
    slope = (disparity[:, -1] - disparity[:, 0])[:, None] / 319.0
    source = ((u + disparity[:, :1]) / (1.0 - slope)).astype(np.float32)
    right = cv2.remap(left.astype(np.float32), source, v, cv2.INTER_LINEAR)
    noisy = [np.clip(image + 4 + rng.normal(0, 1.5, image.shape), 0, 255) for image in (left, right)]
    return noisy[0].round().astype(np.uint8), noisy[1].round().astype(np.uint8)


@pytest.fixture(scope="module")
def found(pair: Pair, mask: Bools) -> Found:
    """Disparities and their sigmas [px] of the whole image."""
    return dense_disparity(*pair, mask, RIG, NETWORK, (32.0, 48.0))


def test_texture_gives_a_tenth_of_a_pixel(found: Found, mask: Bools, bare: Bools) -> None:
    disparity, _ = found
    error = np.abs(disparity - slanted())[mask & ~bare]
    assert np.isfinite(error).mean() > 0.95
    assert np.nanmedian(error) < 0.12
    assert np.nanmean(error > 1.0) < 0.03


def test_a_bare_panel_is_filled_from_its_rim(found: Found, mask: Bools, bare: Bools) -> None:
    disparity, sigma = found
    assert np.isfinite(disparity)[bare].mean() > 0.95
    assert np.nanmean(np.abs(disparity - slanted())[bare] > 1.0) < 0.1
    assert np.nanmedian(sigma[bare]) > np.nanmedian(sigma[mask & ~bare])


def test_sigma_is_honest(found: Found) -> None:
    disparity, sigma = found
    known = np.isfinite(disparity)
    error = np.abs(disparity - slanted())[known]
    assert 0.5 < np.mean(error < sigma[known]) < 0.97
    assert np.mean(error < 3.0 * sigma[known]) > 0.95


def test_the_same_pair_gives_the_same_bytes(pair: Pair, mask: Bools) -> None:
    first, second = (compute_depth(*pair, mask, RIG, NETWORK, (32.0, 48.0)) for _ in range(2))
    assert first.depth_m.tobytes() == second.depth_m.tobytes()
    assert first.sigma_m.tobytes() == second.sigma_m.tobytes()
