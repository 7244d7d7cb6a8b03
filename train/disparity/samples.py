"""Training samples of disparity, cached on disk, and augmented batches of them.

A sample is the input of the network and the truth. Semi-global matching of a pair takes longer than a
training step, so it is done once for each pair. A pair gives two samples: the second is its mirror image with
exchanged cameras.

Batches contain random crops of samples. Data augmentation compensates for the small number of bodies: rows
are flipped, matches are removed as on a textureless panel, hypotheses are displaced, and one image is
brightened.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from polhode.atomic import replaced
from polhode.config.frontend import Depth
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.disparity.crop import Floats, cut_crop
from polhode.frontend.disparity.network_input import (
    InitialDisparity,
    fill_holes,
    hypotheses,
    initial_disparity,
    input_channels,
)
from polhode.frontend.rectification.rectify import Rectifier, make_rectifier
from polhode.frontend.rectification.target import target_mask
from polhode.records import Bools
from polhode.train.disparity.truth import TrueDisparity, true_disparities

_WIDEST_MARGIN_PX = 8.0
"""Largest margin of the search range around the true disparities."""


@dataclass(frozen=True)
class DisparitySample:
    """One crop (h, w) with its truth."""

    start: InitialDisparity
    truth: Floats
    """(h, w) disparity of the crop [px]; NaN outside the target"""
    visible: Bools
    """(h, w) both cameras see the surface"""

    def part(self, rows: slice, columns: slice) -> "DisparitySample":
        """The rectangle of the given rows and columns."""
        inner = (rows, columns)
        return DisparitySample(self.start.part(rows, columns), self.truth[inner], self.visible[inner])


def build_samples(folder: Path, cache: Path, config: Depth, seed: int, every: int = 1) -> list[Path]:
    """Files with the samples of every n-th pair of one sequence; a sequence in the cache is not matched
    again."""
    made: list[Path] = []
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
) -> DisparitySample | None:
    """The sample of pair k, or None: the target is out of view, or almost nothing matches."""
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
    start = initial_disparity(crop, config)
    if start is None:
        return None
    inner = crop.inner
    disparity = (truth.disparity[inner] - np.float32(crop.shift_px)).astype(np.float32)
    return DisparitySample(start, disparity, truth.visible[inner])


def write_sample(path: Path, sample: DisparitySample) -> None:
    """Write the whole file or nothing."""
    arrays = {f"start_{f.name}": getattr(sample.start, f.name) for f in fields(InitialDisparity)}
    truth = {"truth": sample.truth, "visible": sample.visible}
    with replaced(path) as partial:
        np.savez(partial, allow_pickle=False, **truth, **arrays)


def read_sample(path: Path) -> DisparitySample:
    """Read a file of ``write_sample``."""
    with np.load(path) as archive:
        values = {
            f.name: archive[f"start_{f.name}"] for f in fields(InitialDisparity) if f.name != "margin_px"
        }
        start = InitialDisparity(**values, margin_px=int(archive["start_margin_px"]))
        return DisparitySample(start, archive["truth"], archive["visible"])


def random_crop(sample: DisparitySample, size: tuple[int, int], rng: np.random.Generator) -> DisparitySample:
    """A rectangle (h, w) around a random pixel of the target; a smaller sample is first padded with sky."""
    sample = _pad_to(sample, size)
    v, u = (int(i) for i in rng.choice(np.argwhere(sample.start.target)))
    h, w = sample.truth.shape
    top = int(np.clip(v - rng.integers(0, size[0]), 0, h - size[0]))
    first = int(np.clip(u - rng.integers(0, size[1]), 0, w - size[1]))
    return sample.part(slice(top, top + size[0]), slice(first, first + size[1]))


def _pad_to(sample: DisparitySample, size: Sequence[int]) -> DisparitySample:
    h, w = sample.truth.shape
    more = (max(size[0] - h, 0), max(size[1] - w, 0))
    if more == (0, 0):
        return sample
    start = sample.start.padded(more)
    pads = ((0, more[0]), (0, more[1]))
    return DisparitySample(
        start,
        np.pad(sample.truth, pads, constant_values=np.nan),
        np.pad(sample.visible, pads),
    )


@dataclass(frozen=True)
class DisparityBatch:
    """Stacked crops, batch first."""

    channels: Tensor
    """(B, CHANNELS, h, w)"""
    hypotheses: Tensor
    """(B, 6, h, w) [px]"""
    truth: Tensor
    """(B, h, w) [px]; NaN outside the target"""
    visible: Tensor
    """(B, h, w) bool: both cameras see the surface"""
    lit: Tensor
    """(B, h, w) bool: bright enough for matching"""
    target: Tensor
    """(B, h, w) bool: the target by the front end's segmentation"""

    def tensors(self) -> dict[str, Tensor]:
        """The batch for the training loop; ``DisparityBatch(**tensors)`` is the inverse."""
        return dict(vars(self))


