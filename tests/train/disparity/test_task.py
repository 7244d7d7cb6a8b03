"""The disparity network's samples, batches, loss and task, on pairs painted for the purpose."""

from pathlib import Path

import numpy as np
import pytest
import torch

from polhode.config.frontend_settings import Depth
from polhode.config.train_settings import DepthTraining
from polhode.frontend.disparity.learned import initial_disparity
from polhode.frontend.disparity.sgbm import cut_crop
from polhode.frontend.networks.disparity import CHANNELS, OUTPUTS, DisparityMixture
from polhode.train.disparity.samples import (
    DisparitySample,
    augment,
    flip_rows,
    random_batch,
    random_crop,
    read_sample,
    remove_matches,
    shift_by_plane,
    stack,
    write_sample,
)
from polhode.train.disparity.task import (
    DisparityTask,
    disparity_loss,
    loss_pixels,
    scores,
    validation_errors,
)
from polhode.train.task import Batch

SETTINGS = DepthTraining(batch=2, crop_px=64, validation_samples=1)


@pytest.fixture(scope="module")
def sample() -> DisparitySample:
    """A textured square at disparity 30, its right quarter at 36 and without texture."""
    rng = np.random.default_rng(4)
    left, right = np.full((120, 180), 3, np.uint8), np.full((120, 180), 3, np.uint8)
    painted = np.clip(rng.normal(120, 45, (35, 35)), 20, 255).repeat(2, 0).repeat(2, 1)
    painted[:, 52:] = 150
    left[25:95, 70:140] = painted
    right[25:95, 40:92], right[25:95, 86:104] = painted[:, :52], painted[:, 52:]
    mask = np.zeros((120, 180), dtype=bool)
    mask[25:95, 70:140] = True
    truth = np.where(mask, 30.0, np.nan).astype(np.float32)
    truth[25:95, 122:140] = 36.0
    visible = mask.copy()
    visible[25:95, 116:122] = False
    crop = cut_crop(left, right, mask, (25.0, 40.0), Depth())
    start = initial_disparity(crop, Depth())
    assert start is not None
    return DisparitySample(start, truth[crop.inner] - crop.shift_px, visible[crop.inner])


@pytest.fixture(scope="module")
def files(sample: DisparitySample, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    path = tmp_path_factory.mktemp("samples") / "one.npz"
    write_sample(path, sample)
    return [path]


def agrees(sample: DisparitySample) -> float:
    """Median distance of matched disparities from the truth [px]."""
    known = np.isfinite(sample.start.sigma) & sample.visible
    return float(np.median(np.abs(sample.start.filled - sample.truth)[known]))


def test_a_sample_comes_back_from_its_file_and_a_batch_from_its_seed(
    sample: DisparitySample, files: list[Path]
) -> None:
    again = read_sample(files[0])
    np.testing.assert_array_equal(again.truth, sample.truth)
    np.testing.assert_array_equal(again.start.even_right, sample.start.even_right)
    assert again.start.margin_px == sample.start.margin_px
    first, second = (random_batch(files, 2, 64, np.random.default_rng([7, 3])) for _ in range(2))
    assert first["channels"].shape == (2, CHANNELS, 64, 64)
    for name, tensor in first.items():
        assert torch.equal(torch.nan_to_num(tensor), torch.nan_to_num(second[name])), name


def test_augmented_samples_keep_their_truth(sample: DisparitySample) -> None:
    assert agrees(sample) < 0.1 and agrees(flip_rows(sample)) < 0.1
    np.testing.assert_array_equal(flip_rows(flip_rows(sample)).start.left, sample.start.left)
    rng, start = np.random.default_rng(0), sample.start
    assert np.isfinite(remove_matches(start, 5, rng).sigma).sum() < np.isfinite(start.sigma).sum()
    shifted = shift_by_plane(start, rng)
    assert 0.01 < np.abs(shifted.filled - start.filled).max() < 5.0
    np.testing.assert_allclose(shifted.near - shifted.filled, start.near - start.filled, atol=1e-4)
    assert augment(sample, rng).truth.shape == sample.truth.shape
    # parts have the size asked for, also of small samples
    for size in ((32, 48), (160, 192)):
        part = random_crop(sample, size, rng)
        assert part.truth.shape == part.start.filled.shape == size
        assert part.start.right.shape == (size[0], size[1] + 2 * part.start.margin_px)
        assert part.start.target.any()


def mixture_at(mean: torch.Tensor, scale: float) -> DisparityMixture:
    n = len(mean)
    return DisparityMixture(torch.zeros(n, 1), mean[:, None], torch.full((n, 1), scale), torch.zeros(n))


@pytest.fixture(scope="module")
def asked(sample: DisparitySample) -> Batch:
    mixture, found = loss_pixels(torch.zeros(1, OUTPUTS, *sample.truth.shape), stack([sample]))
    assert len(mixture.mean) == len(found["truth"]) == int(sample.start.target.sum())
    return found


def test_the_loss_prefers_the_truth_and_a_consistent_scale_and_has_a_bound(asked: Batch) -> None:
    truth = torch.nan_to_num(asked["truth"])

    def loss(off: float, scale: float) -> float:
        return float(disparity_loss(mixture_at(truth + off, scale), asked))

    assert loss(0.0, 0.3) < loss(0.5, 0.3)
    assert np.argmin([loss(0.5, scale) for scale in (0.05, 0.5, 5.0)]) == 1
    assert loss(1e3, 0.02) == loss(1e6, 0.02) < 15.0
    # pixels without truth teach nothing about place
    thinned = asked | {"truth": asked["truth"].clone()}
    thinned["truth"][:100] = torch.nan
    mean = truth.clone().requires_grad_()
    disparity_loss(mixture_at(mean + 0.1, 0.3), thinned).backward()
    assert mean.grad is not None
    assert (mean.grad[:100] == 0).all() and (mean.grad[100:] != 0).all()


def test_the_loss_falls_as_the_network_learns(files: list[Path]) -> None:
    task = DisparityTask(SETTINGS, files, files, seed=0)
    optimizer = torch.optim.AdamW(task.model.parameters(), lr=2e-3)
    losses, batch = [], task.batch(0)
    for _ in range(15):
        loss, _ = task.loss(batch)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(task.model.parameters(), 1.0)
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] - 0.3


def test_validation_compares_at_the_density_of_the_classical_start_and_makes_sigma_hold_68_percent(
    sample: DisparitySample, files: list[Path]
) -> None:
    task = DisparityTask(SETTINGS, files, files, seed=0)
    task.model.eval()
    found = task.validate()
    assert found["within_sigma"] == pytest.approx(0.6827, abs=0.01)
    assert found["sigma_scale"] == pytest.approx(float(task.model.sigma_scale))
    # A second look finds nothing left to scale.
    assert task.validate()["sigma_scale"] == pytest.approx(found["sigma_scale"], rel=1e-4)
    errors = validation_errors(sample, task.model)
    again = scores([errors])
    assert again["bad_refined"] == found["bad_refined"]
    better = {**errors, "refined": 0.5 * errors["refined"]}
    assert scores([better])["median_refined_px"] < again["median_refined_px"]
    assert found["bad_everywhere"] == float(np.mean(errors["refined"] > 1.0))
