"""Features of the surface on rendered images: many, right, with axes that the motion carries along."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.config.frontend_settings import Features, Frontend
from polhode.frontend.features.stereo import RootSift
from polhode.frontend.features.surface_features import (
    SurfaceFeatureMethod,
    feature_sigma,
    match_sigma,
    with_patch_size,
)
from polhode.frontend.rectification import RectifiedPair, make_rectifier, rectified_pair
from polhode.records.dataset import open_sequence
from tests.frontend.feature_world import first_features, make_world

CONFIG = Frontend(features=Features(method="polhode"))
SEQUENCE = open_sequence(Path(__file__).parents[3] / "examples" / "sample")
RECTIFIER = make_rectifier(SEQUENCE.calibration)


def test_there_are_more_features_than_left_to_right_matching_finds_with_axes_of_the_surface() -> None:
    pair, rig = rectified_pair(SEQUENCE, RECTIFIER, 0), RECTIFIER.rig
    ours, classical = SurfaceFeatureMethod(CONFIG)(pair, rig), RootSift(Frontend())(pair, rig)
    assert len(ours) > 1.5 * len(classical)
    # Where both have a feature they have one disparity.
    away = np.linalg.norm(ours.uvd_px[:, None, :2] - classical.uvd_px[None, :, :2], axis=2)
    i, j = np.nonzero(away < 0.1)
    assert len(i) > 50
    assert np.mean(np.abs(ours.uvd_px[i, 2] - classical.uvd_px[j, 2]) < 0.3) > 0.9
    assert ours.R_RS is not None
    assert np.allclose(ours.R_RS @ np.swapaxes(ours.R_RS, 1, 2), np.eye(3), atol=1e-6)
    assert np.allclose(np.linalg.det(ours.R_RS), 1.0)
    # normals face the camera
    assert np.all(np.einsum("ni,ni->n", ours.R_RS[:, :, 2], ours.p_R) < 0.0)
    assert np.allclose(np.linalg.norm(ours.descriptors, axis=1), 1.0, atol=1e-3)
    black = np.zeros_like(pair.left)
    assert len(SurfaceFeatureMethod(CONFIG)(RectifiedPair(black, black, black > 0, black > 0), rig)) == 0
    # one size of patches serves the whole sequence
    sized = with_patch_size(CONFIG, SEQUENCE, RECTIFIER)
    half_m = sized.features.patch_half_m
    assert half_m is not None
    assert half_m * rig.focal_px / float(np.median(ours.p_R[:, 2])) == pytest.approx(12.0, rel=0.25)
    # What the user sets stays, and methods without patches are left alone.
    assert with_patch_size(sized, SEQUENCE, RECTIFIER) is sized
    assert with_patch_size(Frontend(), SEQUENCE, RECTIFIER) == Frontend()


def test_sharp_texture_and_sure_matches_are_more_certain() -> None:
    sharp, blunt = feature_sigma(np.array([0.03, 0.2]))
    assert np.all(sharp < blunt) and sharp[0] == sharp[1]
    # What least squares call exact is not believed.
    assert np.array_equal(feature_sigma(np.array([0.0])), feature_sigma(np.array([0.005])))
    two = replace(first_features(make_world(1).frames[0], 2), sigma_px=feature_sigma(np.array([0.05, 0.05])))
    doubtful, sure = match_sigma(two, two, np.array([[0, 1], [1, 0]]), np.array([0.01, 0.9]))
    assert np.all(sure < doubtful)
    assert np.all(np.isfinite(match_sigma(two, two, np.array([[0, 0], [1, 1]]), np.array([0.0, 1.0]))))
