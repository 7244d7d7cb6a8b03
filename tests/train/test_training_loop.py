"""The loop, on a line that is fitted: it learns, resumes exactly, stops in time, and says what is wrong."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from polhode.config.train_settings import Schedule
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.train.checkpoint import CHECKPOINT
from polhode.train.task import Batch
from polhode.train.training_loop import TrainingLoop, learning_rate, prepared_batches
from tests.train.curves import read_curves

SETTING = {"seed": 1}
SCHEDULE = Schedule(
    steps=60, learning_rate=0.05, warmup_steps=5, log_every=1, checkpoint_every=10, validate_every=20
)

IN_THIS_PROCESS = SCHEDULE.model_copy(update={"device": "cpu"})
"""For tasks that interrupt: for a GPU, other processes prepare the batches"""


class Line:
    """y = 2 x - 1, with dropout so that the loop's own random numbers matter."""

    name = "line"

    def __init__(self, stop_at: int | None = None, spoilt_at: int | None = None) -> None:
        torch.manual_seed(0)
        self.stop_at, self.spoilt_at = stop_at, spoilt_at
        layers = nn.Linear(1, 16), nn.ReLU(), nn.Dropout(0.1), nn.Linear(16, 1)
        self.model = self.network = nn.Sequential(*layers)

    def batch(self, step: int) -> Batch:
        if step == self.stop_at:
            raise KeyboardInterrupt
        rng = np.random.default_rng([3, step])
        x = torch.from_numpy(rng.uniform(-1, 1, (32, 1)).astype(np.float32))
        return {"x": x, "y": 2 * x - 1 if step != self.spoilt_at else x * torch.nan}

    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        error = self.model(batch["x"]) - batch["y"]
        return (error**2).mean(), {"largest": error.abs().max()}

    def validate(self) -> Mapping[str, float]:
        assert not self.model.training
        x = torch.linspace(-1, 1, 11, device=next(self.model.parameters()).device)[:, None]
        return {"error": float((self.model(x) - (2 * x - 1)).abs().mean())}


def weights(task: Line) -> Tensor:
    return torch.cat([p.detach().cpu().flatten() for p in task.model.parameters()])


def test_it_learns_and_is_not_done_again(tmp_path: Path) -> None:
    outcome = TrainingLoop(Line(), SCHEDULE, tmp_path, 1).run(SETTING, Silent())
    assert outcome.finished
    assert outcome.step == 60
    assert outcome.scores["error"] < 0.3
    loss = read_curves(tmp_path)["train/loss"]
    assert loss[-10:, 1].mean() < 0.2 * loss[:5, 1].mean()
    again = TrainingLoop(Line(stop_at=0), SCHEDULE, tmp_path, 1).run(SETTING, Silent())
    assert again.finished
    assert again.scores == outcome.scores


def test_an_interrupted_training_ends_with_the_same_weights_and_curves(tmp_path: Path) -> None:
    whole = Line()
    TrainingLoop(whole, IN_THIS_PROCESS, tmp_path / "whole", 1).run(SETTING, Silent())
    (tmp_path / "parts").mkdir()
    with pytest.raises(KeyboardInterrupt, match=r"interrupted at step 37"):
        TrainingLoop(Line(stop_at=37), IN_THIS_PROCESS, tmp_path / "parts", 1).run(SETTING, Silent())
    taken_up = Line()
    TrainingLoop(taken_up, IN_THIS_PROCESS, tmp_path / "parts", 1).run(SETTING, Silent())
    assert torch.equal(weights(whole), weights(taken_up))
    curves = read_curves(tmp_path / "parts")
    assert curves["train/loss"][:, 0].tolist() == list(range(1, 61))
    assert curves["validation/error"][:, 0].tolist() == [20, 40, 60]


def test_the_time_limit_leaves_a_checkpoint(tmp_path: Path) -> None:
    hasty = SCHEDULE.model_copy(update={"time_limit_s": 1e-6})
    outcome = TrainingLoop(Line(), hasty, tmp_path, 1).run(SETTING, Silent())
    assert (outcome.finished, outcome.step) == (False, 1)
    assert (tmp_path / CHECKPOINT).is_file()
    assert TrainingLoop(Line(), hasty, tmp_path, 1).run(SETTING, Silent()).step == 2


def test_mixed_precision_learns_and_a_loss_that_is_no_number_ends_the_training(tmp_path: Path) -> None:
    mixed = SCHEDULE.model_copy(update={"precision": "mixed", "device": "cpu"})
    assert TrainingLoop(Line(), mixed, tmp_path / "mixed", 1).run(SETTING, Silent()).scores["error"] < 0.3
    with pytest.raises(RunFailure, match=r"no longer a number at step 7: lower train.schedule.learning_rate"):
        TrainingLoop(Line(spoilt_at=7), SCHEDULE, tmp_path, 1).run(SETTING, Silent())


def test_the_learning_rate_grows_then_falls_to_nothing() -> None:
    rates = [learning_rate(SCHEDULE, step) for step in range(60)]
    assert rates[0] == pytest.approx(0.01)
    assert max(rates) == pytest.approx(0.05)
    assert all(later <= earlier for earlier, later in pairwise(rates[5:]))
    assert rates[-1] < 1e-3 * 0.05


def test_batches_from_processes_are_those_of_one() -> None:
    task = Line()
    prepared = list(prepared_batches(task, 3, 9, workers=2))
    assert len(prepared) == 6
    for step, batch in enumerate(prepared, 3):
        assert torch.equal(batch["x"], task.batch(step)["x"])
