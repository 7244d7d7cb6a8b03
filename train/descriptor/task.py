"""The descriptor network as a task of the training loop."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from polhode.config.train import DescriptorTraining, Train
from polhode.errors import InputError
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.progress import Progress
from polhode.train.corpus import split
from polhode.train.descriptor.batches import PatchBatches
from polhode.train.descriptor.loss import Heads, descriptor_loss
from polhode.train.descriptor.scores import ValidationPair, describe_patches, score, validation_pairs
from polhode.train.descriptor.surface_points import prepare_points
from polhode.train.task import Batch


class DescriptorTask:
    """The task ``descriptor``."""

    name = "descriptor"

    def __init__(
        self, batches: PatchBatches, trials: list[ValidationPair], config: DescriptorTraining, late_from: int
    ) -> None:
        """``late_from``: first step whose loss contains matches and motion."""
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
        """The descriptor network, whose weights are written."""
        return self._network

    def batch(self, step: int) -> Batch:
        """Patches of step ``step``."""
        return self._batches.batch(step) | {"late": torch.tensor(float(step >= self._late_from))}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Contrast, reliability and direction; in later steps also matches and motion."""
        described = self._network(batch["patches"])
        with torch.autocast(batch["patches"].device.type, enabled=False):
            # Similarities over a small temperature, and fits, need full precision.
            return descriptor_loss(described, batch, self._heads, self._config)

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, and the matcher's parameters."""
        matcher = self._heads.matcher
        return score(self._trials, lambda patches: describe_patches(self._network, patches)) | {
            "matcher_temperature": float(matcher.log_temperature.exp()),
            "matcher_dustbin": float(matcher.dustbin),
        }


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> DescriptorTask:
    """Find the points of the corpus. Raises InputError: there are too few."""
    halves = split(train.corpus)
    scenes = prepare_points(train.corpus, range(train.corpus.scenes), progress, workers)
    batches = PatchBatches({i: scenes[i] for i in halves.training}, train.descriptor, seed)
    if batches.is_empty:
        raise InputError(
            "train.corpus: no two frames show enough common points: more scenes or frames, or smaller turns"
        )
    trials = validation_pairs({i: scenes[i] for i in halves.validation}, seed)
    late_from = round(train.descriptor.late_from * train.schedule.steps)
    return DescriptorTask(batches, trials, train.descriptor, late_from)
