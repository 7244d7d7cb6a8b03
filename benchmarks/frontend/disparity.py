"""Dense disparity against the truth, on scenes that no training has seen (configs/depth_test/).

    python -m benchmarks.frontend.disparity [--short] [--sequences FOLDER ...]

Methods: ``sgbm`` is OpenCV's semi-global matching alone (8 paths, blocks of 5, checked left against right,
specks removed); ``classical`` is method sgbm of this program, refined and smoothed; ``network`` is method
network. All get the same mask and the true range of disparities. What is counted are the pixels of the
target in direct sunlight that both cameras see. Sequences are rendered to data/depth_test/ when missing.

Columns: density [%]; share of the found disparities off by more than 1 px [%], of all, and at the density of
sgbm (the most certain ones); median error [px]; share of errors within one and two sigma [%]; seconds of a
core.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from benchmarks.command import ROOT, Short, command, simulated
from benchmarks.presentation import print_table
from polhode.config.frontend_settings import Depth
from polhode.dataset import open_sequence
from polhode.frontend.disparity.depth import crop_disparity
from polhode.frontend.disparity.sgbm import StereoCrop, cut_crop, match_checked
from polhode.frontend.rectification import make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.train.disparity.samples import TrueDisparity, true_disparities

Floats = NDArray[np.float32]
Method = Callable[[StereoCrop], tuple[Floats, Floats | None]]
HEAD = "scene | method | density | bad 1 px | at equal density | median px | in 1 sigma | in 2 sigma | s"


@dataclass(frozen=True)
class DisparityErrors:
    """Of all asked pixels (n,) of a scene, in order of the pairs; NaN where the method gives none."""

    error: Floats
    """absolute [px]"""
    sigma: Floats | None
    seconds: float
    """of one core, a pair"""


def all_methods(weights: Path | None) -> dict[str, Method]:
    """What is compared; each gives disparity and sigma (h, w) of a crop."""
    peer = Depth(block_px=5)
    ours = {name: Depth(method=kind) for name, kind in (("classical", "sgbm"), ("network", "network"))}
    if weights is not None:
        ours["network"] = ours["network"].model_copy(update={"weights": str(weights)})
    found: dict[str, Method] = {"sgbm": lambda crop: (match_checked(crop, peer), None)}
    for name, config in ours.items():
        found[name] = partial(crop_disparity, config=config)
    return found


def measure(folder: Path, method: Method, pairs: int | None) -> DisparityErrors:
    """One method on the pairs of a sequence."""
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    errors, sigmas, seconds = [], [], 0.0
    count = len(sequence) if pairs is None else min(pairs, len(sequence))
    for k in range(count):
        raw = sequence.read_pair(k)
        left, right = rectifier(raw.left, 0), rectifier(raw.right, 1)
        truth, _ = true_disparities(sequence, rectifier, k)
        crop = cut_crop(left, right, target_mask(left), _span(truth), Depth())
        begin = process_time()
        disparity, sigma = method(crop)
        seconds += process_time() - begin
        asked = (truth.visible & truth.sunlit)[crop.inner]
        errors.append(np.abs(disparity + crop.shift_px - truth.disparity[crop.inner])[asked])
        if sigma is not None:
            sigmas.append(np.where(np.isfinite(disparity), sigma, np.nan)[asked])
        # Sunlit pixels beside the mask count as not found.
        missed = int((truth.visible & truth.sunlit).sum() - asked.sum())
        errors.append(np.full(missed, np.nan, dtype=np.float32))
        if sigma is not None:
            sigmas.append(np.full(missed, np.nan, dtype=np.float32))
    return DisparityErrors(
        np.concatenate(errors), np.concatenate(sigmas) if sigmas else None, seconds / max(count, 1)
    )


def row(errors: DisparityErrors, peer_density: float) -> list[float]:
    """Numbers of the columns."""
    found = np.isfinite(errors.error)
    density = float(found.mean())
    bad = float(np.mean(errors.error[found] > 1.0))
    at_equal, within = bad, [float("nan"), float("nan")]
    if errors.sigma is not None:
        wanted = round(peer_density * len(errors.error))
        most_certain = np.argsort(np.where(found, errors.sigma, np.inf), kind="stable")[:wanted]
        # A pixel that is missing at the peer's density counts as wrong.
        at_equal = float(np.mean(~(errors.error[most_certain] <= 1.0)))
        within = [float(np.mean(errors.error[found] < n * errors.sigma[found])) for n in (1.0, 2.0)]
    median = float(np.median(errors.error[found]))
    return [100 * density, 100 * bad, 100 * at_equal, median, *(100 * w for w in within), errors.seconds]


def _cells(scene: str, name: str, numbers: list[float]) -> list[str]:
    formats = ("{:.1f}", "{:.2f}", "{:.2f}", "{:.3f}", "{:.1f}", "{:.1f}", "{:.2f}")
    return [
        scene,
        name,
        *("-" if np.isnan(x) else f.format(x) for f, x in zip(formats, numbers, strict=True)),
    ]


def _span(truth: TrueDisparity) -> tuple[float, float]:
    return float(np.nanmin(truth.disparity)), float(np.nanmax(truth.disparity))


def test_sequences() -> list[Path]:
    """The unseen scenes, rendered where they are missing."""
    configs = sorted((ROOT / "configs/depth_test").glob("*.yaml"))
    return [simulated(config, ROOT / "data/depth_test" / config.stem) for config in configs]


def main(
    short: Short = False,
    sequences: Annotated[
        tuple[Path, ...], arg(help="Sequences instead of those of configs/depth_test/.")
    ] = (),
    methods: Annotated[tuple[str, ...], arg(help="Only these methods.")] = (),
    weights: Annotated[Path | None, arg(help="Weights of the network; without it the shipped ones.")] = None,
) -> None:
    """Print the table."""
    compared = all_methods(weights)
    chosen = [name for name in compared if not methods or name in methods]
    folders = sequences or test_sequences()
    print_table(HEAD, _rows(folders, compared, chosen, 1 if short else None))


def _rows(
    folders: Iterable[Path], compared: dict[str, Method], chosen: list[str], pairs: int | None
) -> Iterator[list[str]]:
    """One for each scene and method, then the means."""
    totals: dict[str, list[list[float]]] = {name: [] for name in chosen}
    for folder in folders:
        peer = measure(folder, compared["sgbm"], pairs)
        density = float(np.isfinite(peer.error).mean())
        for name in chosen:
            errors = peer if name == "sgbm" else measure(folder, compared[name], pairs)
            totals[name].append(row(errors, density))
            yield _cells(folder.name, name, totals[name][-1])
    for name, rows in totals.items():
        yield _cells("mean", name, np.mean(rows, axis=0).tolist())


if __name__ == "__main__":
    command(main)
