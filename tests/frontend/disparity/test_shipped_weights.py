"""The shipped weights of the disparity network, on a slanted plane painted with noise."""

import cv2
import numpy as np
import pytest

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth, dense_disparity
from tests.frontend.disparity.painted_planes import RIG, pair_of, rectangle, slanted

MASK = rectangle(slice(50, 190), slice(90, 240))
BARE = rectangle(slice(90, 150), slice(135, 195))
"""A panel in the middle that carries no texture."""
TRUE = slanted(40.0, 0.06, -0.04)


@pytest.fixture(scope="module")
def found() -> tuple[np.ndarray, np.ndarray]:
    """Disparities and their sigmas [px] of the whole image."""
    return dense_disparity(*pair_of(TRUE, MASK, BARE, cv2.INTER_LINEAR), MASK, RIG, Depth(), (32.0, 48.0))


def test_texture_gives_a_tenth_of_a_pixel_and_a_bare_panel_is_filled_from_its_rim(
    found: tuple[np.ndarray, np.ndarray],
) -> None:
    disparity, sigma = found
    error = np.abs(disparity - TRUE)
    textured = error[MASK & ~BARE]
    assert np.isfinite(textured).mean() > 0.95
    assert np.nanmedian(textured) < 0.12 and np.nanmean(textured > 1.0) < 0.03
    assert np.isfinite(disparity)[BARE].mean() > 0.95
    assert np.nanmean(error[BARE] > 1.0) < 0.1
    assert np.nanmedian(sigma[BARE]) > np.nanmedian(sigma[MASK & ~BARE])
    known = np.isfinite(disparity)
    assert 0.5 < np.mean(error[known] < sigma[known]) < 0.97
    assert np.mean(error[known] < 3.0 * sigma[known]) > 0.95


def test_the_same_pair_gives_the_same_bytes() -> None:
    pair = pair_of(TRUE, MASK, BARE, cv2.INTER_LINEAR)
    first, second = (compute_depth(*pair, MASK, RIG, Depth(), (32.0, 48.0)) for _ in range(2))
    assert first.depth_m.tobytes() == second.depth_m.tobytes()
    assert first.sigma_m.tobytes() == second.sigma_m.tobytes()
