"""The training loop: AdamW with warm-up and cosine decay; validation, curves and checkpoints.

A step depends only on the seed, its number and the state before it, so a resumed training ends with the
weights of an uninterrupted one. AdamW: Loshchilov and Hutter, "Decoupled weight decay regularization", 2019;
cosine decay: the same authors, "SGDR", 2017. Checkpoints are written atomically; one of another training is
refused.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from polhode.config.train_settings import Schedule
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Progress
from polhode.train.checkpoint import TrainingState, read_checkpoint, write_checkpoint
from polhode.train.curves import Curves
from polhode.train.task import Batch, Task

WEIGHT_DECAY = 1e-2
CLIP_NORM = 1.0
"""Largest norm of a gradient; a larger one is scaled down."""
PREFETCHED = 2
"""Batches that each process prepares while a GPU is busy."""


@dataclass(frozen=True)
class TrainingOutcome:
    """State and scores at the end of a training."""

    step: int
    finished: bool
    """False if the time limit was reached; the same command resumes"""
    elapsed_s: float
    """Training time of all calls [s]"""
    scores: Mapping[str, float]


class Batches(Dataset[Batch]):
    """The batches of steps, counted from ``start``."""

    def __init__(self, task: Task, start: int, stop: int) -> None:
        self._task, self._start, self._stop = task, start, stop

    def __len__(self) -> int:
        return self._stop - self._start

    def __getitem__(self, index: int) -> Batch:
        return self._task.batch(self._start + index)


class TrainingLoop:
    """One training in the folder ``output``."""

    def __init__(self, task: Task, schedule: Schedule, output: Path, seed: int, workers: int = 1) -> None:
        """``workers``: processes that prepare batches for a GPU."""
        self._workers = workers
        self._task, self._schedule, self._output, self._seed = task, schedule, output, seed
        self._device = device_of(schedule)
        torch.set_num_threads(schedule.threads)
        task.model.to(self._device)
        decayed = [p for p in task.model.parameters() if p.ndim > 1]
        others = [p for p in task.model.parameters() if p.ndim <= 1]
        groups: list[dict[str, Any]] = [{"params": decayed}, {"params": others, "weight_decay": 0.0}]
        self._optimizer = torch.optim.AdamW(groups, lr=schedule.learning_rate, weight_decay=WEIGHT_DECAY)
        on_gpu = self._device.type == "cuda"
        wanted = schedule.precision
        self._mixed = wanted == "mixed" or (wanted == "automatic" and on_gpu)
        self._half = torch.float16 if on_gpu and not torch.cuda.is_bf16_supported() else torch.bfloat16
        # Gradients underflow only in float16.
        scaled = self._mixed and self._half is torch.float16
        self._scaler = torch.amp.GradScaler(self._device.type, enabled=scaled)

    def run(self, setting: Mapping[str, Any], progress: Progress) -> TrainingOutcome:
        """Train to the last step or to the time limit. ``setting``: settings on which the weights depend.

        Raises InputError: the output folder contains another training; RunFailure: the loss is not finite.
        """
        step, before_s = self._resume(setting)
        start = perf_counter()
        scores: Mapping[str, float] = {}
        title = f"training {self._task.name}" + (f" (from step {step})" if step else "")
        last = self._schedule.steps
        with closing(Curves(self._output, step)) as curves, progress.stage(title, last - step) as advance:
            try:
                for batch in self._batches(step, last):
                    terms = self._step(step, batch)
                    step += 1
                    advance()
                    if step % self._schedule.log_every == 0 or step == last:
                        curves.add(step, {"train": _numbers(self._task.name, step, terms)})
                    elapsed_s = before_s + perf_counter() - start
                    time_is_up = self._time_is_up(perf_counter() - start)
                    if step % self._schedule.validate_every == 0 or step == last or time_is_up:
                        scores = self._validate()
                        curves.add(step, {"validation": scores})
                    if step % self._schedule.checkpoint_every == 0 or step == last or time_is_up:
                        self._save(step, elapsed_s, setting)
                    if time_is_up:
                        break
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"interrupted at step {step}; the same command resumes from the last checkpoint"
                ) from None
        return TrainingOutcome(
            step, step == last, before_s + perf_counter() - start, scores or self._validate()
        )

    def _time_is_up(self, seconds: float) -> bool:
        limit = self._schedule.time_limit_s
        return limit is not None and seconds >= limit

    def _resume(self, setting: Mapping[str, Any]) -> tuple[int, float]:
        """Load the checkpoint, if there is one. Returns the steps done and the seconds used."""
        state = read_checkpoint(
            self._output, setting, self._schedule.steps, self._task.model, self._optimizer
        )
        if state is None:
            return 0, 0.0
        # the scale of another precision does not fit, and finds its value again by itself
        if state.scaler.keys() == self._scaler.state_dict().keys():
            self._scaler.load_state_dict(state.scaler)
        return state.step, state.elapsed_s

    def _save(self, step: int, elapsed_s: float, setting: Mapping[str, Any]) -> None:
        state = TrainingState(
            step=step, elapsed_s=elapsed_s, scaler=self._scaler.state_dict(), setting=dict(setting)
        )
        write_checkpoint(self._output, state, self._task.model, self._optimizer)

    def _batches(self, start: int, stop: int) -> Iterator[Batch]:
        """The batches of the steps; for a GPU, which is faster than they are, processes prepare them."""
        if self._device.type != "cuda":
            yield from (self._task.batch(step) for step in range(start, stop))
            return
        if start == stop:
            return
        # The first one shows here, rather than in another process, what is wrong with the data.
        yield self._task.batch(start)
        yield from prepared_batches(self._task, start + 1, stop, self._workers)

    def _step(self, step: int, batch: Batch) -> Mapping[str, Tensor]:
        torch.manual_seed(self._seed * 1_000_003 + step)
        self._task.model.train()
        rate = learning_rate(self._schedule, step)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        batch = {name: value.to(self._device, non_blocking=True) for name, value in batch.items()}
        with torch.autocast(self._device.type, self._half, enabled=self._mixed):
            loss, terms = self._task.loss(batch)
        if not torch.isfinite(loss):
            raise RunFailure(
                f"the loss is no longer a number at step {step}: lower train.schedule.learning_rate"
            )
        self._optimizer.zero_grad(set_to_none=True)
        self._scaler.scale(loss).backward()
        self._scaler.unscale_(self._optimizer)
        norm = nn.utils.clip_grad_norm_(self._task.model.parameters(), CLIP_NORM)
        # The gradient of a fit to collinear points is not finite: such a step is skipped.
        if torch.isfinite(norm) or self._scaler.is_enabled():
            self._scaler.step(self._optimizer)
        self._scaler.update()
        return {"loss": loss, **terms, "gradient": norm, "learning_rate": torch.tensor(rate)}

    def _validate(self) -> Mapping[str, float]:
        self._task.model.eval()
        with torch.no_grad():
            return {name: float(value) for name, value in self._task.validate().items()}


def prepared_batches(task: Task, start: int, stop: int, workers: int) -> Iterable[Batch]:
    """The batches of the steps in their order, from ``workers`` processes."""
    pinned = torch.cuda.is_available()
    batches = Batches(task, start, stop)
    return DataLoader(
        batches,
        None,
        num_workers=workers,
        prefetch_factor=PREFETCHED,
        pin_memory=pinned,
        multiprocessing_context="fork",
        worker_init_fn=_one_thread,
    )


def _one_thread(_: int) -> None:
    cv2.setNumThreads(1)


def learning_rate(schedule: Schedule, step: int) -> float:
    """Learning rate of a step, counted from 0."""
    if step < schedule.warmup_steps:
        return schedule.learning_rate * (step + 1) / schedule.warmup_steps
    done = (step - schedule.warmup_steps) / max(1, schedule.steps - schedule.warmup_steps)
    return schedule.learning_rate * 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))


def _numbers(name: str, step: int, terms: Mapping[str, Tensor]) -> dict[str, float]:
    numbers = {key: float(value.detach()) for key, value in terms.items()}
    for key, value in numbers.items():
        if not math.isfinite(value) and key != "gradient":
            raise RunFailure(f"{name}: {key} is not a number at step {step}")
    return numbers


def device_of(schedule: Schedule) -> torch.device:
    """Where the model is trained. Raises InputError: no GPU is there."""
    there = torch.cuda.is_available()
    if schedule.device == "cuda" and not there:
        raise InputError("train.schedule.device is cuda, but torch finds no GPU: set cpu or automatic")
    return torch.device("cuda" if there and schedule.device != "cpu" else "cpu")
