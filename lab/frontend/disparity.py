"""Dense disparity against the truth, on scenes that no training has seen (configs/depth_test/).

    python -m lab.frontend.disparity [--short] [--weights FILE]

Methods: ``sgbm`` is OpenCV's semi-global matching alone (8 paths, blocks of 5, checked left against right,
specks removed); ``classical`` is method sgbm of this program, refined and smoothed; ``network`` is method
network. All get the same mask and the true range of disparities. What is counted are the pixels of the
target in direct sunlight that both cameras see. Sequences are rendered to data/depth_test/ when missing.

Columns: density [%]; share of the found disparities off by more than 1 px [%], of all, and at the density of
sgbm (the most certain ones); median error [px]; share of errors within one and two sigma [%]; seconds of a
core.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from lab.command import QUICK, ROOT, Short, command, simulated
from lab.presentation import print_table
from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import crop_disparity
from polhode.frontend.disparity.sgbm import StereoCrop, cut_crop, match_checked
from polhode.frontend.rectification import make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.records.dataset import open_sequence
from polhode.train.disparity.samples import true_disparities

Floats = NDArray[np.float32]
Method = Callable[[StereoCrop], tuple[Floats, Floats | None]]
"""Disparity and sigma (h, w) of a crop"""
HEAD = "scene | method | density | bad 1 px | at equal density | median px | in 1 sigma | in 2 sigma | s"


@dataclass(frozen=True)
class DisparityErrors:
    """Of all counted pixels (n,) of a scene, in order of the pairs; NaN where the method gives none."""

    error: Floats
    """absolute [px]"""
    sigma: Floats
    """[px]; NaN throughout where the method has none"""
    seconds: float
    """of one core, a pair"""


def main(
    short: Short = False,
    weights: Annotated[Path | None, arg(help="Weights of the network; without it the shipped ones.")] = None,
) -> None:
    """Print the table."""
    network = Depth(method="network", **({} if weights is None else {"weights": str(weights)}))
    methods: dict[str, Method] = {
        "sgbm": lambda crop: (match_checked(crop, Depth(block_px=5)), None),
        "classical": partial(crop_disparity, config=Depth(method="sgbm")),
        "network": partial(crop_disparity, config=network),
    }
    configs = sorted((ROOT / "configs/depth_test").glob("*.yaml"))
    if short:
        folders = [simulated(configs[0], ROOT / "runs/short/depth", "--scene.frames", "3", *QUICK)]
    else:
        folders = [simulated(each, ROOT / "data/depth_test" / each.stem) for each in configs]
    print_table(HEAD, _rows(folders, methods, 1 if short else None))


def _rows(folders: list[Path], methods: dict[str, Method], pairs: int | None) -> Iterator[list[str]]:
    """One for each scene and method, then the means."""
    totals: dict[str, list[list[float]]] = {name: [] for name in methods}
    for folder in folders:
        found = {name: measure(folder, method, pairs) for name, method in methods.items()}
        density = float(np.isfinite(found["sgbm"].error).mean())
        for name, errors in found.items():
            totals[name].append(figures(errors, density))
            yield _cells(folder.name, name, totals[name][-1])
    for name, rows in totals.items():
        yield _cells("mean", name, np.mean(rows, axis=0).tolist())


def measure(folder: Path, method: Method, pairs: int | None) -> DisparityErrors:
    """One method on the (first) pairs of a sequence."""
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    errors, sigmas, seconds = [], [], 0.0
    count = len(sequence) if pairs is None else min(pairs, len(sequence))
    for k in range(count):
        raw = sequence.read_pair(k)
        left, right = rectifier(raw.left, 0), rectifier(raw.right, 1)
        truth, _ = true_disparities(sequence, rectifier, k)
        span = (float(np.nanmin(truth.disparity)), float(np.nanmax(truth.disparity)))
        crop = cut_crop(left, right, target_mask(left), span, Depth())
        begin = process_time()
        disparity, sigma = method(crop)
        seconds += process_time() - begin
        # Sunlit pixels beside the mask count as not found.
        error, of_crop = (np.full(truth.disparity.shape, np.nan, np.float32) for _ in range(2))
        error[crop.inner] = np.abs(disparity + crop.shift_px - truth.disparity[crop.inner])
        if sigma is not None:
            of_crop[crop.inner] = np.where(np.isfinite(disparity), sigma, np.nan)
        counted = truth.visible & truth.sunlit
        errors.append(error[counted])
        sigmas.append(of_crop[counted])
    return DisparityErrors(np.concatenate(errors), np.concatenate(sigmas), seconds / max(count, 1))


def figures(errors: DisparityErrors, peer_density: float) -> list[float]:
    """Numbers of the columns."""
    found = np.isfinite(errors.error)
    bad = float(np.mean(errors.error[found] > 1.0))
    at_equal, within = bad, [np.nan, np.nan]
    if np.isfinite(errors.sigma).any():
        wanted = round(peer_density * len(errors.error))
        most_certain = np.argsort(np.where(found, errors.sigma, np.inf), kind="stable")[:wanted]
        # A pixel that is missing at the peer's density counts as wrong.
        at_equal = float(np.mean(~(errors.error[most_certain] <= 1.0)))
        within = [float(np.mean(errors.error[found] < n * errors.sigma[found])) for n in (1.0, 2.0)]
    shares = (float(found.mean()), bad, at_equal)
    median = float(np.median(errors.error[found]))
    return [*(100 * each for each in shares), median, *(100 * each for each in within), errors.seconds]


def _cells(scene: str, name: str, numbers: list[float]) -> list[str]:
    forms = (".1f", ".2f", ".2f", ".3f", ".1f", ".1f", ".2f")
    shown = ("-" if np.isnan(x) else format(x, form) for form, x in zip(forms, numbers, strict=True))
    return [scene, name, *shown]


if __name__ == "__main__":
    command(main)
