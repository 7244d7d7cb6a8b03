"""Batches and the loss of the surface network: targets are at the true places, terms are what they say."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from pydantic import ValidationError
from torch import Tensor
from torch.nn.functional import one_hot

from polhode.config.train_settings import Corpus, MoreBodies, Schedule, SurfaceLoss, SurfaceTraining, Train
from polhode.frontend.networks.surface import CHANNELS, DenseOutput, SurfaceNet
from polhode.frontend.networks.weights import shipped_path
from polhode.geometry.lie import transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.train.run import setting_of
from polhode.train.surface import scores
from polhode.train.surface.batches import NEAR_PX, KnownBody, batch_of, draw_example
from polhode.train.surface.known_bodies import NEXT_ALBEDO, corpus_of
from polhode.train.surface.landmarks import Landmarks
from polhode.train.surface.scores import score_trials, trials_of
from polhode.train.surface.task import (
    NEXT_CORPUS,
    SurfaceTask,
    Views,
    albedo_loss,
    consensus_loss,
    consistency_loss,
    light_loss,
    make_task,
    place_at,
    place_loss,
    score_loss,
    student_nll,
    surface_point,
    views_of,
)
from polhode.train.task import Batch
from polhode.train.training_loop import TrainingLoop
from tests.train.surface.conftest import CONFIG


@pytest.fixture(scope="module")
def batch(bodies: dict[int, KnownBody]) -> Batch:
    rng = np.random.default_rng(4)
    examples = [draw_example(bodies[k], rng, 96, CONFIG.kinds) for k in (0, 1)]
    return batch_of([each for each in examples if each is not None], 40, rng)


def ideal(batch: Batch) -> DenseOutput:
    """What a network that knows all places would say."""
    images, _, height, width = batch["images"].shape
    offset = torch.zeros(images, 2, height, width)
    image, row, column = batch["near"].T
    offset[image, :, row, column] = batch["place"]
    return DenseOutput(
        score=torch.where(batch["heat"] >= 1.0, 9.0, -9.0),
        offset_px=offset,
        log_sigma=torch.full((images, height, width), -2.0),
        light=9.0 * one_hot(batch["light"].long().clamp(max=3), 4).permute(0, 3, 1, 2).float(),
        channels=torch.zeros(images, CHANNELS, height, width),
    )


def test_places_of_the_batch_are_landmarks(batch: Batch) -> None:
    image, row, column = batch["near"].T
    assert torch.linalg.vector_norm(batch["place"], dim=1).max() < NEAR_PX
    at = torch.stack([column, row], dim=1) + batch["place"]
    strict = batch["is_strict"]
    assert strict.any()
    assert not strict.all()
    for pair, uv in zip(batch["pair"][strict], batch["uv_a"][strict], strict=True):
        own = at[image == 2 * pair]
        assert torch.linalg.vector_norm(own - uv, dim=1).min() < 1e-2


def test_both_images_of_a_pair_show_the_same_points(batch: Batch) -> None:
    for k, X_AB in enumerate(batch["X_AB"]):
        own = batch["pair"] == k
        moved = transform_points(X_AB.numpy(), batch["p_b"][own].numpy())
        np.testing.assert_allclose(moved, batch["p_a"][own].numpy(), atol=1e-4)


def test_points_lie_on_their_planes_and_rays(batch: Batch) -> None:
    on_plane = (batch["plane_a"] * batch["p_a"]).sum(dim=1)
    torch.testing.assert_close(on_plane, torch.ones_like(on_plane), rtol=1e-4, atol=1e-4)
    sigma = torch.zeros(len(batch["pair"]))
    torch.testing.assert_close(
        surface_point((batch["uv_a"], sigma), batch, "a"), batch["p_a"], rtol=1e-3, atol=1e-4
    )


def test_the_loss_of_what_is_known_is_small(batch: Batch) -> None:
    known = ideal(batch)
    blank = known._replace(
        score=torch.zeros_like(known.score),
        offset_px=torch.zeros_like(known.offset_px),
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
        points = [surface_point(at, batch, side) for at, side in zip(own, ("a", "b"), strict=True)]
        losses.append(float(consistency_loss(dense, own, points, batch)))
    assert losses[0] < losses[1] - 0.5


def test_the_likelihood_is_best_at_the_true_scatter() -> None:
    torch.manual_seed(1)
    off = 0.4 * torch.randn(20000, 2) / torch.sqrt(torch.distributions.Chi2(5.0).sample((20000, 1)) / 5.0)
    square = (off**2).sum(dim=1)
    guesses = torch.log(torch.tensor([0.3, 0.36, 0.4, 0.44, 0.5]))
    values = [float(student_nll(square, guess).mean()) for guess in guesses]
    assert int(np.argmin(values)) == 2


def test_the_gradient_of_the_likelihood_is_right() -> None:
    square = torch.tensor([0.1, 1.0, 7.0], dtype=torch.float64, requires_grad=True)
    log_sigma = torch.tensor([-1.0, 0.2, 0.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(student_nll, (square, log_sigma))


def test_the_gradient_of_places_reaches_the_points(batch: Batch) -> None:
    uv = batch["uv_a"].double().requires_grad_()
    doubled = {name: value.double() if value.is_floating_point() else value for name, value in batch.items()}

    def point(places: Tensor) -> Tensor:
        return surface_point((places, places[:, 0]), doubled, "a")

    assert torch.autograd.gradcheck(point, (uv,), atol=1e-4)


@pytest.fixture(scope="module")
def batch_of_three(bodies: dict[int, KnownBody]) -> Batch:
    rng = np.random.default_rng(8)
    examples = [draw_example(bodies[k], rng, 96, CONFIG.kinds, 0.0, with_third=True) for k in (0, 0, 1)]
    assert any(each is not None and each.third is not None for each in examples)
    return batch_of([each for each in examples if each is not None], 40, rng)


def seen_thrice(batch: Batch, dense: DenseOutput) -> Views:
    own = [place_at(dense, batch, side) for side in ("a", "b")]
    points = [surface_point(at, batch, side) for at, side in zip(own, ("a", "b"), strict=True)]
    return views_of(dense, own, points, batch)


def moved_places(batch: Batch, shift_px: float) -> DenseOutput:
    """What a network would say that knows the places that three images show, less a shift in the third."""
    dense = ideal(batch)
    for image, uv, shift in (
        (2 * batch["pair"], batch["uv_a"], 0.0),
        (2 * batch["pair"] + 1, batch["uv_b"], 0.0),
        (batch["image_third"], batch["uv_third"], shift_px),
    ):
        column, row = uv.round().long().T
        dense.offset_px[image, :, row, column] = uv - uv.round() + uv.new_tensor([shift, 0.0])
    return dense


def test_what_agrees_in_three_images_costs_least(batch_of_three: Batch) -> None:
    batch = batch_of_three
    assert batch["image_third"].min() >= 2 * len(batch["X_AB"])
    assert batch["is_strict"][batch["third"]].all()
    views = seen_thrice(batch, moved_places(batch, 0.0))
    # the three places of a landmark are one point of the surface, but for those that share a pixel
    spread_m = torch.linalg.vector_norm(views.p_A - views.p_A.mean(dim=0), dim=2).amax(dim=0)
    px_m = views.p_A[0, :, 2] / views.focal_px
    assert (spread_m < 0.05 * px_m).float().mean() > 0.9
    losses = [
        float(consensus_loss(seen_thrice(batch, moved_places(batch, shift)))) for shift in (0.0, 0.4, 1.0)
    ]
    assert losses[0] < losses[1] - 0.5 < losses[2] - 1.0


def test_the_deviation_from_the_mean_of_the_others_scatters_as_it_says() -> None:
    """Places of a plane that faces three cameras, displaced by their standard deviations."""
    rng, n, focal, depth = np.random.default_rng(2), 4000, 400.0, 2.0
    sigma = torch.tensor([0.2, 0.4, 0.8], dtype=torch.float64)
    off = sigma[:, None, None] * torch.from_numpy(rng.normal(size=(3, n, 2)))
    p = torch.cat([off * depth / focal, torch.full((3, n, 1), depth, dtype=torch.float64)], dim=2)

    def loss(scale: float) -> float:
        views = Views(
            uv_px=off,
            log_sigma=torch.log(scale * sigma)[:, None].expand(3, n),
            p_A=p,
            X_VA=torch.eye(4, dtype=torch.float64).expand(3, n, 4, 4),
            log_area=torch.full((3, n), 2.0 * np.log(focal / depth), dtype=torch.float64),
            centre_px=torch.zeros(3, n, 2, dtype=torch.float64),
            focal_px=torch.full((n,), focal, dtype=torch.float64),
        )
        return float(consensus_loss(views))

    # Student's t of five degrees of freedom fits a Gaussian best with a tenth less scale
    values = [loss(scale) for scale in (0.6, 0.75, 0.9, 1.1, 1.4)]
    assert int(np.argmin(values)) == 2


def test_the_gradient_of_the_consensus_is_right(batch_of_three: Batch) -> None:
    views = Views(*(each.detach().double() for each in seen_thrice(batch_of_three, ideal(batch_of_three))))
    n = min(6, len(views.focal_px))
    few = Views(*(each[:n] if each.ndim == 1 else each[:, :n] for each in views))
    uv, p_A = few.uv_px.clone().requires_grad_(), few.p_A.clone().requires_grad_()

    def loss(uv: Tensor, p_A: Tensor) -> Tensor:
        return consensus_loss(few._replace(uv_px=uv, p_A=p_A))

    assert torch.autograd.gradcheck(loss, (uv, p_A), eps=1e-7, atol=1e-3, rtol=1e-4)


@pytest.fixture(scope="module")
def batch_of_albedos(two_albedos: dict[int, KnownBody]) -> Batch:
    rng = np.random.default_rng(6)
    example = draw_example(two_albedos[0], rng, 96, CONFIG.kinds)
    assert example is not None
    assert example.other_albedo is not None
    return batch_of([example], 40, rng)


def test_the_other_albedo_shows_the_same_places_of_its_own_image(batch_of_albedos: Batch) -> None:
    batch = batch_of_albedos
    m, d = len(batch["pair"]), len(batch["distractors"])
    assert torch.equal(batch["other"].sort().values, torch.arange(m))
    assert len(batch["images"]) == 3
    assert (batch["owner"][2 * m + d :] == 2).all()
    # jitters of places differ
    off = batch["uv"][2 * m + d :] - batch["uv_b"][batch["other"]]
    assert torch.linalg.vector_norm(off, dim=1).max() < 3.0
    assert not batch["weight"][2].any()
    assert not batch["heat"][2].any()
    assert (batch["near"][:, 0] < 2).all()
    assert (batch["images"][1].float() - batch["images"][2]).abs().mean() > 2.0


def test_descriptors_that_follow_the_albedo_cost_least(batch_of_albedos: Batch) -> None:
    batch = batch_of_albedos
    m, d = len(batch["pair"]), len(batch["distractors"])
    torch.manual_seed(3)
    own, another = (torch.nn.functional.normalize(torch.randn(m, 16), dim=1) for _ in range(2))
    rest = torch.nn.functional.normalize(torch.randn(d, 16), dim=1)
    temperature = torch.tensor(0.07)
    same_place = batch["other"]
    follows = albedo_loss(torch.cat([own, own, rest, another[same_place]]), batch, temperature)
    blind = albedo_loss(torch.cat([own, own, rest, own[same_place]]), batch, temperature)
    light = albedo_loss(torch.cat([own, another, rest, own[same_place]]), batch, temperature)
    assert follows < 0.1
    assert blind == pytest.approx(np.log(2.0), rel=1e-3)
    assert light > 5.0


def test_the_gradient_of_the_albedo_term_is_right(batch_of_albedos: Batch) -> None:
    m, d = len(batch_of_albedos["pair"]), len(batch_of_albedos["distractors"])
    torch.manual_seed(4)
    descriptor = torch.randn(3 * m + d, 3, dtype=torch.float64, requires_grad=True)
    temperature = torch.tensor(0.5, dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda each: albedo_loss(each, batch_of_albedos, temperature), (descriptor,)
    )


def test_all_terms_are_learned_from(two_albedos: dict[int, KnownBody]) -> None:
    loss = SurfaceLoss(consensus=0.3)
    task = SurfaceTask(two_albedos, [], CONFIG.model_copy(update={"loss": loss}), 1, 0)
    assert task._numbers == [0, NEXT_ALBEDO]
    value, terms = task.loss(task.batch(0))
    assert torch.isfinite(value)
    assert {"consensus", "albedo"} <= terms.keys()
    value.backward()
    gradients = [weight.grad for weight in task.network.parameters() if weight.grad is not None]
    assert all(torch.isfinite(each).all() for each in gradients)
    torch.manual_seed(2)
    found = score_trials(SurfaceNet().eval(), trials_of({0: two_albedos[0]}, 3))
    assert 0.0 <= found["own_albedo_pose"] <= 1.0


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


def test_held_out_bodies_are_scored_and_not_learned_from(lit_body_corpus: Corpus, tmp_path: Path) -> None:
    task = make_task(train_of(lit_body_corpus, tmp_path, 1), 7, Silent(), 1)
    assert task._numbers == [0, 2]
    found = task.validate()
    for kind in ("light", "pose", "both"):
        assert 0.0 <= found[f"rank_1_{kind}"] <= 1.0
    assert {"shadow_iou", "matcher_temperature"} <= found.keys()


def test_bodies_of_another_corpus_are_learned_from_too(lit_body_corpus: Corpus, tmp_path: Path) -> None:
    train = train_of(lit_body_corpus, tmp_path, 1)
    more = MoreBodies(corpus=lit_body_corpus, bodies=1)
    train = train.model_copy(update={"surface": CONFIG.model_copy(update={"more": (more,)})})
    assert make_task(train, 7, Silent(), 1)._numbers == [0, 2, NEXT_CORPUS]
    twice = CONFIG.model_copy(update={"more": (more.model_copy(update={"weight": 2}),)})
    numbers = make_task(train.model_copy(update={"surface": twice}), 7, Silent(), 1)._numbers
    assert numbers == [0, 2, NEXT_CORPUS, 2 * NEXT_CORPUS]
    assert setting_of(train, 7)["surface.more.0.bodies"] == 1
    json.dumps(setting_of(train, 7))


def test_scores_of_blobs_do_not_depend_on_the_network(bodies: dict[int, KnownBody]) -> None:
    trials = trials_of({1: bodies[1]}, 3)
    assert {trial.kind for trial in trials} == {"light", "pose", "both"}
    torch.manual_seed(2)
    found = score_trials(SurfaceNet().eval(), trials)
    # blobs of a lit body are found again from another side
    assert found["found_blobs_pose"] > 0.3
    assert found["scatter_blobs_px_pose"] < 1.0


def test_weights_are_compared_on_the_same_pairs(
    lit_body_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    values = train_of(lit_body_corpus, tmp_path, 1).model_dump(mode="json")
    config.write_text(yaml.safe_dump({"train": values}), encoding="utf-8")
    weights = str(shipped_path("surface"))
    scores.main([str(config), weights, weights, "--workers", "1"])
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert {"rank_1_both", "found_light", "shadow_iou"} <= {line[0] for line in lines}
    assert all(len(line) == 3 and line[1] == line[2] for line in lines)
    with pytest.raises(SystemExit) as refused:
        scores.main([str(config), str(tmp_path / "none.safetensors")])
    assert refused.value.code == 2
    with pytest.raises(SystemExit) as refused:
        scores.main([str(config), weights, "--more", "1"])
    assert refused.value.code == 2
    assert "train.surface.more has 0 entries, and no number 1" in capsys.readouterr().err


def test_scores_of_a_further_corpus_are_of_its_held_out_bodies(
    lit_body_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = MoreBodies(corpus=lit_body_corpus, bodies=2)
    train = train_of(lit_body_corpus, tmp_path, 1)
    train = train.model_copy(update={"surface": CONFIG.model_copy(update={"more": (more,)})})
    assert corpus_of(train, 1)[1].bodies == 2
    config = tmp_path / "config.yaml"
    config.write_text(yaml.safe_dump({"train": train.model_dump(mode="json")}), encoding="utf-8")
    scores.main([str(config), str(shipped_path("surface")), "--more", "1", "--workers", "1"])
    assert "rank_1_both" in capsys.readouterr().out


def test_bodies_without_common_landmarks_cannot_be_learned_from(bodies: dict[int, KnownBody]) -> None:
    nothing = np.zeros(0)
    none = Landmarks(
        np.zeros((0, 3)),
        np.zeros((0, 3)),
        nothing,
        nothing.astype(bool),
        nothing.astype(int),
        np.zeros((0, 2)),
        nothing.astype(int),
    )
    task = SurfaceTask({0: KnownBody(bodies[0].body, none)}, [], CONFIG, 1, 0)
    with pytest.raises(InputError, match="no body has two images with common landmarks"):
        task.batch(0)


def test_kinds_of_pairs_are_shares() -> None:
    assert SurfaceTraining(kinds=(0.0, 1.0, 0.0)).kinds == (0.0, 1.0, 0.0)
    with pytest.raises(ValidationError, match=r"kinds add up to 0\.9 instead of 1"):
        SurfaceTraining(kinds=(0.3, 0.3, 0.3))


@pytest.mark.parametrize("kind", range(3))
def test_a_kind_of_pair_differs_in_what_it_says(bodies: dict[int, KnownBody], kind: int) -> None:
    rng = np.random.default_rng(9)
    for wide in (0.0, 1.0):
        example = draw_example(bodies[0], rng, 96, np.eye(3)[kind].tolist(), wide)
        assert example is not None
        poses, suns = (
            [of(view) for view in example.views] for of in (bodies[0].body.pose_of, bodies[0].body.sun_of)
        )
        assert (poses[0] == poses[1]) == (kind == 0)
        assert (suns[0] == suns[1]) == (kind == 1)