def random_batch(files: Sequence[Path], size: int, crop_px: int, rng: np.random.Generator) -> DisparityBatch:
    """``size`` augmented crops of random samples."""
    chosen = rng.choice(len(files), size, replace=len(files) < size)
    return stack([augment(random_crop(read_sample(files[i]), (crop_px, crop_px), rng), rng) for i in chosen])


def stack(samples: Sequence[DisparitySample]) -> DisparityBatch:
    """A batch of samples of equal size."""

    def joined(arrays: list[NDArray[np.generic]]) -> Tensor:
        return torch.from_numpy(np.stack(arrays))

    return DisparityBatch(
        torch.cat([input_channels(sample.start) for sample in samples]),
        torch.stack([hypotheses(sample.start) for sample in samples]),
        joined([sample.truth for sample in samples]),
        joined([sample.visible for sample in samples]),
        joined([sample.start.lit for sample in samples]),
        joined([sample.start.target for sample in samples]),
    )


def augment(sample: DisparitySample, rng: np.random.Generator) -> DisparitySample:
    """The sample with random changes that preserve or follow the truth."""
    if rng.random() < 0.5:
        sample = flip_rows(sample)
    start = sample.start
    if rng.random() < 0.5:
        start = remove_matches(start, int(rng.integers(1, 6)), rng)
    if rng.random() < 0.3:
        start = shift_by_plane(start, rng)
    if rng.random() < 0.5:
        gain = np.float32(rng.uniform(0.85, 1.15))
        start = replace(start, right=start.right * gain)
    return replace(sample, start=start)


def flip_rows(sample: DisparitySample) -> DisparitySample:
    """The sample with rows in reverse order, which preserves the epipolar lines."""

    def flipped(instance: object) -> dict[str, NDArray[np.generic]]:
        arrays = {k: v for k, v in vars(instance).items() if isinstance(v, np.ndarray)}
        return {name: np.ascontiguousarray(array[::-1]) for name, array in arrays.items()}

    return DisparitySample(start=replace(sample.start, **flipped(sample.start)), **flipped(sample))  # type: ignore[arg-type]


def remove_matches(start: InitialDisparity, count: int, rng: np.random.Generator) -> InitialDisparity:
    """Matches removed in ``count`` ellipses, and the holes filled again."""
    h, w = start.filled.shape
    hole = np.zeros((h, w), dtype=np.uint8)
    for _ in range(count):
        centre = (int(rng.integers(w)), int(rng.integers(h)))
        axes = (int(rng.integers(3, 30)), int(rng.integers(3, 30)))
        cv2.ellipse(hole, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
    known = np.isfinite(start.sigma) & (hole == 0)
    if known.sum() < 50:
        return start
    filled = fill_holes(np.where(known, start.filled, np.nan).astype(np.float32))
    sigma = np.where(known, start.sigma, np.nan).astype(np.float32)
    return replace(start, filled=filled, sigma=sigma)


def shift_by_plane(start: InitialDisparity, rng: np.random.Generator) -> InitialDisparity:
    """All hypotheses displaced by a random plane of about a pixel."""
    h, w = start.filled.shape
    v, u = np.mgrid[-0.5 : 0.5 : h * 1j, -0.5 : 0.5 : w * 1j]
    value, slope_u, slope_v = rng.normal(0.0, (0.5, 0.7, 0.7))
    plane = (value + slope_u * u + slope_v * v).astype(np.float32)
    names = ("filled", "far", "near", "unchecked", "facet", "coarse")
    return replace(start, **{name: getattr(start, name) + plane for name in names})
