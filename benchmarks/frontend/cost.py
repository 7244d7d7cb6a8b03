"""Processor time of each stage of the front end, beside OpenCV's SIFT alone on the same enlarged crops.

    python -m benchmarks.frontend.cost [SEQ ...] [--pairs 20]   by default the sequence of configs/ts38.yaml
    python -m benchmarks.frontend.cost --short                  the shipped sample, fewer pairs

One process, one core. Pairs are spread over the sequence; every two of them are matched. The stages follow
each other for each pair, SIFT's own time among them, so that other work on the machine affects all of them
alike; the figures are medians over the pairs. What bounds a stage:

    decode       reading and decompressing the two files
    SIFT         one ``detectAndCompute`` for each of the two enlarged crops
    product      the products of all descriptors of two frames, by BLAS in single precision
"""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Annotated, TypeVar

import numpy as np
from tyro.conf import arg

from benchmarks.command import DEFAULT, ROOT, Sequences, Short, command, simulated
from benchmarks.presentation import print_table
from polhode.config.frontend_settings import Frontend
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.frontend.extract import extract_pair
from polhode.frontend.features import keypoints
from polhode.frontend.features.keypoints import enlarge
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import match_method
from polhode.frontend.matching.pairs import match_pair
from polhode.frontend.rectification import rectified_images, target_crop
from polhode.pipeline.context import rectifier_of

SEED = 0
WARM = 2
"""Pairs that go first, so that what is compiled or loaded does not count."""
T = TypeVar("T")


@dataclass
class Costs:
    """Processor seconds of each call of a stage."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    began: float = 0.0

    def start(self) -> None:
        """Begin a stage."""
        self.began = process_time()

    def end(self, stage: str, result: T) -> T:
        """End it."""
        self.seconds[stage].append(process_time() - self.began)
        return result

    def median_ms(self, stage: str, calls: int = 1) -> float:
        """Median [ms] over the groups of so many calls that follow each other, after the first ``WARM``."""
        seconds = np.array(self.seconds[stage][WARM * calls :])
        return 1e3 * float(np.median(seconds.reshape(-1, calls).sum(axis=1)))


def main(
    sequences: Sequences = (),
    pairs: Annotated[int, arg(help="Stereo pairs.")] = 20,
    short: Short = False,
) -> None:
    """Print the table of each sequence, by the first and by the second feature method."""
    config = load_config(ROOT / DEFAULT).frontend
    chosen = list(sequences) or [
        ROOT / "sample" if short else simulated(ROOT / "configs/ts38.yaml", ROOT / "data/ts38")
    ]
    for folder in chosen:
        for each in (config, config.second_method):
            if each is not None:
                costs, features = measure(folder, each, 6 if short else pairs)
                print(f"\n{folder.name}, {each.features.method}: {_summary(features)}\n")
                print_table("stage | ms | bound | ms | ratio", rows_of(costs))


def measure(folder: Path, config: Frontend, n_pairs: int) -> tuple[Costs, list[StereoFeatures]]:
    """The costs of the stages of so many pairs, and their features."""
    sequence, costs = open_sequence(folder), Costs()
    rectifier = rectifier_of(sequence)
    config = with_patch_size(config, sequence, rectifier)
    numbers = np.unique(np.linspace(0, len(sequence) - 1, WARM + n_pairs).round().astype(int)).tolist()
    found: list[StereoFeatures] = []
    for k in numbers:
        costs.start()
        raw = costs.end("decode", sequence.read_pair(k))
        costs.start()
        pair = costs.end("rectify, mask", rectified_images(raw, rectifier, k))
        costs.start()
        found.append(costs.end("features", extract_pair(pair, rectifier.rig, config)))
        for image, mask in ((pair.left, pair.mask_left), (pair.right, pair.mask_right)):
            crop = target_crop(mask)
            if crop is None:
                raise SystemExit(f"pair {k} does not show the target; give a sequence that does throughout")
            enlarged = enlarge(image, crop, config.features).image
            detector = keypoints._sift(config.features.contrast_threshold)
            costs.start()
            costs.end("SIFT", detector.detectAndCompute(enlarged, None))
    matcher = match_method(config)
    for i, a in enumerate(found):
        for j, b in enumerate(found[i + 1 :], start=i + 1):
            costs.start()
            costs.end("match", matcher(a, b))
            costs.start()
            costs.end("match, verify", match_pair(found, i, j, rectifier.rig, config, SEED))
            costs.start()
            costs.end("product", a.descriptors @ b.descriptors.T)
    return costs, found[WARM:]


def rows_of(costs: Costs) -> list[tuple[str, ...]]:
    """Stage, its time, what bounds it, and their ratio."""
    decode, sift, product = costs.median_ms("decode"), costs.median_ms("SIFT", 2), costs.median_ms("product")
    whole = decode + costs.median_ms("rectify, mask") + costs.median_ms("features")
    return [
        _row("decode", decode, "decode", decode),
        _row("rectify, mask", costs.median_ms("rectify, mask"), "decode", decode),
        _row("features with disparity", costs.median_ms("features"), "SIFT", sift),
        _row("a stereo pair, from file to features", whole, "SIFT", sift),
        _row("matching of two frames", costs.median_ms("match"), "product", product),
        _row("the same with the geometric check", costs.median_ms("match, verify"), "product", product),
    ]


def _row(stage: str, ms: float, bound: str, bound_ms: float) -> tuple[str, ...]:
    return stage, f"{ms:.2f}", bound, f"{bound_ms:.2f}", f"{ms / max(bound_ms, 1e-9):.2f}"


def _summary(features: list[StereoFeatures]) -> str:
    return (
        f"{len(features)} pairs, {np.median([len(each) for each in features]):.0f} features in the median one"
    )


if __name__ == "__main__":
    command(main)
