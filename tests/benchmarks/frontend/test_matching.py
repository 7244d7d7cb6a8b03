"""The benchmark of the front end judges features and matches by what the simulator knows."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.frontend.matching import (
    METHODS,
    correct,
    correct_at,
    guided_error_deg,
    lit_of,
    lit_pairs,
    loosened,
    normalised_squares,
    precision_of,
    residual_variances,
    settings,
    success,
)
from benchmarks.frontend.scenes import BRIGHT_DN, CONFIGS, UnseenScene, scene_names, scene_of
from benchmarks.record import Case
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import Matches
from polhode.frontend.rectification import make_rectifier
from polhode.lie import Array, exp_so3, make_pose, transform_points
from polhode.simulation.dataset.correspondence import dense_correspondence, view_of
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.raycast import RayCaster
from polhode.truth import read_truth

SAMPLE = Path(__file__).resolve().parents[3] / "sample"


@pytest.fixture(scope="module")
def sequence() -> StereoSequence:
    return open_sequence(SAMPLE)


def scene_config() -> Config:
    """The sample's cameras before a truss of another scene: only the body and its pose matter here."""
    return load_config(CONFIGS / "truss.yaml", {"scene.rig.baseline_m": 0.09, "scene.frames": 2})


def test_scenes_are_none_of_the_training_ones() -> None:
    assert len(scene_names()) >= 8
    assert set(scene_names(short=True)) < set(scene_names())
    for name in scene_names():
        config = load_config(CONFIGS / f"{name}.yaml")
        assert config.scene is not None
        assert config.scene.body.texture == "collage"
        assert config.seed < 1000 and config.scene.body.seed is None
        assert config.scene.light.earth <= 0.02


def test_a_methods_name_says_its_settings() -> None:
    config = settings("aliked-1.5x+lightglue")
    assert (config.features.method, config.features.upsample) == ("aliked", 1.5)
    assert config.pairs.method == "lightglue"
    assert settings("rootsift-2x").matcher == "nearest"
    assert settings("polhode").matcher == "polhode"
    assert settings("polhode+nearest").matcher == "nearest"
    assert loosened(config).pairs.min_confidence == 0.0
    assert len({settings(method) for method in METHODS}) == len(METHODS)
    with pytest.raises(SystemExit, match="write features"):
        settings("aliked 2x")


def test_features_are_judged_by_the_surface_behind_them(sequence: StereoSequence) -> None:
    config = scene_config()
    assert config.scene is not None
    plan = plan_sequence(config.scene, config.seed)
    caster = RayCaster(plan.body)
    rectifier = make_rectifier(sequence.calibration)
    view = view_of(plan, 0, 0)
    scene = UnseenScene(sequence, rectifier, caster, view.X_GK[None])
    truth = dense_correspondence(caster, view, view)
    shown = np.isfinite(truth.p_G[..., 0])
    uv = view.camera.pixel_grid()[shown][::97]
    p_G = truth.p_G[shown][::97]
    uvd = scene.rig.project(transform_points(np.linalg.inv(view.X_GK), p_G))
    np.testing.assert_allclose(uvd[:, :2], uv, atol=1e-6)
    found_G, error_px = scene.body_points(0, uvd)
    np.testing.assert_allclose(found_G, p_G, atol=1e-6)
    assert error_px.max() < 1e-4
    _, error_px = scene.body_points(0, uvd - [0.0, 0.0, 3.0])
    # Nearer surfaces within a pixel excuse few.
    assert np.median(error_px) > 2.5
    sky_G, error_px = scene.body_points(0, np.array([[3.0, 3.0, 50.0]]))
    assert np.isnan(sky_G).all() and np.isinf(error_px).all()


def test_a_rendered_scene_knows_its_features_its_light_and_its_motion() -> None:
    scene = scene_of(SAMPLE / "scene.yaml", SAMPLE)
    frame = extract_pair(scene.pair(0), scene.rig, settings("rootsift-2x"))
    _, error_px = scene.body_points(0, frame.uvd_px)
    assert np.median(error_px) < 0.15
    assert np.mean(error_px > 1.0) < 0.05
    bright = int(np.sum(scene.pair(0).left > BRIGHT_DN))
    assert 0.9 * bright < scene.lit_in_both(0, 0) <= bright + 7
    assert 0 < scene.lit_in_both(0, 1) < 0.95 * bright
    truth = read_truth(SAMPLE)
    stamps = [int(np.flatnonzero(truth.timestamps_ns == scene.sequence.timestamps_ns[k])[0]) for k in (0, 1)]
    R_NP, R_CR = truth.R_NP[stamps], scene.rectifier.X_CR[:3, :3]
    turn = R_CR.T @ R_NP[0] @ R_NP[1].T @ R_CR
    np.testing.assert_allclose(scene.motion(0, 1)[:3, :3], turn, atol=1e-6)


