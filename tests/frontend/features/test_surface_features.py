"""Features of the surface on rendered images: many, right, with axes that the motion carries along."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config.frontend_settings import Features, Frontend
from polhode.frontend.features.keypoints import find_candidates
from polhode.frontend.features.stereo import RootSift, StereoFeatures
from polhode.frontend.features.surface_features import (
    SurfaceFeatureMethod,
    feature_sigma,
    match_sigma,
    with_patch_size,
)
from polhode.frontend.rectification import RectifiedPair, Rectifier, make_rectifier, rectified_pair
from polhode.records.dataset import StereoSequence, open_sequence

SAMPLE = Path(__file__).parents[3] / "examples" / "sample"
CONFIG = Frontend(features=Features(method="polhode", surface_descriptor="rootsift"))


@pytest.fixture(scope="module")
def sequence() -> StereoSequence:
    return open_sequence(SAMPLE)


@pytest.fixture(scope="module")
def rectifier(sequence: StereoSequence) -> Rectifier:
    return make_rectifier(sequence.calibration)


@pytest.fixture(scope="module")
def pair(sequence: StereoSequence, rectifier: Rectifier) -> RectifiedPair:
    return rectified_pair(sequence, rectifier, 0)


def test_there_are_more_features_than_left_to_right_matching_finds(
    pair: RectifiedPair, rectifier: Rectifier
) -> None:
    ours = SurfaceFeatureMethod(CONFIG)(pair, rectifier.rig)
    classical = RootSift(Frontend())(pair, rectifier.rig)
    assert len(ours) > 1.5 * len(classical)
    # Where both have a feature they have one disparity.
    away = np.linalg.norm(ours.uvd_px[:, None, :2] - classical.uvd_px[None, :, :2], axis=2)
    i, j = np.nonzero(away < 0.1)
    assert len(i) > 50
    assert np.mean(np.abs(ours.uvd_px[i, 2] - classical.uvd_px[j, 2]) < 0.3) > 0.9


def test_axes_are_rotations_and_normals_face_the_camera(pair: RectifiedPair, rectifier: Rectifier) -> None:
    found = SurfaceFeatureMethod(CONFIG)(pair, rectifier.rig)
    assert found.R_RS is not None
    assert np.allclose(found.R_RS @ np.swapaxes(found.R_RS, 1, 2), np.eye(3), atol=1e-6)
    assert np.allclose(np.linalg.det(found.R_RS), 1.0)
    assert np.all(np.einsum("ni,ni->n", found.R_RS[:, :, 2], found.p_R) < 0.0)
    assert np.allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-3)


def test_an_empty_image_has_no_features(rectifier: Rectifier) -> None:
    rig = rectifier.rig
    black = np.zeros((rig.height_px, rig.width_px), np.uint8)
    nothing = RectifiedPair(black, black, black > 0, black > 0)
    assert len(SurfaceFeatureMethod(CONFIG)(nothing, rig)) == 0


def test_candidates_are_inside_the_mask_and_apart(pair: RectifiedPair) -> None:
    mask = pair.mask_left.copy()
    mask[:, : mask.shape[1] // 2] = False
    found = find_candidates(pair.left, mask, Features())
    pixel = np.round(found.uv_px).astype(int)
    assert len(found) > 20
    assert mask[pixel[:, 1], pixel[:, 0]].all()
    assert np.all(np.diff(found.response) <= 0.0)
    assert len(np.unique(np.round(found.uv_px / 0.5), axis=0)) == len(found)


def test_one_patch_size_serves_the_whole_sequence(sequence: StereoSequence, rectifier: Rectifier) -> None:
    sized = with_patch_size(CONFIG, sequence, rectifier)
    half_m = sized.features.patch_half_m
    assert half_m is not None
    found = SurfaceFeatureMethod(CONFIG)(rectified_pair(sequence, rectifier, 0), rectifier.rig)
    half_px = half_m * rectifier.rig.focal_px / float(np.median(found.p_R[:, 2]))
    assert half_px == pytest.approx(12.0, rel=0.25)
    # What the user sets stays, and methods without patches are left alone.
    assert with_patch_size(sized, sequence, rectifier) is sized
    assert with_patch_size(Frontend(), sequence, rectifier) == Frontend()


def _features(sigma_ls_px: list[float]) -> StereoFeatures:
    n = len(sigma_ls_px)
    sigma = feature_sigma(np.array(sigma_ls_px))
    return StereoFeatures(
        np.zeros((n, 3)), sigma, np.zeros((n, 3)), np.ones(n), np.zeros((n, 128), np.float32)
    )


def test_sharp_texture_is_more_certain() -> None:
    sharp, blunt = feature_sigma(np.array([0.03, 0.2]))
    assert np.all(sharp < blunt)
    assert sharp[0] == sharp[1]
    # What least squares call exact is not believed.
    assert np.array_equal(feature_sigma(np.array([0.0])), feature_sigma(np.array([0.005])))


def test_a_sure_match_is_more_certain_than_a_doubtful_one() -> None:
    a, b = _features([0.05, 0.05]), _features([0.05, 0.05])
    doubtful, sure = match_sigma(a, b, np.array([[0, 1], [1, 0]]), np.array([0.01, 0.9]))
    assert np.all(sure < doubtful)
    assert np.all(np.isfinite(match_sigma(a, b, np.array([[0, 0], [1, 1]]), np.array([0.0, 1.0]))))
