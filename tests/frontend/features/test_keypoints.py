"""Key points: where they are, that they do not depend on exposure, and which of them are kept."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from polhode.config.frontend_settings import Features
from polhode.frontend.features.keypoints import KeyPoints, detect, find_candidates, stretch
from polhode.frontend.rectification import Crop, Image

WHOLE = Crop(0, 0, 220, 200)


def texture(du: float = 0.0, dv: float = 0.0) -> Image:
    """A random sum of Gaussians (200, 220), shifted exactly by (du, dv) pixels."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[0:200, 0:220].astype(np.float64)
    image = np.full(u.shape, 110.0)
    for x, y, width, height in rng.uniform([0, 0, 2, -60], [220, 200, 5, 60], (250, 4)):
        image += height * np.exp(-((u - x - du) ** 2 + (v - y - dv) ** 2) / (2 * width**2))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def found(image: Image, crop: Crop = WHOLE, **settings: float) -> KeyPoints:
    return detect(image, np.ones(image.shape, dtype=bool), crop, Features.model_validate(settings))


@pytest.mark.parametrize("upsample", [1.7, 2.0])
def test_enlargement_does_not_shift_key_points(upsample: float) -> None:
    image = texture()
    plain, enlarged = found(image, upsample=1.0), found(image, Crop(11, 7, 211, 190), upsample=upsample)
    distance, nearest = cKDTree(plain.uv_px).query(enlarged.uv_px)
    shift = (enlarged.uv_px - plain.uv_px[nearest])[distance < 0.5]
    assert len(shift) > 50
    assert np.abs(np.median(shift, axis=0)).max() < 0.02


def test_key_points_follow_a_sub_pixel_shift() -> None:
    before, after = found(texture()), found(texture(0.37, -0.21))
    distance, nearest = cKDTree(before.uv_px + np.array([0.37, -0.21])).query(after.uv_px)
    shift = (after.uv_px - before.uv_px[nearest])[distance < 0.5]
    np.testing.assert_allclose(np.median(shift, axis=0), [0.37, -0.21], atol=0.02)


def test_descriptors_do_not_depend_on_exposure() -> None:
    bright, dark = texture(), (texture() * 0.35).astype(np.uint8)
    points = [found(image) for image in (bright, dark)]
    distance, nearest = cKDTree(points[0].uv_px).query(points[1].uv_px)
    same = distance < 0.3
    likeness = np.sum(points[1].descriptors[same] * points[0].descriptors[nearest[same]], axis=1)
    assert same.mean() > 0.8
    assert np.median(likeness) > 0.97
    assert np.percentile(stretch(dark), 99.5) == pytest.approx(230, abs=8)


def test_the_strongest_are_kept_and_candidates_are_inside_the_mask_and_apart() -> None:
    few, all_points = found(texture(), max_features=50), found(texture(), max_features=100000)
    assert len(few) == 50 < len(all_points)
    np.testing.assert_array_equal(few.uv_px, all_points.uv_px[:50])
    mask = np.ones((200, 220), dtype=bool)
    mask[:, :110] = False
    candidates = find_candidates(texture(), mask, Features())
    pixel = np.round(candidates.uv_px).astype(int)
    assert len(candidates) > 20 and mask[pixel[:, 1], pixel[:, 0]].all()
    assert np.all(np.diff(candidates.response) <= 0.0)
    assert len(np.unique(np.round(candidates.uv_px / 0.5), axis=0)) == len(candidates)