def test_a_frame_is_found_from_a_prediction_that_is_off() -> None:
    scene = scene_of(SAMPLE / "scene.yaml", SAMPLE)
    for method in ("rootsift-2x", "polhode"):
        config = with_patch_size(settings(method), scene.sequence, scene.rectifier)
        frames = [extract_pair(scene.pair(k), scene.rig, config) for k in (0, 1)]
        error_deg = guided_error_deg(scene, frames, 0, 1, config)
        assert error_deg is not None
        assert error_deg < 1.0
        # too few to be found
        few = [frames[0], first_five(frames[1])]
        assert guided_error_deg(scene, few, 0, 1, config) is None


def first_five(all_of: StereoFeatures) -> StereoFeatures:
    five = slice(0, 5)
    return StereoFeatures(
        all_of.uvd_px[five],
        all_of.sigma_px[five],
        all_of.p_R[five],
        all_of.scale_px[five],
        all_of.descriptors[five],
    )


def test_a_match_is_correct_when_both_features_show_one_place() -> None:
    p_Ga = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [np.nan] * 3])
    p_Gb = np.array([[0.1, 0.004, 0.0], [0.0, 0.006, 0.0], [np.nan] * 3])
    matches = Matches(np.array([[1, 0], [0, 1], [2, 2]]), np.ones(3))
    assert correct(matches, p_Ga, p_Gb).tolist() == [True, False, False]


def test_residuals_with_the_noise_that_features_claim_have_unit_variance(sequence: StereoSequence) -> None:
    rng = np.random.default_rng(2)
    rectifier = make_rectifier(sequence.calibration)
    rig = rectifier.rig
    p_G = rng.uniform(-0.1, 0.1, (4000, 3))
    X_RG = [make_pose(exp_so3(np.array([0.1, 0.5 * k, -0.2 * k])), [0.0, 0.0, 0.7]) for k in (0, 1)]
    sigma = np.tile([0.3, 0.2, 0.1], (4000, 1))

    def seen(X: Array) -> StereoFeatures:
        uvd = rig.project(transform_points(X, p_G)) + sigma * rng.normal(size=(4000, 3))
        return StereoFeatures(
            uvd, sigma, rig.triangulate(uvd), np.ones(4000), np.zeros((4000, 1), np.float32)
        )

    scene = UnseenScene(sequence, rectifier, None, np.linalg.inv(np.array(X_RG)))  # type: ignore[arg-type]
    index = np.repeat(np.arange(4000)[:, None], 2, axis=1)
    squares = normalised_squares(scene, index, seen(X_RG[0]), seen(X_RG[1]), 0, 1)
    assert squares[3] == 4000
    np.testing.assert_allclose(residual_variances([{"squares": squares}]), 1.0, atol=0.08)


def pair(
    confidence: list[float], right: list[int], error_deg: float | None = 0.1, features: int = 99
) -> Case:
    return {
        "confidence": confidence,
        "right": right,
        "matches": len(right),
        "correct": sum(right),
        "error_deg": error_deg,
        "features": features,
    }


def test_matches_are_counted_down_to_the_confidence_that_keeps_the_precision() -> None:
    pairs = [pair([0.9, 0.7, 0.5, 0.3], [1, 1, 0, 1]), pair([0.8, 0.3, 0.1], [1, 1, 0])]
    assert precision_of(pairs) == pytest.approx(5 / 7)
    # In order: 1 1 1 0 (1 1) 0; the two of one confidence come together.
    assert correct_at(pairs, 0.99) == 3 / 2
    assert correct_at(pairs, 0.8) == 5 / 2
    assert correct_at(pairs, 0.0) == 5 / 2
    assert correct_at([pair([], [])], 0.5) == 0.0
    assert correct_at([pair([0.9], [0])], 0.5) == 0.0


def test_pairs_with_few_features_are_not_expected_to_move() -> None:
    pairs = [pair([], [], 1.0), pair([], [], 3.0), pair([], [], None), pair([], [], None, features=29)]
    assert success(pairs, 2.0) == pytest.approx(1 / 3)
    assert success(pairs, 5.0) == pytest.approx(2 / 3)
    assert success(pairs, 2.0, least_features=0) == pytest.approx(1 / 4)


def test_pairs_with_light_in_common_are_found_by_their_frames() -> None:
    lit = lit_pairs([{"case": {"light": "bus"}, "pairs": [[0, 1, 9000], [1, 2, 50], [0, 2, 4000]]}])
    assert lit == {"bus": {(0, 1), (0, 2)}}
    line: Case = {
        "case": {"scene": "bus"},
        "pairs": [{"gap": 1, "n": 0}, {"gap": 1, "n": 1}, {"gap": 2, "n": 2}],
    }
    assert [pair["n"] for gap in (1, 2) for pair in lit_of([line], gap, lit)] == [0, 2]
