"""Batches of lit views, the loss, the scores, and the command from the bodies to the weights."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from polhode.cli.main import main
from polhode.config.train_settings import Corpus
from polhode.frontend.features.judgement import surface_network
from polhode.frontend.networks.surface import SurfaceNet
from polhode.train.curves import read_curves
from polhode.train.surface.batches import ViewBatches, outcomes
from polhode.train.surface.lit_views import SKY, LitViews
from polhode.train.surface.scores import judge_views, score
from polhode.train.surface.scores import main as print_scores
from polhode.train.surface.task import place_loss
from tests.train.surface.conftest import SURFACE


@pytest.fixture
def surface_file(lit_corpus: Corpus, tmp_path: Path) -> Path:
    """A configuration that trains for a few steps."""
    path = tmp_path / "train.yaml"
    path.write_text(
        f"""seed: 2
runtime: {{workers: 1}}
train:
  task: surface
  output: {tmp_path / "out"}
  corpus: {lit_corpus.model_dump_json()}
  surface: {SURFACE.model_dump_json()}
  schedule: {{steps: 16, warmup_steps: 2, validate_every: 100, log_every: 1}}
"""
    )
    return path


def test_a_point_of_a_batch_shows_the_pixel_that_it_showed_before(lit_views: LitViews) -> None:
    """Cut, mirrored and turned: the brightness at the points follows, by one gain for each image."""
    batches = ViewBatches({0: lit_views}, SURFACE, 1)
    for step in range(4):
        batch = batches.batch(step)
        pixel = batch["uv"].round().long()
        on_target = batch["light"][batch["owner"], pixel[:, 1] // 2, pixel[:, 0] // 2] != SKY
        assert on_target.float().mean() > 0.9
        assert int(batch["uv"].min()) >= 0 and float(batch["uv"].max()) <= SURFACE.crop_px - 1
        # matches of the batch are those of the store: the true place and the match agree to 3 px
        assert float(batch["square"].amax()) < 9.0
        assert bool((batch["owner"][batch["first"]] != batch["owner"][batch["second"]]).all())


def test_outcomes_count_other_images_that_are_lit(lit_views: LitViews) -> None:
    seen, found = outcomes(lit_views)
    assert np.all(found <= seen) and seen.max() <= len(lit_views.grey) - 1
    assert 0.05 < found.sum() / seen.sum() < 0.95


def test_the_place_loss_is_least_at_the_true_scatter() -> None:
    generator = torch.Generator().manual_seed(3)
    off = 0.4 * torch.randn(4000, 2, generator=generator)
    first = torch.zeros(4000, dtype=torch.int64)
    batch = {"first": first, "second": first + 1, "square": (off**2).sum(dim=1)}
    # both points have the same scatter, 0.4 px is that of their difference
    losses = {
        sigma: float(place_loss(torch.full((2,), sigma / np.sqrt(2.0)).log(), batch))
        for sigma in (0.2, 0.35, 0.4, 0.45, 0.8)
    }
    assert min(losses, key=losses.__getitem__) == 0.4


def test_an_untrained_network_scores_as_chance(lit_views: LitViews) -> None:
    torch.manual_seed(1)
    scores = score(SurfaceNet().eval(), {0: lit_views})
    assert 0.3 < scores["auc"] < 0.7
    assert 0.3 < scores["auc_sharpness"] < 0.7
    assert 0.0 <= scores["shadow_iou"] < 0.8


def test_the_command_trains_learns_and_resumes_to_the_same_weights(
    surface_file: Path, tmp_path: Path, lit_views: LitViews, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(surface_file)]) == 0
    weights = tmp_path / "out" / "surface.safetensors"
    light = read_curves(tmp_path / "out")["train/light"][:, 1]
    assert light[-5:].mean() < 0.8 * light[:3].mean()
    scores = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert scores["finished"] is True and "normalised_variance" in scores["scores"]
    judged = judge_views(surface_network(weights), lit_views)
    assert np.all((judged.probability > 0) & (judged.probability < 1)) and np.all(judged.sigma_px > 0)
    parts = ["train", str(surface_file), f"--train.output={tmp_path / 'parts'}"]
    assert main([*parts, "--train.schedule.time-limit-s=0.5"]) == 0
    assert main(parts) == 0
    assert (tmp_path / "parts" / "surface.safetensors").read_bytes() == weights.read_bytes()
    capsys.readouterr()
    print_scores([str(surface_file), "--weights", str(weights), "--workers", "1"])
    table = capsys.readouterr().out.splitlines()
    assert table[0].startswith("| body | auc |") and [row.split("|")[1].strip() for row in table[2:]] == [
        "0",
        "1",
        "all",
    ]
