"""Scores of descriptor weights on chosen sequences, such as bodies and textures that training never saw.

    python -m polhode.train.score_weights SEQ... [--weights FILE]

SEQ: folders of ``polhode simulate`` with a rectified rig. A table: for each sequence, the share of the key
points found again whose most similar key point in the other frame is the right one.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from polhode.errors import InputError
from polhode.frontend.features.network_descriptor import descriptor_network
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.simulation.dataset.sequence import SCENE_FILE
from polhode.train.descriptor_scores import ANGLES_DEG, make_trials, score
from polhode.train.descriptor_task import described_by
from polhode.train.points import find_points

METHODS = {"rootsift": "RootSIFT", "surface_rootsift": "on patches", "rank_1": "network"}
SEED = 1


def score_sequence(folder: Path, network: DescriptorNet) -> Mapping[str, float]:
    """Scores on one sequence. Raises InputError: it was not simulated."""
    if not (folder / SCENE_FILE).is_file():
        raise InputError(f"{folder} holds no {SCENE_FILE}: give a sequence of polhode simulate")
    return score(make_trials({0: find_points(folder)}, SEED), lambda patches: described_by(network, patches))


def table(scores: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown: a row a sequence and one of means; columns by angle and method."""
    columns = [f"{method}_at_{angle}" for angle in ANGLES_DEG for method in METHODS]
    head = [f"{angle} deg {title}" for angle in ANGLES_DEG for title in METHODS.values()]
    columns.append("reliability_auc")
    rows = [["sequence", *head, "reliability AUC"], ["---"] * (len(columns) + 1)]
    for name, values in scores.items():
        rows.append([name, *(f"{values[c]:.3f}" if c in values else "" for c in columns)])
    known = [[values[c] for values in scores.values() if c in values] for c in columns]
    rows.append(["mean", *(f"{np.mean(each):.3f}" if each else "" for each in known)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Score descriptor weights on simulated sequences."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.score_weights", description=main.__doc__)
    parser.add_argument("sequences", type=Path, nargs="+", metavar="SEQ")
    parser.add_argument("--weights", type=Path, help="file; those shipped when absent")
    options = parser.parse_args(arguments)
    try:
        network = descriptor_network(options.weights)
        print(table({folder.name: score_sequence(folder, network) for folder in options.sequences}))
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
