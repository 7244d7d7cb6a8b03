"""Patch pairs, their loss and scores, and the command from the corpus to the weights."""

import json
import shutil
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from safetensors import safe_open
from torch.nn import functional

from polhode.cli.main import main
from polhode.config.train_settings import Corpus, DescriptorTraining
from polhode.frontend.features.patch_descriptors import descriptor_network
from polhode.frontend.features.patches import cut_patches, rotate_affines, tangent_affines, upright_affines
from polhode.frontend.matching.matchers import DualSoftmax
from polhode.frontend.networks.descriptor import DescriptorOutput
from polhode.frontend.networks.weights import shipped_path
from polhode.geometry.lie import exp_so3
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.checkpoint import CHECKPOINT
from polhode.train.descriptor.batches import (
    PatchBatches,
    SurfacePoints,
    correlation,
    patch_rotation,
    same_appearance,
    scene_rig,
)
from polhode.train.descriptor.scores import area_under_curve, dominant_angles, score, validation_pairs
from polhode.train.descriptor.surface_points import REPEAT_PX, ScenePoints, points_path, prepare_points
from polhode.train.descriptor.task import Heads, descriptor_loss, matching_loss, rotation_agreement
from polhode.train.task import Batch
from tests.train.curves import read_curves

EXACT = DescriptorTraining(
    batch=60, frame_pairs=2, normal_noise_deg=0.0, fronto_parallel=0.0, place_noise_px=0.0
)


@pytest.fixture(scope="module")
def points(tiny_corpus: Corpus) -> ScenePoints:
    return prepare_points(tiny_corpus, [0], Silent(), 1)[0]


def test_points_found_again_are_at_the_true_place(points: ScenePoints) -> None:
    found = np.flatnonzero(points.again >= 0)
    assert len(found) > 200
    off_px = np.linalg.norm(points.uv_px[points.again[found]] - points.uv_other_px[found], axis=1)
    assert off_px.max() < REPEAT_PX
    own, b = points.point[found], points.other[found]
    X_BA = points.X_KG[b] @ np.linalg.inv(points.X_KG[points.frame[own]])
    p_B = np.einsum("nij,nj->ni", X_BA[:, :3, :3], points.p_K[own]) + X_BA[:, :3, 3]
    projected = p_B[:, :2] / p_B[:, 2:] * points.focal_px + points.centre_px
    assert np.median(np.linalg.norm(projected - points.uv_other_px[found], axis=1)) < 0.2
    assert (np.einsum("nk,nk->n", points.p_K[own], points.normal_K[own]) < 0).mean() > 0.99


def test_points_that_look_alike_are_those_whose_patches_agree(points: ScenePoints) -> None:
    """Turned by the true motion, patches of the tangent plane correlate; coincidences do not."""
    same, found = same_appearance(points), points.again >= 0
    assert not (same & ~found).any()
    assert 0.3 < same[found].mean() < 0.98
    near, far = points.angle_rad < np.deg2rad(25), points.angle_rad > np.deg2rad(50)
    assert same[found & near].mean() > same[found & far].mean()
    calm = ~(points.on_rim | points.on_shadow)[points.point]
    assert same[found & near & calm].mean() > 0.7
    # the exposure does not matter
    patch = np.random.default_rng(1).uniform(40, 250, (3, 1, 32, 32)).astype(np.float32)
    assert correlation(patch, 0.5 * patch) == pytest.approx(np.ones(3), abs=0.01)
    assert np.abs(correlation(patch, patch[::-1].copy())[[0, 2]]).max() < 0.2


def test_a_roll_of_the_camera_is_the_turn_of_the_patch(points: ScenePoints) -> None:
    p, normal = np.array([[0.0, 0.0, 0.8]]), np.array([[0.0, 0.0, -1.0]])
    affine = tangent_affines(p, normal, scene_rig(points), np.array([0.02]))
    for roll in (-2.0, 0.3, 1.5):
        at, R_ba = SurfacePoints(np.zeros((1, 2)), p, normal), exp_so3(np.array([0.0, 0.0, roll]))
        assert patch_rotation(affine, affine, at, p, R_ba, scene_rig(points)) == pytest.approx([roll])


def test_the_dominant_angle_turns_with_the_patch(points: ScenePoints) -> None:
    uv = points.uv_px[points.frame == 0][:60]
    upright = upright_affines(np.full(len(uv), 12.0))
    turned = rotate_affines(upright, np.full(len(uv), 0.7))
    first, second = (dominant_angles(cut_patches(points.grey[0], uv, maps)) for maps in (upright, turned))
    assert np.mean(np.abs(np.angle(np.exp(1j * (first - second - 0.7)))) < 0.1) > 0.6


