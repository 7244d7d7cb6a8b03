"""The disparity network as a task of the training loop.

The loss is the log density of the true disparity, and the visibility.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from polhode.config.frontend_settings import Depth
from polhode.config.train_settings import DepthTraining, Train
from polhode.frontend.disparity.learned import RefinedDisparity, refine
from polhode.frontend.networks.disparity import DisparityMixture, DisparityNet, mixture_from_outputs
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress
from polhode.train.corpus import render_corpus, scene_folder, split
from polhode.train.disparity.samples import (
    DisparitySample,
    build_samples,
    random_batch,
    read_sample,
)
from polhode.train.task import Batch

_DARK_WEIGHT = 0.5
_NEAR_PX = 1.0
_NEAR_WEIGHT = 0.5
_OUTLIER_SHARE = 0.01
_VISIBLE_WEIGHT = 0.3


def loss_pixels(raw: Tensor, batch: Batch) -> tuple[DisparityMixture, Batch]:
    """Distribution at the pixels (n,) that are true or segmented target, from the network's raw outputs
    (B, OUTPUTS, h, w), and the images of the batch there."""
    chosen = torch.isfinite(batch["truth"]) | batch["target"]
    outputs, guess = (tensor.permute(0, 2, 3, 1)[chosen] for tensor in (raw, batch["hypotheses"]))
    pixels = {name: batch[name][chosen] for name in ("truth", "visible", "lit", "target")}
    return mixture_from_outputs(outputs, guess), pixels


def disparity_loss(mixture: DisparityMixture, pixels: Batch) -> Tensor:
    """Scalar loss: mean negative log density of the true disparity, mean negative log probability of its
    vicinity, and cross entropy of the visibility.
    """
    known = torch.isfinite(pixels["truth"])
    truth = torch.where(known, pixels["truth"], 0.0)
    density = mixture.log_density(truth).exp()
    # A share of the pixels is distributed uniformly over this width, so the loss of a single pixel is bounded
    cost = -torch.log((1.0 - _OUTLIER_SHARE) * density + _OUTLIER_SHARE / 64.0)
    # An error below one pixel is rewarded separately: a wrong surface is worse than a coarse fit of the right
    # one.
    near = mixture.mass_within(truth, torch.full_like(truth, _NEAR_PX))
    cost = cost - _NEAR_WEIGHT * torch.log((1.0 - _OUTLIER_SHARE) * near + _OUTLIER_SHARE)
    weight = known.float()
    # weight of pixels that the other camera does not see: only their surroundings determine them
    weight = weight * torch.where(pixels["visible"], 1.0, 0.15)
    weight = weight * torch.where(pixels["lit"], 1.0, _DARK_WEIGHT)
    accuracy = (weight * cost).sum() / weight.sum().clamp(min=1.0)
    seen = functional.binary_cross_entropy_with_logits(
        mixture.visible, pixels["visible"].float(), reduction="none"
    )
    segmented = pixels["target"].float()
    return accuracy + _VISIBLE_WEIGHT * (seen * segmented).sum() / segmented.sum().clamp(min=1.0)


ValidationErrors = dict[str, NDArray[np.float64]]
"""Errors of the initial and the refined disparity, and sigmas, at lit and visible pixels (n,) [px]."""


class DisparityTask:
    """Batches, loss and validation of ``DisparityNet``."""

    name = "disparity"

    def __init__(
        self, settings: DepthTraining, training: Sequence[Path], held_out: Sequence[Path], seed: int
    ) -> None:
        if not training or not held_out:
            raise InputError("train.corpus: no pair shows a target that can be matched: render more scenes")
        torch.manual_seed(seed)
        self._settings, self._training, self._seed = settings, list(training), seed
        # The same samples in every validation, evenly spaced over the held-out scenes.
        step = max(1, len(held_out) // settings.validation_samples)
        self._held_out = list(held_out)[::step][: settings.validation_samples]
        self.model = self.network = DisparityNet()

    def batch(self, step: int) -> Batch:
        rng = np.random.default_rng([self._seed, step])
        settings = self._settings
        return random_batch(self._training, settings.batch, settings.crop_px, rng)

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        channels = batch["channels"].contiguous(memory_format=torch.channels_last)
        on_cpu = channels.device.type == "cpu"
        with torch.autocast("cpu", torch.bfloat16, enabled=on_cpu and self._settings.half_on_cpu):
            raw = self.model(channels)
        mixture, pixels = loss_pixels(raw, batch)
        loss = disparity_loss(mixture, pixels)
        with torch.no_grad():
            likeliest = mixture.mean.gather(1, mixture.log_weight.argmax(dim=1, keepdim=True))[:, 0]
            off = (likeliest - pixels["truth"]).abs()[pixels["visible"] & pixels["lit"]]
        return loss, {"off_by_more_than_1_px": (off > 1.0).float().mean()}

    def validate(self) -> Mapping[str, float]:
        """Scores, after calibrating the scale of the network's sigmas, which is not learned."""
        device = next(self.model.parameters()).device
        network = self.model.cpu()
        errors = [validation_errors(read_sample(path), network) for path in self._held_out]
        factor = calibration(errors)
        network.sigma_scale *= factor
        self.model.to(device)
        calibrated = [{**each, "sigma": factor * each["sigma"]} for each in errors]
        return {**scores(calibrated), "sigma_scale": float(network.sigma_scale)}


