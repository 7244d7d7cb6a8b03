"""Training samples of disparity: what the network is given, and the truth, cached on disk.

Semi-global matching of a pair takes longer than a step of training, so it is done once for each pair. A pair
gives two samples: the second is its mirror image with the cameras exchanged.
"""

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from polhode.config.depth import Depth
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.disparity.crop import cut_crop
from polhode.frontend.disparity.network import padded
from polhode.frontend.disparity.start import Start, classical_start
from polhode.frontend.rectification.rectify import Rectifier, make_rectifier
from polhode.frontend.rectification.target import target_mask
from polhode.records import Bools
from polhode.train.depth_truth import TrueDisparity, true_disparities

Floats = NDArray[np.float32]
_WIDEST_MARGIN_PX = 8.0
"""Largest margin of the searched disparities around the true ones."""


@dataclass(frozen=True)
class Sample:
    """One crop (h, w) with its truth."""

    start: Start
    truth: Floats
    """(h, w) disparity of the crop [px]; NaN beside the target"""
    visible: Bools
    """(h, w) both cameras see the surface"""
    sunlit: Bools

    def part(self, rows: slice, columns: slice) -> "Sample":
        """A rectangle of it."""
        inner = (rows, columns)
        return Sample(
            self.start.part(rows, columns), self.truth[inner], self.visible[inner], self.sunlit[inner]
        )


def build_samples(folder: Path, cache: Path, config: Depth, seed: int, every: int = 1) -> list[Path]:
    """Files with the samples of every n-th pair of one sequence; those that exist are not made again."""
    made: list[Path] = []
    sequence: StereoSequence | None = None
    index = cache / f"{folder.name}.txt"
    if index.is_file():
        return [cache / name for name in index.read_text().split()]
    cache.mkdir(parents=True, exist_ok=True)
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    for k in range(0, len(sequence), every):
        for mirrored in (False, True):
            path = cache / f"{folder.name}_{k:03d}{'m' if mirrored else ''}.npz"
            rng = np.random.default_rng([seed, k, mirrored, zlib.crc32(folder.name.encode())])
            sample = make_sample(sequence, rectifier, k, mirrored, config, rng)
            if sample is not None:
                write_sample(path, sample)
                made.append(path)
    index.write_text("\n".join(path.name for path in made))
    return made


def make_sample(
    sequence: StereoSequence,
    rectifier: Rectifier,
    k: int,
    mirrored: bool,
    config: Depth,
    rng: np.random.Generator,
) -> Sample | None:
    """The sample of pair k, or None: out of sight, or nothing matches."""
    raw = sequence.read_pair(k)
    left, right = rectifier(raw.left, 0), rectifier(raw.right, 1)
    truth = true_disparities(sequence, rectifier, k)[int(mirrored)]
    if mirrored:
        left, right = np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1])
        truth = TrueDisparity(truth.disparity[:, ::-1], truth.visible[:, ::-1], truth.sunlit[:, ::-1])
    mask = target_mask(left)
    known = np.isfinite(truth.disparity) & mask
    if known.sum() < 500:
        return None
    margins = rng.uniform(0.0, _WIDEST_MARGIN_PX, 2)
    span = (
        float(truth.disparity[known].min() - margins[0]),
        float(truth.disparity[known].max() + margins[1]),
    )
    crop = cut_crop(left, right, mask, span, config)
    start = classical_start(crop, config)
    if start is None:
        return None
    inner = crop.inner
    disparity = (truth.disparity[inner] - np.float32(crop.shift_px)).astype(np.float32)
    return Sample(start, disparity, truth.visible[inner], truth.sunlit[inner])


def write_sample(path: Path, sample: Sample) -> None:
    """The whole file or nothing."""
    arrays = {f"start_{f.name}": getattr(sample.start, f.name) for f in fields(Start)}
    partial = path.with_name(f".{path.stem}.partial-{os.getpid()}.npz")
    np.savez(
        partial,
        allow_pickle=False,
        truth=sample.truth,
        visible=sample.visible,
        sunlit=sample.sunlit,
        **arrays,
    )
    partial.replace(path)


def read_sample(path: Path) -> Sample:
    """What ``write_sample`` has written."""
    with np.load(path) as archive:
        values = {f.name: archive[f"start_{f.name}"] for f in fields(Start) if f.name != "margin_px"}
        start = Start(**values, margin_px=int(archive["start_margin_px"]))
        return Sample(start, archive["truth"], archive["visible"], archive["sunlit"])


def random_part(sample: Sample, size: tuple[int, int], rng: np.random.Generator) -> Sample:
    """A rectangle (h, w) around a pixel of the target; a smaller sample is enlarged with sky first."""
    sample = _at_least(sample, size)
    v, u = (int(i) for i in rng.choice(np.argwhere(sample.start.target)))
    h, w = sample.truth.shape
    top = int(np.clip(v - rng.integers(0, size[0]), 0, h - size[0]))
    first = int(np.clip(u - rng.integers(0, size[1]), 0, w - size[1]))
    return sample.part(slice(top, top + size[0]), slice(first, first + size[1]))


def _at_least(sample: Sample, size: Sequence[int]) -> Sample:
    h, w = sample.truth.shape
    more = (max(size[0] - h, 0), max(size[1] - w, 0))
    if more == (0, 0):
        return sample
    start = padded(sample.start, more)
    pads = ((0, more[0]), (0, more[1]))
    return Sample(
        start,
        np.pad(sample.truth, pads, constant_values=np.nan),
        np.pad(sample.visible, pads),
        np.pad(sample.sunlit, pads),
    )
