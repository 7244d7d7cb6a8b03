"""Scores of trained networks on bodies that they have not seen, and the landmarks that they learn from.

    python -m lab.frontend.networks [descriptor] [SEQ ...] [--weights FILE]
    python -m lab.frontend.networks surface CONFIG --weights FILE ... [--more K]
    python -m lab.frontend.networks landmarks CONFIG [--more K] [--chance 12]

``descriptor``: nearest neighbours among key points at 30 and 60 degrees, on simulated sequences; without any,
on the scenes of configs/frontend_test. ``surface``: the scores of training on the held-out bodies of a
configuration, or of its K-th further corpus. ``landmarks``: by family the median number of landmarks of a
body, the share of the key points that show one, and the share of the landmarks that chance explains: their
number when the key points of each image are displaced by one vector of 4 to 7 px, over their number.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from lab.command import ROOT, Short, Workers, command, short_scene, simulated
from lab.presentation import print_table
from polhode.config.loader import load_config
from polhode.frontend.features.patch_descriptors import descriptor_network
from polhode.frontend.networks.surface import SurfaceNet
from polhode.frontend.networks.weights import load_weights, shipped_path
from polhode.runtime.progress import Silent
from polhode.train.descriptor.scores import describe_patches, score, validation_pairs
from polhode.train.descriptor.surface_points import find_points
from polhode.train.surface.landmarks import KnownBody, corpus_of, find_landmarks, prepare_bodies
from polhode.train.surface.scores import score_trials, trials_of

METHODS = {"rootsift": "RootSIFT", "surface_rootsift": "on patches", "rank_1": "network"}


def main(
    network: Positional[Literal["descriptor", "surface", "landmarks"]] = "descriptor",
    inputs: Positional[Annotated[tuple[Path, ...], arg(help="Sequences, or a configuration.")]] = (),
    weights: Annotated[tuple[Path, ...], arg(help="Files; without them the shipped ones.")] = (),
    more: Annotated[int, arg(help="Number of the further corpus; 0: the corpus.")] = 0,
    chance: Annotated[int, arg(help="Bodies of a family for the share of chance.")] = 12,
    workers: Workers = 1,
    short: Short = False,
) -> None:
    """Print the table."""
    if network == "descriptor":
        if short:
            folders: tuple[Path, ...] = (short_scene(),)
        else:
            configs = sorted((ROOT / "configs/frontend_test").glob("*.yaml"))
            folders = inputs or tuple(simulated(c, ROOT / "data/frontend_test" / c.stem) for c in configs)
        head = [f"{angle} deg {title}" for angle in ("30", "60") for title in METHODS.values()]
        print_table(["sequence", *head, "reliability AUC"], _rows(folders, weights[0] if weights else None))
        return
    config = load_config(inputs[0])
    assert config.train is not None
    corpus, surface = corpus_of(config.train, more)
    bodies = prepare_bodies(corpus, surface, Silent(), workers)
    if network == "landmarks":
        print_table("family | bodies | landmarks of a body | key points that show one [%] | by chance",
                    _families(bodies, corpus.families, chance))  # fmt: skip
        return
    trials = trials_of({i: known for i, known in bodies.items() if corpus.is_validation(i)}, config.seed)
    found = []
    for path in weights or (shipped_path("surface"),):
        trained = SurfaceNet()
        load_weights(trained, path)
        found.append(score_trials(trained, trials))
    names = [path.stem for path in weights] or ["shipped"]
    print_table(["score", *names], ([name, *(f"{each[name]:.3f}" for each in found)] for name in found[0]))


def _rows(folders: tuple[Path, ...], weights: Path | None) -> Iterator[list[str]]:
    """One for each sequence, then the means of what is known."""
    trained = descriptor_network(weights)
    columns = [f"{method}_at_{angle}" for angle in ("30", "60") for method in METHODS] + ["reliability_auc"]
    rows = []
    for folder in folders:
        pairs = validation_pairs({0: find_points(folder)}, 1)
        scores = score(pairs, lambda patches: describe_patches(trained, patches))
        rows.append([scores.get(column, np.nan) for column in columns])
        yield [folder.name, *(f"{value:.3f}" for value in rows[-1])]
    yield ["mean", *(f"{value:.3f}" for value in np.nanmean(rows, axis=0))]


def _families(bodies: dict[int, KnownBody], families: tuple[str, ...], of: int) -> Iterator[list[object]]:
    rng = np.random.default_rng(0)
    for name in (*families, "all"):
        own = [known for k, known in bodies.items() if name in ("all", families[k % len(families)])]
        count = [int(np.sum(~known.landmarks.is_weak)) for known in own]
        shown = np.concatenate([known.landmarks.landmark >= 0 for known in own])
        by_chance = there = 0
        for k in rng.permutation(len(own))[:of]:
            turn, length_px = rng.uniform([[0.0], [4.0]], [[2.0 * np.pi], [7.0]], (2, len(own[k].body.grey)))
            shift_px = length_px[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
            by_chance += int(np.sum(~find_landmarks(own[k].body, shift_px).is_weak))
            there += count[k]
        share = by_chance / max(there, 1)
        yield [name, len(own), f"{np.median(count):.0f}", f"{100 * shown.mean():.0f}", f"{share:.2f}"]


if __name__ == "__main__":
    command(main)
