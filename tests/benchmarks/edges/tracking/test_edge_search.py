"""Edges of an image along normals."""

import numpy as np
import pytest
from scipy.special import erf

from benchmarks.edges.tracking.edge_search import Levels, gradients, levels, search


def ramp(at_px: float, height: float = 100.0) -> Levels:
    """A vertical edge at u = at_px, brighter to the right, blurred by a pixel and a Gaussian of 0.8 px."""
    u = np.arange(64)
    row = np.mean(
        [0.5 * (1 + erf((u + s - at_px) / (0.8 * np.sqrt(2)))) for s in np.linspace(-0.5, 0.5, 41)], axis=0
    )
    return np.tile(height * row, (48, 1)).astype(np.float32)


ONE = np.array([[30.0, 24.3]])
RIGHT = np.array([[1.0, 0.0]])
EITHER = np.zeros(1, dtype=np.int64)


@pytest.mark.parametrize("at_px", [28.0, 29.37, 30.5, 31.81])
def test_an_edge_is_found_to_a_twentieth_of_a_pixel(at_px: float) -> None:
    found = search(ramp(at_px), ONE, RIGHT, EITHER, 4.0, 4.0)
    assert np.nanmin(np.abs(found.offset_px[0] - (at_px - 30.0))) < 0.05
    # blur lowers the answer
    assert 50.0 < found.contrast[0].max() <= 100.0


def test_an_edge_the_wrong_way_round_is_not_the_one() -> None:
    image = ramp(30.4)
    assert np.isfinite(search(image, ONE, RIGHT, EITHER + 1, 4.0, 4.0).offset_px).any()
    assert np.isnan(search(image, ONE, RIGHT, EITHER - 1, 4.0, 4.0).offset_px).all()
    assert np.isfinite(search(image, ONE, -RIGHT, EITHER - 1, 4.0, 4.0).offset_px).any()


def test_beyond_the_range_or_below_the_contrast_there_is_none() -> None:
    assert np.isnan(search(ramp(36.0), ONE, RIGHT, EITHER, 4.0, 4.0).offset_px).all()
    assert np.isnan(search(ramp(30.0, 3.0), ONE, RIGHT, EITHER, 4.0, 4.0).offset_px).all()


def test_outside_of_the_image_there_is_none() -> None:
    away = np.array([[-20.0, 5.0], [200.0, 5.0]])
    found = search(ramp(30.0), away, np.repeat(RIGHT, 2, axis=0), np.zeros(2, dtype=np.int64), 8.0, 1.0)
    assert np.isnan(found.offset_px).all()
    assert (levels(ramp(30.0), away) == 0.0).all()


def test_two_edges_are_both_kept() -> None:
    image = ramp(27.0) - ramp(33.0)
    found = search(image, ONE, RIGHT, EITHER, 6.0, 10.0)
    assert sorted(np.round(found.offset_px[0][np.isfinite(found.offset_px[0])])) == [-3.0, 3.0]
    assert set(np.sign(found.contrast[0])) == {-1.0, 0.0, 1.0}


def test_the_gradient_points_to_the_light() -> None:
    slope = gradients(ramp(30.0), ONE)
    assert slope[0, 0] > 50.0 and abs(slope[0, 1]) < 1e-3
