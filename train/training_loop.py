"""The training loop: AdamW with warm-up and cosine decay; validation, curves and checkpoints.

A step depends only on the seed, its number and the state before it, so a resumed training ends with the
weights of an uninterrupted one. AdamW: Loshchilov and Hutter, "Decoupled weight decay regularization", 2019;
cosine decay: the same authors, "SGDR", 2017. Checkpoints are written atomically; one of another training is
refused. Curves have TensorBoard's format, which ``tensorboard --logdir OUTPUT`` shows.
"""

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from polhode.config.train_settings import Schedule
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.optional_parts import missing_message
from polhode.runtime.progress import Progress
from polhode.train.checkpoint import TrainingState, read_checkpoint, write_checkpoint
from polhode.train.task import Batch, Task

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

CURVES = "curves"
"""Folder of the event files."""
WEIGHT_DECAY = 1e-2


@dataclass(frozen=True)
class TrainingOutcome:
    """State and scores at the end of a training."""

    step: int
    finished: bool
    """False if the time limit was reached; the same command resumes"""
    elapsed_s: float
    """Training time of all calls [s]"""
    scores: Mapping[str, float]


@contextmanager
def curves_writer(output: Path, first_step: int) -> Iterator["SummaryWriter"]:
    """Writer of scalars; points after ``first_step`` from an interrupted training are dropped.

    Raises InputError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard.writer import SummaryWriter
    except ImportError:
        raise InputError(f"{missing_message('tensorboard')}, which reads and writes the curves") from None
    # Names of event files begin with the second and are read in their order: two of one second may change
    # places.
    seconds = [int(file.name.split(".")[3]) for file in (output / CURVES).glob("events.out.tfevents.*")]
    while seconds and time.time() < max(seconds) + 1 <= time.time() + 1.0:
        time.sleep(0.05)
    writer = SummaryWriter(str(output / CURVES), purge_step=first_step + 1, flush_secs=20)
    try:
        yield writer
    finally:
        writer.close()


class TrainingLoop:
    """One training in the folder ``output``."""

    def __init__(self, task: Task, schedule: Schedule, output: Path, seed: int, workers: int = 1) -> None:
        """``workers``: processes that prepare batches for a GPU."""
        self._task, self._schedule, self._output = task, schedule, output
        self._seed, self._workers = seed, workers
        self._device = device_of(schedule)
        torch.set_num_threads(schedule.threads)
        task.model.to(self._device)
        parameters = list(task.model.parameters())
        groups: list[dict[str, Any]] = [
            {"params": [p for p in parameters if p.ndim > 1]},
            {"params": [p for p in parameters if p.ndim <= 1], "weight_decay": 0.0},
        ]
        self._optimizer = torch.optim.AdamW(groups, lr=schedule.learning_rate, weight_decay=WEIGHT_DECAY)
        on_gpu = self._device.type == "cuda"
        self._mixed = schedule.precision == "mixed" or (schedule.precision == "automatic" and on_gpu)
        self._half = torch.float16 if on_gpu and not torch.cuda.is_bf16_supported() else torch.bfloat16
        # Gradients underflow only in float16.
        scaled = self._mixed and self._half is torch.float16
        self._scaler = torch.amp.GradScaler(self._device.type, enabled=scaled)

    def run(self, setting: Mapping[str, Any], progress: Progress) -> TrainingOutcome:
        """Train to the last step or to the time limit. ``setting``: settings on which the weights depend.

        Raises InputError: the output folder contains another training; RunFailure: the loss is not finite.
        """
        task, schedule, last = self._task, self._schedule, self._schedule.steps
        step, before_s = 0, 0.0
        state = read_checkpoint(self._output, setting, last, task.model, self._optimizer)
        if state is not None:
            step, before_s = state.step, state.elapsed_s
            # the scale of another precision does not fit, and finds its value again by itself
            if state.scaler.keys() == self._scaler.state_dict().keys():
                self._scaler.load_state_dict(state.scaler)
        start = time.perf_counter()
        scores: Mapping[str, float] = {}
        title = f"training {task.name}" + (f" (from step {step})" if step else "")
        with curves_writer(self._output, step) as curves, progress.stage(title, last - step) as advance:
            try:
                for batch in self._batches(step, last):
                    terms = self._step(step, batch)
                    step += 1
                    advance()
                    seconds = time.perf_counter() - start
                    ends = step == last or (
                        schedule.time_limit_s is not None and seconds >= schedule.time_limit_s
                    )
                    if step % schedule.log_every == 0 or step == last:
                        for key, value in terms.items():
                            number = float(value.detach())
                            if not math.isfinite(number) and key != "gradient":
                                raise RunFailure(f"{task.name}: {key} is not a number at step {step}")
                            curves.add_scalar(f"train/{key}", number, step)
                    if step % schedule.validate_every == 0 or ends:
                        scores = self._validate()
                        for key, score in scores.items():
                            curves.add_scalar(f"validation/{key}", score, step)
                    if step % schedule.checkpoint_every == 0 or ends:
                        state = TrainingState(
                            step=step,
                            elapsed_s=before_s + seconds,
                            scaler=self._scaler.state_dict(),
                            setting=dict(setting),
                        )
                        write_checkpoint(self._output, state, task.model, self._optimizer)
                    if ends:
                        break
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"interrupted at step {step}; the same command resumes from the last checkpoint"
                ) from None
        elapsed_s = before_s + time.perf_counter() - start
        return TrainingOutcome(step, step == last, elapsed_s, scores or self._validate())

    def _batches(self, start: int, stop: int) -> Iterator[Batch]:
        """The batches of the steps; for a GPU, which is faster than they are, processes prepare them."""
        if self._device.type != "cuda":
            yield from (self._task.batch(step) for step in range(start, stop))
        elif start < stop:
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
        # largest norm of a gradient; a larger one is scaled down
        norm = nn.utils.clip_grad_norm_(self._task.model.parameters(), 1.0)
        # The gradient of a fit to collinear points is not finite: such a step is skipped.
        if torch.isfinite(norm) or self._scaler.is_enabled():
            self._scaler.step(self._optimizer)
        self._scaler.update()
        return {"loss": loss, **terms, "gradient": norm, "learning_rate": torch.tensor(rate)}

    def _validate(self) -> Mapping[str, float]:
        self._task.model.eval()
        with torch.no_grad():
            return {name: float(value) for name, value in self._task.validate().items()}


class _Batches(Dataset[Batch]):
    """The batches of steps, counted from ``start``."""

    def __init__(self, task: Task, start: int, stop: int) -> None:
        self._task, self._start, self._stop = task, start, stop

    def __len__(self) -> int:
        return self._stop - self._start

    def __getitem__(self, index: int) -> Batch:
        return self._task.batch(self._start + index)


def prepared_batches(task: Task, start: int, stop: int, workers: int) -> Iterable[Batch]:
    """The batches of the steps in their order, from ``workers`` processes."""
    # batches that each process prepares while a GPU is busy
    return DataLoader(
        _Batches(task, start, stop),
        None,
        num_workers=workers,
        prefetch_factor=2,
        pin_memory=torch.cuda.is_available(),
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


def device_of(schedule: Schedule) -> torch.device:
    """Where the model is trained. Raises InputError: no GPU is there."""
    there = torch.cuda.is_available()
    if schedule.device == "cuda" and not there:
        raise InputError("train.schedule.device is cuda, but torch finds no GPU: set cpu or automatic")
    return torch.device("cuda" if there and schedule.device != "cpu" else "cpu")