def test_a_batch_has_pairs_and_distractors_by_seed_and_step_alone(points: ScenePoints) -> None:
    first, second = (PatchBatches({0: points}, EXACT, 1) for _ in range(2))
    second.batch(3)
    a, b = first.batch(7), second.batch(7)
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert not torch.equal(a["patches"][:10], first.batch(8)["patches"][:10])
    m, k = len(a["pair"]), len(a["distractors"])
    assert 30 <= m <= 60 and 0 < k <= 16
    assert a["patches"].shape == (2 * m + k, 1, 32, 32) and a["rotation"].shape == (m,)


def made_up(m: int) -> Batch:
    """m pairs of two frames, and a distractor."""
    place = torch.arange(m)[:, None] * torch.tensor([[20.0, 0.0]])
    generator = torch.Generator().manual_seed(4)
    X_AB = torch.eye(4)
    X_AB[:3, :3] = torch.from_numpy(exp_so3(np.array([0.3, -0.2, 0.5])))
    X_AB[:3, 3] = torch.tensor([0.1, 0.0, 0.6])
    p_b = torch.rand(m, 3, generator=generator)
    return {
        "pair": torch.zeros(m, dtype=torch.int64),
        "distractors": torch.zeros(1, dtype=torch.int64),
        "uv_a": place,
        "uv_b": place,
        "rotation": torch.full((m,), 0.5),
        "p_a": p_b @ X_AB[:3, :3].T + X_AB[:3, 3],
        "p_b": p_b,
        "p_distractor": torch.rand(1, 3, generator=generator),
        "X_AB": X_AB[None],
        "late": torch.tensor(1.0),
    }


def described(descriptor: torch.Tensor, turn_rad: float) -> DescriptorOutput:
    m = len(descriptor)
    angle = torch.cat([torch.zeros(m), torch.full((m,), turn_rad), torch.zeros(1)])
    whole = torch.cat([descriptor, descriptor, functional.normalize(torch.ones(1, 16), dim=1)])
    direction = torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)
    return DescriptorOutput(whole, torch.zeros(2 * m + 1), direction)


def test_the_loss_prefers_what_is_right() -> None:
    eye, batch, heads = torch.eye(16), made_up(8), Heads()
    mixed = functional.normalize(torch.randn(8, 16, generator=torch.Generator().manual_seed(2)).abs(), dim=1)
    right, terms = descriptor_loss(described(eye[:8], 0.5), batch, heads)
    assert float(terms["rank_1"]) == 1.0
    assert float(terms["direction"]) == pytest.approx(0.0, abs=1e-6)
    for wrong in (described(mixed, 0.5), described(eye[:8], 2.0)):
        assert right.item() < descriptor_loss(wrong, batch, heads)[0].item()
    # the motion of right matches is the true one
    batch = made_up(12)
    assert matching_loss(described(eye[:12], 0.5), batch, heads.matcher)[1].item() < 1e-4
    batch["X_AB"] = torch.eye(4)[None]
    assert matching_loss(described(eye[:12], 0.5), batch, heads.matcher)[1].item() > 0.3
    # a direction is compared with the true turn
    first, second = torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([[0.0, 1.0], [0.0, 1.0]])
    agreement = rotation_agreement(first, second, torch.full((2,), torch.pi / 2))
    assert agreement.tolist() == pytest.approx([1.0, 0.0], abs=1e-6)


def test_frame_pairs_do_not_see_each_other() -> None:
    """The losses of two frame pairs of different sizes are the means of those of each alone."""
    generator = torch.Generator().manual_seed(6)
    alone, looks, matcher = [], [], DualSoftmax(temperature=0.2)
    for m in (9, 14):
        batch = made_up(m)
        batch["p_a"] = batch["p_a"] + 0.05 * torch.randn(m, 3, generator=generator)
        own = [functional.normalize(torch.randn(k, 16, generator=generator), dim=1) for k in (m, m, 1)]
        own[1] = functional.normalize(own[0] + 0.3 * own[1], dim=1)
        alone.append(batch)
        looks.append(own)

    def losses(batch: Batch, parts: list[list[torch.Tensor]]) -> list[float]:
        whole = torch.cat([each for those in zip(*parts, strict=True) for each in those])
        output = DescriptorOutput(whole, torch.zeros(len(whole)), torch.zeros(len(whole), 2))
        return [float(each.detach()) for each in matching_loss(output, batch, matcher)]

    names = ("p_a", "p_b", "p_distractor", "X_AB", "uv_a", "uv_b")
    both = {name: torch.cat([batch[name] for batch in alone]) for name in names}
    for name in ("pair", "distractors"):
        both[name] = torch.cat([batch[name] + k for k, batch in enumerate(alone)])
    single = [losses(batch, [own]) for batch, own in zip(alone, looks, strict=True)]
    assert losses(both, looks) == pytest.approx(np.mean(single, axis=0), rel=1e-5)


