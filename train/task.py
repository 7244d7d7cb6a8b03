"""The interface of training tasks: a model, its batches, its loss, and its scores on held-out bodies.

The module of a task defines ``make_task(train, seed, progress, workers) -> Task`` and is registered in
``TASKS``.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Protocol, cast

from torch import Tensor, nn

from polhode.config.train_settings import Train
from polhode.runtime.progress import Progress

Batch = dict[str, Tensor]
TASKS = {
    "descriptor": "polhode.train.descriptor.task",
    "depth": "polhode.train.disparity.task",
    "surface": "polhode.train.surface.task",
}
"""Module of each ``train.task``; imported when it is used."""


class Task(Protocol):
    """A network and its training objective."""

    name: str
    """The weights are written to ``<name>.safetensors``"""

    @property
    def model(self) -> nn.Module:
        """All parameters that are trained, initially on the CPU; the loop moves them to its device."""

    @property
    def network(self) -> nn.Module:
        """The part of ``model`` whose weights are written; often all of it."""

    def batch(self, step: int) -> Batch:
        """The batch of a step, on the CPU, by seed and step alone, so that training can be resumed."""

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """The loss (a scalar), and its terms or other scalars for the curves.

        The batch is on the model's device; in mixed precision this runs under autocast.
        """

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, in evaluation mode and without gradients."""


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> Task:
    """The configured task with its data prepared; ``seed`` determines the initial weights."""
    module = import_module(TASKS[train.task])
    return cast(Task, module.make_task(train, seed, progress, workers))
