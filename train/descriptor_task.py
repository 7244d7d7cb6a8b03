"""Training of the descriptor: surface points in two frames, far and near, lit and in shadow."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from frontend.features import Descriptors
from frontend.networks.descriptor import DescriptorNet
from frontend.patches import Patches
from polhode.config.train import DescriptorTraining, Train
from polhode.errors import InputError
from polhode.lie import Array
from polhode.progress import Progress
from train.corpus import split
from train.descriptor_loss import Temperature, descriptor_loss
from train.descriptor_scores import Trial, make_trials, score
from train.patch_batches import PatchBatches
from train.points import prepare_points
from train.task import Batch

AT_ONCE = 256
"""Patches that the network describes at once in validation."""


class DescriptorTask:
    """The task ``descriptor``."""

    name = "descriptor"

    def __init__(self, batches: PatchBatches, trials: list[Trial], config: DescriptorTraining) -> None:
        self._batches, self._trials, self._config = batches, trials, config
        self._model = nn.ModuleDict({"network": DescriptorNet(), "temperature": Temperature()})

    @property
    def model(self) -> nn.Module:
        """The network and the temperature."""
        return self._model

    @property
    def network(self) -> nn.Module:
        """What is shipped."""
        return self._model["network"]

    def batch(self, step: int) -> Batch:
        """Patches of step ``step``."""
        return self._batches.batch(step)

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """InfoNCE, the reliability's cross entropy, the directions' consistency."""
        described = self.network(batch["patches"])
        return descriptor_loss(described, batch, self._model["temperature"](), self._config)

    def validate(self) -> Mapping[str, float]:
        """Rank-1 shares on the held-out bodies."""
        return score(self._trials, self._describe)

    def _describe(self, patches: Patches) -> tuple[Descriptors, Array, Array]:
        device = next(self._model.parameters()).device
        parts = [self.network(some.to(device)) for some in torch.from_numpy(patches).split(AT_ONCE)]
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
    return DescriptorTask(batches, trials, train.descriptor)