def test_the_motion_teaches_the_descriptors() -> None:
    """A step down the motion's gradient lowers the weight of a wrong match, and with it the loss."""
    batch, matcher = made_up(12), DualSoftmax(temperature=0.2)
    batch["p_a"][0] += 0.5
    noise = 0.2 * torch.randn(12, 16, generator=torch.Generator().manual_seed(3))
    start = (torch.eye(16)[:12] + noise).requires_grad_()

    def motion(raw: torch.Tensor) -> torch.Tensor:
        return matching_loss(described(functional.normalize(raw, dim=1), 0.5), batch, matcher)[1]

    before = motion(start)
    before.backward()
    assert start.grad is not None
    assert float(motion(start.detach() - 0.05 * start.grad / start.grad.norm())) < before.item()


def test_neighbours_are_no_negatives() -> None:
    """Two points at one place may have one descriptor."""
    batch, heads, twins = made_up(8), Heads(), torch.eye(16)[:8].clone()
    batch["uv_a"] = batch["uv_a"].clone()
    twins[1] = twins[0]
    apart, _ = descriptor_loss(described(twins, 0.5), batch, heads)
    batch["uv_a"][1] = batch["uv_a"][0] + 1.0
    near, _ = descriptor_loss(described(twins, 0.5), batch, heads)
    assert near.item() < apart.item() - 0.1


