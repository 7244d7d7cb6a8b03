"""The surface network as a task of the training loop, and its loss.

The loss: cross entropy of the share of the other images in which a point is found; Gaussian negative log
likelihood of the places of matches, whose variance is the sum of those of their two points; cross entropy of
the kind of light, for which the truth is the simulator's.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.config.train_settings import Train
from polhode.errors import InputError
from polhode.frontend.networks.surface import Judgement, SurfaceNet
from polhode.progress import Progress
from polhode.train.corpus import split
from polhode.train.surface.batches import ViewBatches
from polhode.train.surface.lit_views import SKY, LitViews, prepare_views
from polhode.train.surface.scores import score
from polhode.train.task import Batch

SIGMA_WEIGHT, LIGHT_WEIGHT = 0.2, 0.3
"""Weights of these losses beside that of the reliability."""


def surface_loss(judged: Judgement, light: Tensor, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss and its terms for a batch of ``ViewBatches``."""
    seen = batch["seen"]
    share = batch["found"] / seen.clamp(min=1.0)
    each = functional.binary_cross_entropy_with_logits(judged.reliability, share, reduction="none")
    reliability = (seen * each).sum() / seen.sum().clamp(min=1.0)
    place = place_loss(judged.log_sigma, batch)
    kind = functional.cross_entropy(
        light, batch["light"].masked_fill(batch["light"] == SKY, -1), ignore_index=-1
    )
    kind = torch.nan_to_num(kind)  # a batch without the target
    loss = reliability + SIGMA_WEIGHT * place + LIGHT_WEIGHT * kind
    return loss, {"reliability": reliability, "place": place, "light": kind}


def place_loss(log_sigma: Tensor, batch: Batch) -> Tensor:
    """Mean negative log likelihood of the places of the matches, each axis, without constants."""
    if len(batch["first"]) == 0:
        return 0.0 * log_sigma.sum()
    variance = sum(torch.exp(2.0 * log_sigma[batch[name]]) for name in ("first", "second"))
    assert isinstance(variance, Tensor)
    return (0.5 * torch.log(variance) + 0.25 * batch["square"] / variance).mean()


class SurfaceTask:
    """The task ``surface``."""

    name = "surface"

    def __init__(self, batches: ViewBatches, held_out: Mapping[int, LitViews]) -> None:
        self._batches, self._held_out = batches, held_out
        self._network = SurfaceNet()

    @property
    def model(self) -> nn.Module:
        """The network."""
        return self._network

    @property
    def network(self) -> nn.Module:
        """The network."""
        return self._network

    def batch(self, step: int) -> Batch:
        """Images of step ``step``."""
        return self._batches.batch(step)

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Reliability, place and light."""
        judged, light = self._network(batch["images"], batch["owner"], batch["uv"], batch["known"])
        return surface_loss(judged, light, batch)

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies."""
        return score(self._network, self._held_out)


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> SurfaceTask:
    """Render the bodies. Raises InputError: nothing is found again."""
    halves = split(train.corpus)
    bodies = prepare_views(train.corpus, train.surface, progress, workers)
    batches = ViewBatches({i: bodies[i] for i in halves.training}, train.surface, seed)
    if batches.is_empty:
        raise InputError("train.corpus: no point is found again: more scenes, or smaller turns")
    return SurfaceTask(batches, {i: bodies[i] for i in halves.validation})
