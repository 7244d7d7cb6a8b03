"""The registry: every name of the configuration is a method, and methods answer as the interfaces say."""

from pathlib import Path
from typing import get_args

import kornia.feature
import numpy as np
import pytest
import torch

from polhode.config.frontend_settings import Depth, Features, Frontend, PairMatching
from polhode.frontend.extract import extract_features, extract_pair, require_weights
from polhode.frontend.features.keypoints import detect
from polhode.frontend.features.methods import FEATURE_METHODS, feature_method
from polhode.frontend.features.stereo import StereoFeatures, match_stereo
from polhode.frontend.matching import nearest
from polhode.frontend.matching.methods import MATCH_METHODS, match_method
from polhode.frontend.matching.nearest import _products
from polhode.frontend.rectification import (
    RectifiedPair,
    Rectifier,
    make_rectifier,
    rectified_pair,
    target_crop,
)
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError
from tests.frontend.feature_world import make_world

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample"


def configured(features: str = "rootsift", pairs: str = "nearest", ratio: float = 0.92) -> Frontend:
    return Frontend.model_validate(
        {"features": {"method": features}, "pairs": {"method": pairs, "ratio": ratio}}
    )


@pytest.fixture(scope="module")
def rectifier() -> Rectifier:
    return make_rectifier(open_sequence(SAMPLE).calibration)


@pytest.fixture(scope="module")
def pair(rectifier: Rectifier) -> RectifiedPair:
    return rectified_pair(open_sequence(SAMPLE), rectifier, 0)


def test_every_name_of_the_configuration_has_a_method() -> None:
    features = Features.model_fields["method"].annotation
    named, or_null = get_args(PairMatching.model_fields["method"].annotation)
    assert set(get_args(features)) == set(FEATURE_METHODS)
    assert (set(get_args(named)), or_null) == (set(MATCH_METHODS), type(None))


def test_a_matcher_that_is_not_named_goes_with_the_features() -> None:
    for features, matcher in (("polhode", "polhode"), ("rootsift", "nearest"), ("disk", "nearest")):
        assert Frontend.model_validate({"features": {"method": features}}).matcher == matcher
    named = {"features": {"method": "polhode"}, "pairs": {"method": "nearest"}}
    assert Frontend.model_validate(named).matcher == "nearest"


def test_rootsift_is_the_detector_left_and_right_matched_along_the_rows(
    pair: RectifiedPair, rectifier: Rectifier
) -> None:
    config = Frontend()
    sides = [(pair.left, pair.mask_left), (pair.right, pair.mask_right)]
    points = []
    for image, mask in sides:
        crop = target_crop(mask)
        assert crop is not None
        points.append(detect(image, mask, crop, config.features))
    expected, _ = match_stereo(pair.left, pair.right, points[0], points[1], rectifier.rig)
    found = feature_method(configured("rootsift"))(pair, rectifier.rig)
    assert len(found) > 300
    np.testing.assert_array_equal(found.uvd_px, expected.uvd_px)
    np.testing.assert_array_equal(found.descriptors, expected.descriptors)


def test_nearest_is_kornias_symmetric_ratio_test() -> None:
    a, b = make_world(n_frames=2).frames
    matches = match_method(configured(ratio=0.8))(a, b)
    with torch.inference_mode():
        whole = [torch.from_numpy(each.coarse_descriptors.whole[: len(each)]).float() for each in (a, b)]
        ratio, index = kornia.feature.match_smnn(whole[0], whole[1], 0.8)
    assert len(index) > 20
    np.testing.assert_array_equal(matches.features, index.numpy())
    np.testing.assert_allclose(matches.confidence, 1.0 - ratio.numpy()[:, 0], atol=1e-6)


def test_products_are_the_same_without_instructions_for_whole_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a, b = (frame.coarse_descriptors for frame in make_world(n_frames=2).frames)
    expected = a.whole.astype(np.int64) @ b.whole.astype(np.int64).T
    for has in (nearest._multiplies_whole_numbers(), False):
        monkeypatch.setattr(nearest, "_multiplies_whole_numbers", lambda has=has: has)
        np.testing.assert_array_equal(_products(a, b), expected)


@pytest.mark.parametrize("count", [0, 1])
def test_frames_without_features_have_no_matches(count: int) -> None:
    a, b = make_world(n_frames=2).frames
    few = StereoFeatures(
        a.uvd_px[:count], a.sigma_px[:count], a.p_R[:count], a.scale_px[:count], a.descriptors[:count]
    )
    for first, second in ((few, b), (b, few)):
        assert match_method(configured())(first, second).features.shape == (0, 2)


def test_only_matchers_that_read_images_are_given_them(pair: RectifiedPair, rectifier: Rectifier) -> None:
    assert extract_pair(pair, rectifier.rig, configured()).picture is None
    picture = extract_pair(pair, rectifier.rig, configured(pairs="loftr")).picture
    assert picture is not None
    u, v = picture.corner_px
    height, width = picture.image.shape
    np.testing.assert_array_equal(picture.image, pair.left[v : v + height, u : u + width])
    assert pair.mask_left[v : v + height, u : u + width].sum() == pair.mask_left.sum()


def test_a_matcher_whose_weights_are_missing_is_refused_before_any_work(small_sequence: Path) -> None:
    sequence = open_sequence(small_sequence)
    rectifier = make_rectifier(sequence.calibration)
    with pytest.raises(InputError, match=r"LoFTR.*frontend\.weights\.loftr"):
        extract_features(sequence, rectifier, configured(pairs="loftr"), 1, range(len(sequence)))


def test_wrong_weights_of_the_depth_are_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(b"0" * 40)
    for name, expected in (
        ("none.safetensors", "are missing"),
        ("bad.safetensors", "not a safetensors file"),
    ):
        config = Frontend(depth=Depth(weights=str(tmp_path / name)))
        with pytest.raises(InputError, match=f"{name}.*{expected}"):
            require_weights(config)
