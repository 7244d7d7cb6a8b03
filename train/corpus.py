"""The training corpus: many short simulated sequences with ground truth for each pixel, stored like any
sequence.

    python -m polhode.train.corpus CONFIG [--workers N]

renders the missing scenes in the folder of ``train.corpus``; ``polhode train`` does the same before training.
Folder ``0007`` is scene 7. ``corpus.yaml`` contains the settings from which the scenes were drawn.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from polhode.atomic import write_text
from polhode.config.loader import load_config
from polhode.config.train import Corpus, Train
from polhode.errors import InputError
from polhode.processes import in_order
from polhode.progress import Progress, Silent
from polhode.simulation.dataset.sequence import SCENE_FILE, simulate
from polhode.train.random_scene import random_scene

NOTE = "corpus.yaml"
FREE_KEYS = {"folder", "scenes", "validation_every"}
"""Settings on which no scene depends: they may change without rendering the scenes again."""


@dataclass(frozen=True)
class Split:
    """Numbers of the scenes; all scenes of one body are in the same part."""

    training: tuple[int, ...]
    validation: tuple[int, ...]


def split(corpus: Corpus) -> Split:
    """Training and held-out scenes. Raises InputError: no scene is held out."""
    held_out = tuple(i for i in range(corpus.scenes) if corpus.is_validation(i))
    if not held_out:
        raise InputError(
            f"train.corpus: {corpus.scenes} scenes with validation_every {corpus.validation_every} hold out "
            "none: lower validation_every"
        )
    return Split(tuple(i for i in range(corpus.scenes) if i not in held_out), held_out)


def scene_folder(corpus: Corpus, index: int) -> Path:
    """Folder of scene ``index``."""
    return Path(corpus.folder) / f"{index:04d}"


def render_corpus(corpus: Corpus, progress: Progress, workers: int) -> None:
    """Render the missing scenes; an interrupted scene is continued.

    Raises InputError: the folder contains scenes drawn from other settings; RunFailure: a process was killed.
    """
    folder = Path(corpus.folder)
    _claim(folder, corpus)
    missing = [i for i in range(corpus.scenes) if not (scene_folder(corpus, i) / SCENE_FILE).is_file()]
    if not missing:
        return
    with progress.stage(
        f"rendering scenes ({corpus.scenes - len(missing)} were there)", len(missing)
    ) as advance:
        for _ in in_order(_render, [(corpus, i) for i in missing], workers):
            advance()


def _render(work: tuple[Corpus, int]) -> None:
    corpus, index = work
    simulate(random_scene(corpus, index), _seed(corpus, index), scene_folder(corpus, index), Silent())


def _seed(corpus: Corpus, index: int) -> int:
    """Seed of the scene's noise and stars."""
    return corpus.seed * 100_000 + index


def _claim(folder: Path, corpus: Corpus) -> None:
    """Record the settings from which the folder's scenes are drawn; refuse a folder with other settings."""
    drawn = {key: value for key, value in corpus.model_dump(mode="json").items() if key not in FREE_KEYS}
    note = folder / NOTE
    if note.is_file():
        there = yaml.safe_load(note.read_text(encoding="utf-8"))
        there = there if isinstance(there, dict) else {}
        other = [key for key, value in drawn.items() if there.get(key) != value]
        if other:
            raise InputError(
                f"{folder} contains a corpus with another {', '.join(other)}: set train.corpus.folder to a "
                "new folder, or remove this one"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(note, yaml.safe_dump(drawn, sort_keys=False))
    except OSError as error:
        raise InputError(
            f"train.corpus.folder: {folder} cannot be written ({error.strerror}): choose another"
        ) from None


def required_train(train: Train | None, config: Path) -> Train:
    """The ``train`` section. Raises InputError: the configuration has none."""
    if train is None:
        raise InputError(f"{config}: no 'train' section; see configs/train/ for examples")
    return train


def main(arguments: Sequence[str] | None = None) -> None:
    """Render the corpus of a configuration."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.corpus", description=main.__doc__)
    parser.add_argument("config", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    try:
        corpus = required_train(load_config(options.config).train, options.config).corpus
        render_corpus(corpus, Silent(), options.workers)
    except InputError as error:
        parser.error(str(error))
    print(f"{corpus.scenes} scenes: {corpus.folder}")


if __name__ == "__main__":
    main()
