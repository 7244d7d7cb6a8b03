"""Patch pairs, their loss and scores, and the command from the corpus to the weights."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from torch.nn import functional

from frontend.networks.describe import descriptor_network
from frontend.networks.descriptor import Described
from frontend.patches import cut_patches, tangent_affines, turned
from pipeline.cli import main
from polhode.config.train import Corpus, DescriptorTraining
from polhode.lie import exp_so3
from polhode.progress import Silent
from train.checkpoint import CHECKPOINT
from train.curves import read_curves
from train.descriptor_loss import descriptor_loss, turned_alike
from train.descriptor_scores import area_under_curve, make_trials, score
from train.patch_batches import PatchBatches, rig_of, turn_of
from train.points import REPEAT_PX, ScenePoints, place_in, prepare_points
from train.surface_turn import turn_between
from train.task import Batch

EXACT = DescriptorTraining(
    batch=60, frame_pairs=2, normal_noise_deg=0.0, fronto_parallel=0.0, place_noise_px=0.0, scale_noise=0.0
)


@pytest.fixture(scope="module")
def points(tiny_corpus: Corpus) -> ScenePoints:
    return prepare_points(tiny_corpus, [0], Silent(), 1)[0]


def correlation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Normalised correlation (n,) of patches (n, 1, s, s)."""
    a, b = (each.reshape(len(each), -1) - each.mean(axis=(1, 2, 3))[:, None] for each in (a, b))
    norm = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray((a * b).sum(axis=1) / np.maximum(norm, 1e-6))


def test_points_found_again_are_at_the_true_place(points: ScenePoints) -> None:
    found = np.flatnonzero(points.again >= 0)
    assert len(found) > 200
    off_px = np.linalg.norm(points.uv_px[points.again[found]] - points.uv_other_px[found], axis=1)
    assert off_px.max() < REPEAT_PX
    p, normal = place_in(points, found)
    projected = p[:, :2] / p[:, 2:] * points.focal_px + points.centre_px
    assert np.median(np.linalg.norm(projected - points.uv_other_px[found], axis=1)) < 0.2
    assert (np.einsum("nk,nk->n", p, normal) < 0).mean() > 0.99


def test_patches_cut_along_the_surface_look_alike_in_both_frames(points: ScenePoints) -> None:
    calm = ~points.on_rim & ~points.on_shadow
    found = np.flatnonzero((points.again >= 0) & calm[points.point] & (points.angle_rad < np.deg2rad(30)))
    a, b = points.frame[points.point[found[0]]], points.other[found[0]]
    found = found[(points.frame[points.point[found]] == a) & (points.other[found] == b)]
    own, rig = points.point[found], rig_of(points)
    half_m = np.full(len(found), 12.0 * np.median(points.p_K[own, 2]) / float(points.focal_px))
    affine_a = tangent_affines(points.p_K[own], points.normal_K[own], rig, half_m)
    p_b, normal_b = place_in(points, found)
    affine_b = tangent_affines(p_b, normal_b, rig, half_m)
    R_ba = np.broadcast_to(turn_of(points, a, b), (len(found), 3, 3))
    turn = turn_between(affine_a, affine_b, points.p_K[own], points.normal_K[own], R_ba, p_b, rig)
    patch_a = cut_patches(points.grey[a], points.uv_px[own], affine_a)
    straight = cut_patches(points.grey[b], points.uv_other_px[found], turned(affine_b, turn))
    askew = cut_patches(points.grey[b], points.uv_other_px[found], turned(affine_b, turn + np.pi))
    assert np.median(correlation(patch_a, straight)) > 0.75
    assert np.median(correlation(patch_a, askew)) < 0.4


def test_a_roll_of_the_camera_is_the_turn_of_the_patch(points: ScenePoints) -> None:
    p, normal = np.array([[0.0, 0.0, 0.8]]), np.array([[0.0, 0.0, -1.0]])
    affine = tangent_affines(p, normal, rig_of(points), np.array([0.02]))
    for roll in (-2.0, 0.3, 1.5):
        R_ba = exp_so3(np.array([0.0, 0.0, roll]))[None]
        found = turn_between(affine, affine, p, normal, R_ba, p, rig_of(points))
        assert found == pytest.approx([roll])


def test_a_batch_depends_on_seed_and_step_alone(points: ScenePoints) -> None:
    first, second = (PatchBatches({0: points}, EXACT, 1) for _ in range(2))
    second.batch(3)
    a, b = first.batch(7), second.batch(7)
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert not torch.equal(a["patches"][:10], first.batch(8)["patches"][:10])


def test_a_batch_has_pairs_and_strays(points: ScenePoints) -> None:
    batch = PatchBatches({0: points}, EXACT, 1).batch(0)
    m, k = len(batch["pair"]), len(batch["strays"])
    assert 30 <= m <= 60
    assert 0 < k <= 16
    assert batch["patches"].shape == (2 * m + k, 1, 32, 32)
    assert batch["turn"].shape == (m,)


def made_up(m: int, strays: int) -> Batch:
    place = torch.arange(m)[:, None] * torch.tensor([[20.0, 0.0]])
    return {
        "pair": torch.zeros(m, dtype=torch.int64),
        "strays": torch.zeros(strays, dtype=torch.int64),
        "uv_a": place,
        "uv_b": place,
        "turn": torch.full((m,), 0.5),
    }


def described(descriptor: torch.Tensor, turn_rad: float) -> Described:
    m = len(descriptor)
    angle = torch.cat([torch.zeros(m), torch.full((m,), turn_rad), torch.zeros(1)])
    whole = torch.cat([descriptor, descriptor, functional.normalize(torch.ones(1, 16), dim=1)])
    direction = torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)
    return Described(whole, torch.zeros(2 * m + 1), direction)


