"""The corpus: many short simulated sequences with the truth of their pixels, on disk as any other sequence.

    python -m polhode.train.corpus CONFIG [--workers N]

renders what is missing in the folder of ``train.corpus``; ``polhode train`` does the same before it begins.
A folder ``0007`` is scene 7. ``corpus.yaml`` beside them tells what the scenes were drawn from.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from polhode.config.loader import load_config
from polhode.config.train import Corpus, Train
from polhode.errors import InputError
from polhode.processes import in_order
from polhode.progress import Progress, Silent
from polhode.simulation.dataset.sequence import SCENE_FILE, simulate
from polhode.train.scene import random_scene

NOTE = "corpus.yaml"
FREE_KEYS = {"folder", "scenes", "validation_every"}
"""Settings that no scene depends on: they may change while the scenes stay."""


@dataclass(frozen=True)
class Split:
    """Numbers of the scenes, those of one body all on one side."""

    training: tuple[int, ...]
    validation: tuple[int, ...]


def split(corpus: Corpus) -> Split:
    """Training and held-out scenes. Raises InputError: one side is empty."""
    held_out = tuple(i for i in range(corpus.scenes) if corpus.is_validation(i))
    if not held_out:
        raise InputError(
            f"train.corpus: {corpus.scenes} scenes with validation_every {corpus.validation_every} hold out "
            "none: lower validation_every"
        )
    return Split(tuple(i for i in range(corpus.scenes) if i not in held_out), held_out)


def scene_folder(corpus: Corpus, index: int) -> Path:
    """Where scene ``index`` is, or will be."""
    return Path(corpus.folder) / f"{index:04d}"


def render_corpus(corpus: Corpus, progress: Progress, workers: int) -> None:
    """Render the scenes that are missing; an interrupted scene goes on where it was.

    Raises InputError: the folder holds scenes drawn from other ranges; RunFailure: a process was killed.
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
    """Note what the folder's scenes are drawn from; refuse a folder of others."""
    drawn = {key: value for key, value in corpus.model_dump(mode="json").items() if key not in FREE_KEYS}
    note = folder / NOTE
    if note.is_file():
        there = yaml.safe_load(note.read_text(encoding="utf-8"))
        there = there if isinstance(there, dict) else {}
        other = [key for key, value in drawn.items() if there.get(key) != value]
        if other:
            raise InputError(
                f"{folder} holds a corpus with another {', '.join(other)}: set train.corpus.folder to a new "
                "folder, or remove this one"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        partial = note.with_suffix(f".partial-{os.getpid()}")
        partial.write_text(yaml.safe_dump(drawn, sort_keys=False), encoding="utf-8")
        partial.replace(note)
    except OSError as error:
        raise InputError(
            f"train.corpus.folder: {folder} cannot be written ({error.strerror}): choose another"
        ) from None


def required_train(train: Train | None, config: Path) -> Train:
    """The section, where there is one. Raises InputError: the configuration trains nothing."""
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
