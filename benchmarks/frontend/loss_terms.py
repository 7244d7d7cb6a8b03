"""What each term of the surface network's loss gives: trainings without it, with several seeds.

    python -m benchmarks.frontend.loss_terms [--config configs/train/surface.yaml] [--start FILE] [--seeds 3]
                                  [--bodies 126] [--steps 300] [--output runs/loss_terms] [--short]

Every training begins with the same weights (``--start``; without it, with random ones), learns from the same
bodies, and is scored on the same held-out ones. It has a folder of its own, in which an interrupted one goes
on. The first row is the mean over the seeds and their standard deviation. The pairs that are scored depend on
the seed: the other rows are the mean of each seed's differences from the first row, and their standard
deviation.

- all: every term;
- motion: without the terms of soft matches and of the motion that is fitted to them;
- consistency: without that of one landmark's places in two images;
- place, light: without that of the places in single images, of the kinds of light.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from benchmarks.command import ROOT, Short, command
from benchmarks.presentation import print_table
from polhode.config import Config
from polhode.config.loader import load_config
from polhode.config.train_settings import SurfaceLoss, Train
from polhode.progress import Silent
from polhode.train.corpus import required_train
from polhode.train.run import train

TERMS = ("all", "motion", "consistency", "place", "light")
"""What a training leaves out; all: nothing."""
SCORES = {
    "rank_1_light": "nearest right, other light",
    "rank_1_pose": "other pose",
    "rank_1_both": "both",
    "found_both": "places found again",
    "scatter_px_both": "scatter [px]",
    "residual_both": "normalised residual",
    "shadow_iou": "shadow, overlap",
    "highlight_iou": "highlight, overlap",
}
"""Scores of the table, and their titles."""


@dataclass(frozen=True)
class Extent:
    """How much each training is given."""

    seeds: int
    bodies: int
    steps: int


def main(
    config: Annotated[Path, arg(help="Configuration of the training.")] = Path("configs/train/surface.yaml"),
    start: Annotated[Path | None, arg(help="Weights with which each training begins.")] = None,
    seeds: Annotated[int, arg(help="Trainings of each kind.")] = 3,
    bodies: Annotated[int, arg(help="The first bodies of the corpus.")] = 126,
    steps: Annotated[int, arg(help="Steps of a training.")] = 300,
    output: Annotated[Path, arg(help="Folder of the trainings.")] = ROOT / "runs" / "loss_terms",
    short: Short = False,
) -> None:
    """Train what is missing and print the table."""
    extent = Extent(1, 9, 4) if short else Extent(seeds, bodies, steps)
    whole = load_config(config)
    settings = required_train(whole.train, config)
    rows = []
    every: list[dict[str, float]] = []
    for left_out in TERMS:
        found = [
            trained(whole, variant(settings, left_out, extent, start, output / f"{left_out}_{seed}"), seed)
            for seed in range(1, extent.seeds + 1)
        ]
        if left_out == "all":
            every = found
            rows.append([left_out, *(cell([scores.get(name) for scores in found]) for name in SCORES)])
        else:
            rows.append([left_out, *(cell(differences(found, every, name), "+") for name in SCORES)])
    print_table(("left out", *SCORES.values()), rows)


def differences(
    found: list[dict[str, float]], every: list[dict[str, float]], name: str
) -> list[float | None]:
    """What leaving out a term changes in a score, for each seed; None where one of the two has no score."""
    return [
        some[name] - whole[name] if name in some and name in whole else None
        for some, whole in zip(found, every, strict=True)
    ]


def variant(settings: Train, left_out: str, extent: Extent, start: Path | None, output: Path) -> Train:
    """The training without one term."""
    loss = settings.surface.loss
    weights = loss if left_out == "all" else SurfaceLoss.model_validate({**loss.model_dump(), left_out: 0.0})
    schedule = settings.schedule.model_copy(
        update={
            "steps": extent.steps,
            "warmup_steps": min(settings.schedule.warmup_steps, extent.steps // 4),
            "validate_every": extent.steps,
        }
    )
    surface = settings.surface.model_copy(update={"bodies": extent.bodies, "loss": weights})
    return settings.model_copy(
        update={
            "output": str(output),
            "start_from": None if start is None else str(start),
            "schedule": schedule,
            "surface": surface,
        }
    )


def trained(config: Config, settings: Train, seed: int) -> dict[str, float]:
    """The scores of a training, which is made if it is missing."""
    scores = Path(settings.output) / "scores.json"
    if not scores.is_file():
        train(config.model_copy(update={"seed": seed, "train": settings}), settings, Silent(), 1)
    found: dict[str, float] = json.loads(scores.read_text(encoding="utf-8"))["scores"]
    return found


def cell(values: list[float | None], sign: str = "") -> str:
    """Mean and standard deviation; ``sign`` "+": the mean always has its sign."""
    known = np.array([value for value in values if value is not None], float)
    if len(known) == 0:
        return "-"
    spread = f" ± {np.std(known, ddof=1):.3f}" if len(known) > 1 else ""
    return f"{np.mean(known):{sign}.3f}{spread}"


if __name__ == "__main__":
    command(main)
