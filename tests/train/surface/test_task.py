"""Batches and the loss of the surface network: targets are at the true places, terms are what they say."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch.nn.functional import one_hot

from polhode.config.train_settings import Corpus, MoreBodies, Schedule, SurfaceTraining, Train
from polhode.frontend.networks.surface import CHANNELS, DenseOutput, SurfaceNet
from polhode.geometry.lie import transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.run import setting_of
from polhode.train.surface.batches import NEAR_PX, batch_of, draw_example
from polhode.train.surface.landmarks import KnownBody, Landmarks, corpus_of
from polhode.train.surface.scores import score_trials, trials_of
from polhode.train.surface.task import (
    NEXT_CORPUS,
    SurfaceTask,
    consistency_loss,
    light_loss,
    make_task,
    place_at,
    place_loss,
    score_loss,
    student_nll,
    surface_point,
)
from polhode.train.task import Batch
from polhode.train.training_loop import TrainingLoop
from tests.train.surface.conftest import CONFIG


@pytest.fixture(scope="module")
def batch(bodies: dict[int, KnownBody]) -> Batch:
    rng = np.random.default_rng(4)
    examples = [draw_example(bodies[k], rng, 96, CONFIG.kinds) for k in (0, 1)]
    return batch_of([each for each in examples if each is not None], 40, rng)


def test_places_of_the_batch_are_landmarks_that_both_images_show(batch: Batch) -> None:
    image, row, column = batch["near"].T
    assert torch.linalg.vector_norm(batch["place"], dim=1).max() < NEAR_PX
    at, strict = torch.stack([column, row], dim=1) + batch["place"], batch["is_strict"]
    assert strict.any() and not strict.all()
    for pair, uv in zip(batch["pair"][strict], batch["uv_a"][strict], strict=True):
        assert torch.linalg.vector_norm(at[image == 2 * pair] - uv, dim=1).min() < 1e-2
    for k, X_AB in enumerate(batch["X_AB"]):
        own = batch["pair"] == k
        moved = transform_points(X_AB.numpy(), batch["p_b"][own].numpy())
        np.testing.assert_allclose(moved, batch["p_a"][own].numpy(), atol=1e-4)
    # points lie on their planes and rays
    on_plane = (batch["plane_a"] * batch["p_a"]).sum(dim=1)
    torch.testing.assert_close(on_plane, torch.ones_like(on_plane), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(surface_point(batch["uv_a"], batch, "a"), batch["p_a"], rtol=1e-3, atol=1e-4)


def test_the_loss_of_what_is_known_is_small(batch: Batch) -> None:
    images, _, height, width = batch["images"].shape
    offset = torch.zeros(images, 2, height, width)
    image, row, column = batch["near"].T
    offset[image, :, row, column] = batch["place"]
    # what a network that knows all places would say, and one that knows nothing
    known = DenseOutput(
        score=torch.where(batch["heat"] >= 1.0, 9.0, -9.0),
        offset_px=offset,
        log_sigma=torch.full((images, height, width), -2.0),
        light=9.0 * one_hot(batch["light"].long().clamp(max=3), 4).permute(0, 3, 1, 2).float(),
        channels=torch.zeros(images, CHANNELS, height, width),
    )
    blank = known._replace(
        score=torch.zeros_like(known.score),
        offset_px=torch.zeros_like(offset),
        light=torch.zeros_like(known.light),
    )
    assert score_loss(known.score, batch["heat"], batch["weight"]) < 1e-3
    assert score_loss(blank.score, batch["heat"], batch["weight"]) > 0.1
    assert light_loss(known.light, batch["light"]) < 0.01
    assert light_loss(blank.light, batch["light"]) == pytest.approx(np.log(4.0), rel=1e-3)
    assert place_loss(known, batch) < place_loss(blank, batch) - 0.5
    losses = []
    for dense in (known, blank):
        own = [place_at(dense, batch, side) for side in ("a", "b")]
        losses.append(float(consistency_loss(own, surface_point(own[1][0], batch, "b"), batch)))
    assert losses[0] < losses[1] - 0.5


def test_the_likelihood_is_best_at_the_true_scatter() -> None:
    torch.manual_seed(1)
    off = 0.4 * torch.randn(20000, 2) / torch.sqrt(torch.distributions.Chi2(5.0).sample((20000, 1)) / 5.0)
    guesses = torch.log(torch.tensor([0.3, 0.36, 0.4, 0.44, 0.5]))
    values = [float(student_nll((off**2).sum(dim=1), guess).mean()) for guess in guesses]
    assert int(np.argmin(values)) == 2
    square = torch.tensor([0.1, 1.0, 7.0], dtype=torch.float64, requires_grad=True)
    log_sigma = torch.tensor([-1.0, 0.2, 0.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(student_nll, (square, log_sigma))


def test_the_gradient_of_places_reaches_the_points(batch: Batch) -> None:
    uv = batch["uv_a"].double().requires_grad_()
    doubled = {name: value.double() if value.is_floating_point() else value for name, value in batch.items()}
    assert torch.autograd.gradcheck(lambda places: surface_point(places, doubled, "a"), (uv,), atol=1e-4)


def test_all_terms_are_learned_from(bodies: dict[int, KnownBody]) -> None:
    task = SurfaceTask(bodies, [], CONFIG, 1, 0)
    value, terms = task.loss(task.batch(0))
    assert {"contrast", "motion", "score", "place", "light", "consistency"} <= terms.keys()
    assert all(torch.isfinite(term) for term in (value, *terms.values()))
    value.backward()
    gradients = [weight.grad for weight in task.network.parameters() if weight.grad is not None]
    assert gradients and all(torch.isfinite(each).all() for each in gradients)
    marks = vars(bodies[0].landmarks).values()
    none = Landmarks(*(np.zeros((0, *each.shape[1:]), each.dtype) for each in marks))
    task = SurfaceTask({0: KnownBody(bodies[0].body, none)}, [], CONFIG, 1, 0)
    with pytest.raises(InputError, match="no body has two images with common landmarks"):
        task.batch(0)


def train_of(corpus: Corpus, output: Path, steps: int) -> Train:
    schedule = Schedule(steps=steps, warmup_steps=1, validate_every=100, checkpoint_every=2, log_every=1)
    return Train(task="surface", output=str(output), corpus=corpus, schedule=schedule, surface=CONFIG)


def test_a_training_goes_on_where_it_was_interrupted(lit_body_corpus: Corpus, tmp_path: Path) -> None:
    ends = []
    for name, limits in (("whole", (None,)), ("parts", (1e-9, None))):
        for limit in limits:
            train = train_of(lit_body_corpus, tmp_path / name, 3)
            schedule = train.schedule.model_copy(update={"time_limit_s": limit})
            torch.manual_seed(7)
            task = make_task(train, 7, Silent(), 1)
            outcome = TrainingLoop(task, schedule, tmp_path / name, 7).run({"seed": 7}, Silent())
        assert outcome.finished
        ends.append(task.network.state_dict())
    for name, value in ends[0].items():
        assert torch.equal(value, ends[1][name]), name


def test_held_out_bodies_are_scored_and_those_of_another_corpus_learned_from(
    lit_body_corpus: Corpus, tmp_path: Path
) -> None:
    train = train_of(lit_body_corpus, tmp_path, 1)
    task = make_task(train, 7, Silent(), 1)
    assert task._numbers == [0, 2]
    found = task.validate()
    for kind in ("light", "pose", "both"):
        assert 0.0 <= found[f"rank_1_{kind}"] <= 1.0
    assert {"shadow_iou", "matcher_temperature"} <= found.keys()
    more = MoreBodies(corpus=lit_body_corpus, bodies=1, weight=2)
    train = train.model_copy(update={"surface": CONFIG.model_copy(update={"more": (more,)})})
    assert make_task(train, 7, Silent(), 1)._numbers == [0, 2, NEXT_CORPUS, 2 * NEXT_CORPUS]
    with pytest.raises(InputError, match=r"train.surface.more has 1 entries, and no number 2"):
        corpus_of(train, 2)
    assert setting_of(train, 7)["surface.more.0.bodies"] == 1
    json.dumps(setting_of(train, 7))


def test_scores_of_blobs_do_not_depend_on_the_network(bodies: dict[int, KnownBody]) -> None:
    trials = trials_of({1: bodies[1]}, 3)
    assert {trial.kind for trial in trials} == {"light", "pose", "both"}
    torch.manual_seed(2)
    found = score_trials(SurfaceNet().eval(), trials)
    # blobs of a lit body are found again from another side
    assert found["found_blobs_pose"] > 0.3 and found["scatter_blobs_px_pose"] < 1.0


@pytest.mark.parametrize("kind", range(3))
def test_a_kind_of_pair_differs_in_what_it_says(bodies: dict[int, KnownBody], kind: int) -> None:
    rng, body = np.random.default_rng(9), bodies[0].body
    for wide in (0.0, 1.0):
        example = draw_example(bodies[0], rng, 96, np.eye(3)[kind].tolist(), wide)
        assert example is not None
        a, b = example.views
        assert (body.pose_of(a) == body.pose_of(b)) == (kind == 0)
        assert (body.sun_of(a) == body.sun_of(b)) == (kind == 1)
    with pytest.raises(ValidationError, match=r"kinds add up to 0\.9 instead of 1"):
        SurfaceTraining(kinds=(0.3, 0.3, 0.3))
