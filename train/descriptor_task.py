"""Training of the descriptor: surface points in two frames, far and near, lit and in shadow."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from polhode.config.train import DescriptorTraining, Train
from polhode.errors import InputError
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patches import Patches
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.lie import Array
from polhode.progress import Progress
from polhode.train.corpus import split
from polhode.train.descriptor_loss import Heads, descriptor_loss
from polhode.train.descriptor_scores import Trial, make_trials, score
from polhode.train.patch_batches import PatchBatches
from polhode.train.points import prepare_points
from polhode.train.task import Batch

AT_ONCE = 256
"""Patches that the network describes at once in validation."""


class DescriptorTask:
    """The task ``descriptor``."""

    name = "descriptor"

    def __init__(
        self, batches: PatchBatches, trials: list[Trial], config: DescriptorTraining, late_from: int
    ) -> None:
        """``late_from``: first step that learns from matches and motion."""
        self._batches, self._trials, self._config = batches, trials, config
        self._late_from = late_from
        self._network, self._heads = DescriptorNet(), Heads()
        self._model = nn.ModuleDict({"network": self._network, "heads": self._heads})

    @property
    def model(self) -> nn.Module:
        """The network and the heads."""
        return self._model

    @property
    def network(self) -> nn.Module:
        """What is shipped."""
        return self._network

    def batch(self, step: int) -> Batch:
        """Patches of step ``step``."""
        return self._batches.batch(step) | {"late": torch.tensor(float(step >= self._late_from))}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """InfoNCE; reliability, direction; the matches and the motion that they tell, late."""
        described = self._network(batch["patches"])
        with torch.autocast(batch["patches"].device.type, enabled=False):
            # Similarities over a small temperature, and fits, need all their digits.
            return descriptor_loss(described, batch, self._heads, self._config)

    def validate(self) -> Mapping[str, float]:
        """Rank-1 shares on the held-out bodies, and what the matcher has learned."""
        matcher = self._heads.matcher
        return score(self._trials, lambda patches: described_by(self._network, patches)) | {
            "matcher_temperature": float(matcher.log_temperature.exp()),
            "matcher_dustbin": float(matcher.dustbin),
        }


def described_by(network: DescriptorNet, patches: Patches) -> tuple[Descriptors, Array, Array]:
    """Descriptors (n, d), logits of reliability (n,), directions (n, 2) of patches (n, 1, s, s)."""
    device = next(network.parameters()).device
    with torch.no_grad():
        parts = [network(some.to(device)) for some in torch.from_numpy(patches).split(AT_ONCE)]
    descriptor, reliability, direction = (
        torch.cat(each).float().cpu().numpy() for each in zip(*parts, strict=True)
    )
    return descriptor, reliability, direction


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> DescriptorTask:
    """Find the points of the corpus. Raises InputError: the corpus shows too few."""
    halves = split(train.corpus)
    scenes = prepare_points(train.corpus, range(train.corpus.scenes), progress, workers)
    batches = PatchBatches({i: scenes[i] for i in halves.training}, train.descriptor, seed)
    if batches.is_empty:
        raise InputError(
            "train.corpus: no two frames show enough common points: more scenes or frames, or smaller turns"
        )
    trials = make_trials({i: scenes[i] for i in halves.validation}, seed)
    late_from = round(train.descriptor.late_from * train.schedule.steps)
    return DescriptorTask(batches, trials, train.descriptor, late_from)
