"""The registry: every name of the configuration is a method, and methods answer as the interfaces say."""

from pathlib import Path
from typing import get_args

import kornia.feature
import numpy as np
import pytest
import torch

from polhode.config.frontend_settings import Depth, Features, Frontend, PairMatching
from polhode.frontend.extract import require_weights
from polhode.frontend.features.keypoints import detect
from polhode.frontend.features.methods import FEATURE_METHODS, feature_method
from polhode.frontend.features.stereo import match_stereo
from polhode.frontend.matching import nearest
from polhode.frontend.matching.methods import MATCH_METHODS, match_method
from polhode.frontend.rectification import make_rectifier, rectified_pair, target_crop
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError
from tests.frontend.feature_world import first_features, make_world

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample"


def test_every_name_of_the_configuration_has_a_method_and_features_their_matcher() -> None:
    named, or_null = get_args(PairMatching.model_fields["method"].annotation)
    assert set(get_args(Features.model_fields["method"].annotation)) == set(FEATURE_METHODS)
    assert (set(get_args(named)), or_null) == (set(MATCH_METHODS), type(None))
    for features, matcher in (("polhode", "polhode"), ("rootsift", "nearest")):
        assert Frontend.model_validate({"features": {"method": features}}).matcher == matcher
    named_one = {"features": {"method": "polhode"}, "pairs": {"method": "nearest"}}
    assert Frontend.model_validate(named_one).matcher == "nearest"


def test_rootsift_is_the_detector_left_and_right_matched_along_the_rows() -> None:
    sequence, points = open_sequence(SAMPLE), []
    rectifier = make_rectifier(sequence.calibration)
    pair = rectified_pair(sequence, rectifier, 0)
    for image, mask in ((pair.left, pair.mask_left), (pair.right, pair.mask_right)):
        crop = target_crop(mask)
        assert crop is not None
        points.append(detect(image, mask, crop, Features()))
    expected, _ = match_stereo(pair.left, pair.right, points[0], points[1], rectifier.rig)
    found = feature_method(Frontend())(pair, rectifier.rig)
    assert len(found) > 300
    np.testing.assert_array_equal(found.uvd_px, expected.uvd_px)
    np.testing.assert_array_equal(found.descriptors, expected.descriptors)


def test_nearest_is_kornias_symmetric_ratio_test() -> None:
    a, b = make_world(n_frames=2).frames
    matches = match_method(Frontend(pairs=PairMatching(ratio=0.8)))(a, b)
    with torch.inference_mode():
        whole = [torch.from_numpy(each.coarse_descriptors.whole[: len(each)]).float() for each in (a, b)]
        ratio, index = kornia.feature.match_smnn(whole[0], whole[1], 0.8)
    assert len(index) > 20
    np.testing.assert_array_equal(matches.features, index.numpy())
    np.testing.assert_allclose(matches.confidence, 1.0 - ratio.numpy()[:, 0], atol=1e-6)
    for count in (0, 1):
        few = first_features(a, count)
        for first, second in ((few, b), (b, few)):
            assert match_method(Frontend())(first, second).features.shape == (0, 2)


def test_products_are_the_same_without_instructions_for_whole_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a, b = (frame.coarse_descriptors for frame in make_world(n_frames=2).frames)
    expected = a.whole.astype(np.int64) @ b.whole.astype(np.int64).T
    for has in (nearest._multiplies_whole_numbers(), False):
        monkeypatch.setattr(nearest, "_multiplies_whole_numbers", lambda has=has: has)
        np.testing.assert_array_equal(nearest._products(a, b), expected)


def test_wrong_weights_of_the_depth_are_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(b"0" * 40)
    for name, expected in (("none", "are missing"), ("bad", "not a safetensors file")):
        config = Frontend(depth=Depth(weights=str(tmp_path / f"{name}.safetensors")))
        with pytest.raises(InputError, match=f"{name}.*{expected}"):
            require_weights(config)