def validation_errors(sample: DisparitySample, network: DisparityNet) -> ValidationErrors:
    """Errors of one held-out sample."""
    refined: RefinedDisparity = refine(network, sample.start)
    pixels = sample.visible & sample.start.lit & np.isfinite(refined.disparity)
    matched = np.isfinite(sample.start.sigma)[pixels]
    return {
        "classical": np.where(matched, np.abs(sample.start.filled - sample.truth)[pixels], np.nan),
        "refined": np.abs(refined.disparity - sample.truth)[pixels].astype(np.float64),
        "sigma": refined.sigma[pixels].astype(np.float64),
    }


def calibration(samples: Sequence[ValidationErrors]) -> float:
    """Factor for sigma such that 68 % of the errors are smaller: the geometric mean over the samples."""
    factors = [np.quantile(each["refined"] / each["sigma"], 0.6827) for each in samples if len(each["sigma"])]
    return float(np.exp(np.mean(np.log(factors))))


def scores(samples: Sequence[ValidationErrors]) -> dict[str, float]:
    """Means over the samples: share of errors above 1 px at the density of the classical method;
    calibration."""
    rows = []
    for each in samples:
        matched = np.isfinite(each["classical"])
        if not matched.any():
            continue
        # As many pixels as classical matching gives, those with the smallest sigma.
        chosen = np.argsort(each["sigma"])[: int(matched.sum())]
        rows.append(
            {
                "bad_classical": float(np.mean(each["classical"][matched] > 1.0)),
                "bad_refined": float(np.mean(each["refined"][chosen] > 1.0)),
                "bad_everywhere": float(np.mean(each["refined"] > 1.0)),
                "median_classical_px": float(np.median(each["classical"][matched])),
                "median_refined_px": float(np.median(each["refined"][chosen])),
                "within_sigma": float(np.mean(each["refined"] < each["sigma"])),
                "within_two_sigma": float(np.mean(each["refined"] < 2.0 * each["sigma"])),
            }
        )
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _samples_of(train: Train, seed: int, scene: int) -> list[Path]:
    folder, cache = scene_folder(train.corpus, scene), Path(train.depth.cache)
    return build_samples(folder, cache, Depth(), seed, train.depth.every)


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> DisparityTask:
    """Render the corpus, match each of its pairs once, and initialise the network."""
    render_corpus(train.corpus, progress, workers)
    parts = split(train.corpus)
    scenes = sorted([*parts.training, *parts.validation])
    files: dict[int, list[Path]] = {}
    with progress.stage("matching pairs", len(scenes)) as advance:
        job = partial(_samples_of, train, seed)
        for scene, paths in zip(scenes, in_order(job, scenes, workers), strict=True):
            files[scene] = paths
            advance()
    training = [path for scene in parts.training for path in files[scene]]
    held_out = [path for scene in parts.validation for path in files[scene]]
    return DisparityTask(train.depth, training, held_out, seed)