def test_the_loss_prefers_what_is_right() -> None:
    generator = torch.Generator().manual_seed(2)
    eye, batch, temperature = torch.eye(16)[:8], made_up(8, 1), torch.tensor(0.07)
    mixed = functional.normalize(torch.randn(8, 16, generator=generator).abs(), dim=1)
    right, terms = descriptor_loss(described(eye, 0.5), batch, temperature, EXACT)
    alike, _ = descriptor_loss(described(mixed, 0.5), batch, temperature, EXACT)
    askew, _ = descriptor_loss(described(eye, 2.0), batch, temperature, EXACT)
    assert float(terms["rank_1"]) == 1.0
    assert float(terms["direction"]) == pytest.approx(0.0, abs=1e-6)
    assert float(right) < float(askew) < float(alike) + 1.0
    assert float(right) < float(alike)


def test_neighbours_are_no_negatives() -> None:
    """Two points at one place may have one descriptor."""
    batch, temperature = made_up(8, 1), torch.tensor(0.07)
    batch["uv_a"] = batch["uv_a"].clone()
    twins = torch.eye(16)[:8].clone()
    twins[1] = twins[0]
    apart, _ = descriptor_loss(described(twins, 0.5), batch, temperature, EXACT)
    batch["uv_a"][1] = batch["uv_a"][0] + 1.0
    near, _ = descriptor_loss(described(twins, 0.5), batch, temperature, EXACT)
    assert float(near) < float(apart) - 0.1


def test_directions_are_compared_with_the_true_turn() -> None:
    first = torch.tensor([[1.0, 0.0], [0.0, 1.0]])
    second = torch.tensor([[0.0, 1.0], [0.0, 1.0]])
    assert turned_alike(first, second, torch.full((2,), torch.pi / 2)).tolist() == pytest.approx(
        [1.0, 0.0], abs=1e-6
    )


def test_scores_of_a_perfect_and_of_a_blind_descriptor(points: ScenePoints) -> None:
    trials = make_trials({0: points}, 1)
    assert trials
    blind = score(
        trials, lambda p: (np.ones((len(p), 1)), np.zeros(len(p)), np.tile([1.0, 0.0], (len(p), 1)))
    )
    assert blind["rank_1_at_30"] < 0.05 < blind["rootsift_at_30"] <= blind["rootsift_common_at_30"]
    assert blind["straight_at_30"] < 0.3
    assert 0.3 < blind["reliability_auc"] < 0.7


def test_area_under_curve() -> None:
    assert area_under_curve(np.array([0.1, 0.2, 0.8, 0.9]), np.array([False, False, True, True])) == 1.0
    assert area_under_curve(np.array([0.9, 0.2, 0.8, 0.1]), np.array([True, False, False, True])) == 0.5
    assert area_under_curve(np.array([0.9, 0.2]), np.array([True, True])) == 0.5


def test_the_command_trains_and_resumes_to_the_same_weights(training_file: Path, tmp_path: Path) -> None:
    assert main(["train", str(training_file)]) == 0
    whole = tmp_path / "out" / "descriptor.safetensors"
    descriptor_network(whole)
    with safe_open(whole, "pt") as header:
        assert header.metadata()["steps"] == "6 of 6"
    scores = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert scores["finished"] is True
    assert "rank_1_at_30" in scores["scores"]
    parts = ["train", str(training_file), f"--train.output={tmp_path / 'parts'}"]
    for _ in range(6):
        assert main([*parts, "--train.schedule.time-limit-s=1e-6"]) == 0
    assert (tmp_path / "parts" / CHECKPOINT).is_file()
    assert (tmp_path / "parts" / "descriptor.safetensors").read_bytes() == whole.read_bytes()


def test_the_loss_falls(training_file: Path, tmp_path: Path) -> None:
    longer = [
        "--train.schedule.steps=40",
        "--train.schedule.warmup-steps=4",
        "--train.schedule.learning-rate=2e-3",
    ]
    assert main(["train", str(training_file), *longer]) == 0
    contrast = read_curves(tmp_path / "out")["train/contrast"][:, 1]
    assert contrast[-8:].mean() < 0.85 * contrast[:4].mean()


WRONG = {
    "unknown key": ("--train.schedul.steps=3", "unknown key 'train.schedul'; did you mean schedule?"),
    "no steps": (
        "--train.schedule.steps=0",
        "key 'train.schedule.steps': must be greater than or equal to 1",
    ),
    "unknown task": ("--train.task=masks", "key 'train.task': expected one of descriptor, depth"),
    "unknown family": ("--train.corpus.families=teapot", "expected a list, each one of free_flyer, bus"),
    "range upside down": ("--train.corpus.turn-deg 50 15", "turn_deg is (least, most), got 50, 15"),
    "other corpus": ("--train.corpus.seed=99", "holds a corpus with another seed"),
    "no held-out bodies": ("--train.corpus.validation-every=9", "hold out none"),
    "output is a file": ("--train.output=/dev/null", "train.output: /dev/null cannot be made"),
}


@pytest.mark.parametrize(("words", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_setting_is_one_line_and_exit_code_2(
    words: str, message: str, training_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(training_file), *words.split()]) == 2
    stderr = capsys.readouterr().err
    assert message in stderr
    assert stderr.count("\n") == 1


def test_a_configuration_without_training_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("seed: 1\n")
    assert main(["train", str(config)]) == 2
    assert "no 'train' section; see configs/train/" in capsys.readouterr().err