def test_a_blind_descriptor_scores_by_chance(points: ScenePoints) -> None:
    trials = validation_pairs({0: points}, 1)

    def see_nothing(patches: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        n = len(patches)
        return np.ones((n, 1), dtype=np.float32), np.zeros(n), np.tile([1.0, 0.0], (n, 1))

    blind = score(trials, see_nothing)
    assert blind["rank_1_at_30"] < 0.05 < blind["rootsift_at_30"] <= blind["rootsift_common_at_30"]
    assert blind["straight_at_30"] < 0.3 and 0.3 < blind["reliability_auc"] < 0.7
    assert area_under_curve(np.array([0.1, 0.2, 0.8, 0.9]), np.array([False, False, True, True])) == 1.0
    assert area_under_curve(np.array([0.9, 0.2, 0.8, 0.1]), np.array([True, False, False, True])) == 0.5
    assert area_under_curve(np.array([0.9, 0.2]), np.array([True, True])) == 0.5


def test_the_command_trains_and_resumes_to_the_same_weights(training_file: Path, tmp_path: Path) -> None:
    assert main(["train", str(training_file)]) == 0
    whole = tmp_path / "out" / "descriptor.safetensors"
    descriptor_network(whole)
    with safe_open(whole, "pt") as header:
        assert json.loads(header.metadata()["training"])["steps"] == "3 of 3"
    scores = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert scores["finished"] is True and "rank_1_at_30" in scores["scores"]
    parts = ["train", str(training_file), f"--train.output={tmp_path / 'parts'}"]
    assert main([*parts, "--train.schedule.time-limit-s=1e-6"]) == 0
    assert (tmp_path / "parts" / CHECKPOINT).is_file()
    assert main(parts) == 0
    assert (tmp_path / "parts" / "descriptor.safetensors").read_bytes() == whole.read_bytes()


def test_training_starts_from_given_weights(
    training_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a learning rate of nearly nothing the weights stay what they were."""
    shipped = shipped_path("descriptor")
    still = [f"--train.start-from={shipped}", "--train.schedule.learning-rate=1e-9"]
    assert main(["train", str(training_file), *still]) == 0
    started = descriptor_network(tmp_path / "out" / "descriptor.safetensors")
    for got, wanted in zip(started.parameters(), descriptor_network(shipped).parameters(), strict=True):
        torch.testing.assert_close(got, wanted, atol=1e-6, rtol=0.0)
    capsys.readouterr()
    assert main(["train", str(training_file), "--train.start-from=nowhere.safetensors"]) == 2
    assert "train.start_from: nowhere.safetensors is no file" in capsys.readouterr().err


def test_changed_settings_are_refused_before_the_corpus_is_rendered(
    training_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def written() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}

    assert main(["train", str(training_file)]) == 0
    before = written()
    monkeypatch.setattr("polhode.train.descriptor.task.render_corpus", Mock(side_effect=AssertionError))
    capsys.readouterr()
    for more, expected in {
        "--train.corpus.scenes=5": "a training with another corpus.scenes: choose another train.output",
        "--train.schedule.device=cuda": "torch finds no GPU",
    }.items():
        if "cuda" in more and torch.cuda.is_available():
            continue
        assert main(["train", str(training_file), more]) == 2
        assert expected in capsys.readouterr().err
    assert written() == before
    (tmp_path / "out" / CHECKPOINT).write_bytes(b"damaged")
    assert main(["train", str(training_file)]) == 2
    assert f"{CHECKPOINT} cannot be read" in capsys.readouterr().err


def test_input_that_is_refused_amid_the_work_leaves_no_folder(
    training_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refusal = Mock(side_effect=InputError("no pair shows a target"))
    monkeypatch.setattr("polhode.train.run.make_task", refusal)
    assert main(["train", str(training_file)]) == 2
    assert "no pair shows a target" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_points_of_another_scene_are_made_again(
    tiny_corpus: Corpus, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    corpus = tiny_corpus.model_copy(update={"folder": str(tmp_path / "corpus")})
    shutil.copytree(tiny_corpus.folder, corpus.folder)
    shutil.rmtree(Path(corpus.folder) / "points", ignore_errors=True)
    paths = [points_path(corpus, i) for i in range(2)]
    first = prepare_points(corpus, range(2), Silent(), 1)
    paths[0].rename(tmp_path / "aside")
    shutil.copy(paths[1], paths[0])
    again = prepare_points(corpus, range(2), Silent(), 1)
    assert f"{paths[0]}: was made from another scene; it is made again" in caplog.text
    assert np.array_equal(again[0].grey, first[0].grey) and not np.array_equal(first[0].grey, first[1].grey)
    made = [path.stat().st_mtime_ns for path in paths]
    prepare_points(corpus, range(2), Silent(), 1)
    assert [path.stat().st_mtime_ns for path in paths] == made
    paths[0].write_bytes(paths[0].read_bytes()[:-40])
    with pytest.raises(InputError, match=rf"{paths[0]}: .*; remove this file, and it is made again"):
        prepare_points(corpus, range(2), Silent(), 1)


def test_the_loss_falls(training_file: Path, tmp_path: Path) -> None:
    schedule = {"steps": "30", "warmup-steps": "4", "learning-rate": "2e-3"}
    longer = [f"--train.schedule.{key}={value}" for key, value in schedule.items()]
    assert main(["train", str(training_file), *longer]) == 0
    contrast = read_curves(tmp_path / "out")["train/contrast"][:, 1]
    assert contrast[-8:].mean() < 0.85 * contrast[:4].mean()


WRONG = {
    "unknown key": ("--train.schedul.steps=3", "unknown key 'train.schedul'; did you mean schedule?"),
    "no steps": ("--train.schedule.steps=0", "key 'train.schedule.steps': must be at least 1"),
    "unknown task": ("--train.task=masks", "key 'train.task': expected one of descriptor, depth"),
    "unknown family": ("--train.corpus.families=teapot", "expected a list, each one of free_flyer, bus"),
    "range upside down": ("--train.corpus.turn-deg 50 15", "turn_deg is (smallest, largest), got 50, 15"),
    "other corpus": ("--train.corpus.seed=99", "contains a corpus with another seed"),
    "no held-out bodies": ("--train.corpus.validation-every=9", "hold out none"),
    "output is a file": ("--train.output=/dev/null", "train.output: /dev/null is a device or a pipe"),
}


@pytest.mark.parametrize(("words", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_setting_is_one_line_and_exit_code_2(
    words: str, message: str, training_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(training_file), *words.split()]) == 2
    stderr = capsys.readouterr().err
    assert message in stderr and stderr.count("\n") == 1
    training_file.write_text("seed: 1\n")
    assert main(["train", str(training_file)]) == 2
    assert "no 'train' section; see configs/train/" in capsys.readouterr().err
