"""What the loop trains: a model, its batches, its loss, and how good it is on held-out bodies.

A task's module has ``make_task(train, seed, progress, workers) -> Task``, and is named in ``TASKS``.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Protocol, cast

from torch import Tensor, nn

from polhode.config.train import Train
from polhode.progress import Progress

Batch = dict[str, Tensor]
TASKS = {"descriptor": "polhode.train.descriptor_task", "depth": "polhode.train.depth_task"}
"""Module of each ``train.task``; imported when it is asked for."""


class Task(Protocol):
    """One network and what it learns."""

    @property
    def name(self) -> str:
        """Name of the weights: they are written to ``<name>.safetensors``."""
        ...

    @property
    def model(self) -> nn.Module:
        """Everything that learns, on the CPU when it is made; the loop moves it to its device."""
        ...

    @property
    def network(self) -> nn.Module:
        """The part of ``model`` that is shipped; often all of it."""
        ...

    def batch(self, step: int) -> Batch:
        """The batch of a step, on the CPU: a function of seed and step alone, so that training resumes."""
        ...

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """What is made small (a scalar), and its parts or other scalars for the curves.

        The batch is on the model's device; in mixed precision this runs under autocast.
        """
        ...

    def validate(self) -> Mapping[str, float]:
        """Scores on the held-out bodies, of the model as it is (in evaluation mode, without gradients)."""
        ...


def make_task(train: Train, seed: int, progress: Progress, workers: int) -> Task:
    """The task that the configuration names; its data are prepared. Weights start by ``seed``."""
    module = import_module(TASKS[train.task])
    return cast(Task, module.make_task(train, seed, progress, workers))
