"""Batches for the disparity network: random rectangles of samples, spoiled a little.

Spoiling makes more of few bodies: rows are turned over, matched patches are cut out as a textureless panel
would lose them, the start is moved, and one image is made brighter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from polhode.frontend.disparity.evidence import evidence, hypotheses
from polhode.frontend.disparity.start import Start, fill_holes
from polhode.train.depth_samples import Sample, random_part, read_sample

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class DepthBatch:
    """Stacked rectangles, batch first."""

    channels: Tensor
    """(B, CHANNELS, h, w)"""
    hypotheses: Tensor
    """(B, 6, h, w) [px]"""
    truth: Tensor
    """(B, h, w) [px]; NaN beside the target"""
    visible: Tensor
    """(B, h, w) bool: both cameras see the surface"""
    lit: Tensor
    """(B, h, w) bool: bright enough to be matched"""
    target: Tensor
    """(B, h, w) bool: the target as the front end takes it"""

    def tensors(self) -> dict[str, Tensor]:
        """As the training loop carries it; ``DepthBatch(**tensors)`` is the way back."""
        return dict(vars(self))


def random_batch(files: Sequence[Path], size: int, crop_px: int, rng: np.random.Generator) -> DepthBatch:
    """``size`` rectangles of random samples."""
    chosen = rng.choice(len(files), size, replace=len(files) < size)
    return stack([spoil(random_part(read_sample(files[i]), (crop_px, crop_px), rng), rng) for i in chosen])


def stack(samples: Sequence[Sample]) -> DepthBatch:
    """Samples of one size as a batch."""

    def joined(arrays: list[NDArray[np.generic]]) -> Tensor:
        return torch.from_numpy(np.stack(arrays))

    return DepthBatch(
        torch.cat([evidence(sample.start) for sample in samples]),
        torch.stack([hypotheses(sample.start) for sample in samples]),
        joined([sample.truth for sample in samples]),
        joined([sample.visible for sample in samples]),
        joined([sample.start.lit for sample in samples]),
        joined([sample.start.target for sample in samples]),
    )


def spoil(sample: Sample, rng: np.random.Generator) -> Sample:
    """A harder sample of the same truth."""
    if rng.random() < 0.5:
        sample = upside_down(sample)
    start = sample.start
    if rng.random() < 0.5:
        start = with_holes(start, int(rng.integers(1, 6)), rng)
    if rng.random() < 0.3:
        start = moved(start, rng)
    if rng.random() < 0.5:
        gain = np.float32(rng.uniform(0.85, 1.15))
        start = replace(start, right=start.right * gain)
    return replace(sample, start=start)


def upside_down(sample: Sample) -> Sample:
    """Rows in the other order: epipolar lines stay lines."""

    def turned(thing: object) -> dict[str, NDArray[np.generic]]:
        arrays = {k: v for k, v in vars(thing).items() if isinstance(v, np.ndarray)}
        return {name: np.ascontiguousarray(array[::-1]) for name, array in arrays.items()}

    return Sample(start=replace(sample.start, **turned(sample.start)), **turned(sample))  # type: ignore[arg-type]


def with_holes(start: Start, count: int, rng: np.random.Generator) -> Start:
    """Matches taken out in ellipses, and the holes filled again."""
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


def moved(start: Start, rng: np.random.Generator) -> Start:
    """All hypotheses displaced by a plane of up to a pixel or so."""
    h, w = start.filled.shape
    v, u = np.mgrid[-0.5 : 0.5 : h * 1j, -0.5 : 0.5 : w * 1j]
    value, slope_u, slope_v = rng.normal(0.0, (0.5, 0.7, 0.7))
    plane = (value + slope_u * u + slope_v * v).astype(np.float32)
    names = ("filled", "far", "near", "unchecked", "facet", "coarse")
    return replace(start, **{name: getattr(start, name) + plane for name in names})
