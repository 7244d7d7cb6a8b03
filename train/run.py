"""``polhode train``: render the corpus, prepare the task, train, write weights and scores."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel
from safetensors.torch import save
from torch import nn

from polhode.config import Config
from polhode.config.loader import dump_config
from polhode.config.train_settings import Train
from polhode.files.atomic import write_bytes, write_text
from polhode.files.output.marked_folder import claim, marked_folder, withdrawn_if_refused
from polhode.files.output.place import folder_place, require_writable
from polhode.frontend.networks.weights import load_weights
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress
from polhode.train.checkpoint import CHECKPOINT, require_same_training
from polhode.train.corpus import require_corpus, split
from polhode.train.task import make_task
from polhode.train.training_loop import CURVES, TrainingLoop, TrainingOutcome, device_of

FREE_KEYS = (
    "output",
    "corpus.folder",
    "schedule.time_limit_s",
    "schedule.checkpoint_every",
    "schedule.validate_every",
    "schedule.log_every",
)
"""Settings on which the weights do not depend: they may change when a training is resumed."""


COMMAND = "train"
FILES = ("config.yaml", "scores.json", CHECKPOINT)
"""Files of a training, beside the weights and the folder of curves."""


@dataclass(frozen=True)
class Trained:
    """Result of a training."""

    weights: Path
    outcome: TrainingOutcome


def train(config: Config, train: Train, progress: Progress, workers: int) -> Trained:
    """Render missing scenes of the corpus, train, write weights and scores. An interrupted training is
    resumed.

    Raises InputError: a folder contains something else or cannot be written; RunFailure: the training failed.
    """
    names = (*FILES, f"{train.task}.safetensors")
    shown = Path(f"train.output: {train.output}")
    # all that the rendering of the corpus does not change is checked before anything is written
    split(train.corpus)
    device_of(train.schedule)
    require_corpus(train.corpus)
    if train.start_from is not None and not Path(train.start_from).is_file():
        raise InputError(f"train.start_from: {train.start_from} is no file; give weights of polhode train")
    if train.task == "depth":
        cache = Path(f"train.depth.cache: {train.depth.cache}")
        require_writable(folder_place(Path(train.depth.cache), cache), cache)
    with (
        marked_folder(Path(train.output), COMMAND, names.__contains__, shown) as output,
        withdrawn_if_refused(output, COMMAND, names, (CURVES,)),
    ):
        require_same_training(output, setting_of(train, config.seed))
        claim(output, COMMAND, names)
        return _trained(config, train, output, progress, workers)


def _trained(config: Config, train: Train, output: Path, progress: Progress, workers: int) -> Trained:
    torch.manual_seed(config.seed)
    task = make_task(train, config.seed, progress, workers)
    if train.start_from is not None:
        load_weights(task.network, Path(train.start_from))
    outcome = TrainingLoop(task, train.schedule, output, config.seed, workers).run(
        setting_of(train, config.seed), progress
    )
    weights = output / f"{task.name}.safetensors"
    about = {
        "task": train.task,
        "seed": config.seed,
        "steps": f"{outcome.step} of {train.schedule.steps}",
        "scores": {name: round(value, 4) for name, value in outcome.scores.items()},
    }
    scores = {
        "task": task.name,
        "step": outcome.step,
        "finished": outcome.finished,
        "training_s": round(outcome.elapsed_s, 1),
        "parameters": sum(p.numel() for p in task.network.parameters()),
        "scores": dict(outcome.scores),
    }
    write_text(output / "config.yaml", dump_config(config, keys=("seed", "train")))
    write_weights(weights, task.network, about)
    write_text(output / "scores.json", json.dumps(scores, indent=2) + "\n")
    return Trained(weights, outcome)


def setting_of(train: Train, seed: int) -> dict[str, Any]:
    """The settings on which the weights depend: dotted key -> value."""
    others = {"descriptor", "depth", "surface"} - {train.task}
    setting: dict[str, Any] = {"seed": seed}
    waiting: list[tuple[str, Any]] = [(name, value) for name, value in train if name not in others]
    while waiting:
        key, value = waiting.pop(0)
        if isinstance(value, BaseModel):
            waiting[:0] = [(f"{key}.{name}", each) for name, each in value]
        elif isinstance(value, tuple) and any(isinstance(each, BaseModel) for each in value):
            waiting[:0] = [(f"{key}.{k}", each) for k, each in enumerate(value)]
        elif not key.endswith(FREE_KEYS):
            setting[key] = value
    return setting


def write_weights(path: Path, network: nn.Module, about: Mapping[str, Any]) -> None:
    """Write the weights as safetensors, with ``about`` as JSON under the key ``training`` of the header.

    There is only one key because safetensors writes several in arbitrary order.
    """
    weights = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    write_bytes(path, save(weights, metadata={"training": json.dumps(about)}))
