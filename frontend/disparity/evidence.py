"""What the images say about each hypothesis of the disparity: the channels that the network sees.

The right image is warped to the left one by Kornia's differentiable remap, for a small slice of the cost
volume around the start and for each of its rivals.
"""

import numpy as np
import torch
from kornia.geometry.transform import remap
from numpy.typing import NDArray
from torch import Tensor

from polhode.frontend.disparity.start import Start

OFFSETS_PX = (-3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0)
"""Disparities of the slice, relative to the start."""
HYPOTHESES = 6
CHANNELS = len(OFFSETS_PX) + 2 * (HYPOTHESES - 1) + 16
_MOST_COST = 3.0
_GREY = 32.0
_RIVAL_PX = 8.0
_PLANE_PX = 16.0


def hypotheses(start: Start) -> Tensor:
    """(6, h, w) [px]: filled, far, near, unchecked, facet, coarse."""
    named = [start.filled, start.far, start.near, start.unchecked, start.facet, start.coarse]
    return torch.from_numpy(np.stack(named))


def evidence(start: Start) -> Tensor:
    """Channels (1, CHANNELS, h, w), each of order one."""
    guess = hypotheses(start)
    left = torch.from_numpy(np.ascontiguousarray(start.even_left))
    right = torch.from_numpy(np.ascontiguousarray(start.even_right))
    steps = torch.tensor(OFFSETS_PX)[:, None, None]
    warped = warp_right(right, torch.cat([guess[:1] + steps, guess[1:]]), start.margin_px)
    cost = (warped - left).abs().clamp(max=_MOST_COST)
    middle = OFFSETS_PX.index(0.0)
    difference = left - warped[middle]
    # Left minus warped falls with the slope of the right image: their product is what least squares sums.
    slope = warped[middle - 1] - warped[middle + 1]
    rivals = ((guess[1:] - guess[:1]) / _RIVAL_PX).clamp(-2.0, 2.0)
    channels = [
        cost,
        rivals,
        torch.stack([left, difference.clamp(-3.0, 3.0), (difference * slope).clamp(-4.0, 4.0), slope**2]),
        _grey(start, guess[:1]),
        _shape(guess[0], torch.from_numpy(np.ascontiguousarray(start.target))),
        _certainty(start),
    ]
    return torch.cat(channels)[None]


def warp_right(right: Tensor, disparity: Tensor, margin_px: int) -> Tensor:
    """The right image (h, w + 2 margin) seen from the left one, for k disparities (k, h, w) [px].

    Differentiable in both.
    """
    k, h, w = disparity.shape
    u = torch.arange(w, dtype=disparity.dtype) + margin_px - disparity
    v = torch.arange(h, dtype=disparity.dtype)[None, :, None].expand(k, h, w)
    # One tall image: the k maps below each other.
    warped: Tensor = remap(
        right[None, None],
        u.reshape(1, k * h, w),
        v.reshape(1, k * h, w),
        mode="bilinear",
        padding_mode="border",
        align_corners=True,
    )
    return warped.reshape(k, h, w)


def _grey(start: Start, disparity: Tensor) -> Tensor:
    """(2, h, w) brightness on a scale of ratios, and by how much the right image is brighter."""
    left = _log(torch.from_numpy(np.ascontiguousarray(start.left)))
    right = _log(torch.from_numpy(np.ascontiguousarray(start.right)))
    warped = warp_right(right, disparity, start.margin_px)
    return torch.stack([left - 1.0, warped[0] - left])


def _log(levels: Tensor) -> Tensor:
    return torch.log1p(levels.clamp(min=0.0) / _GREY)


def _shape(disparity: Tensor, target: Tensor) -> Tensor:
    """(3, h, w) the start itself, around its mean, and its slopes."""
    mean = disparity[target].mean() if bool(target.any()) else disparity.mean()
    du = torch.nn.functional.pad((disparity[:, 2:] - disparity[:, :-2]) / 2.0, (1, 1))
    dv = torch.nn.functional.pad((disparity[2:] - disparity[:-2]) / 2.0, (0, 0, 1, 1))
    around = ((disparity - mean) / _PLANE_PX).clamp(-2.0, 2.0)
    return torch.stack([around, (2.0 * du).clamp(-1.0, 1.0), (2.0 * dv).clamp(-1.0, 1.0)])


def _certainty(start: Start) -> Tensor:
    """(7, h, w) what is known of the start: matched, how uncertain, lit, target, rivals, facet."""
    known = np.isfinite(start.sigma)
    spread = np.log(np.clip(np.where(known, start.sigma, 2.0), 0.01, 2.0)) / 2.0
    reach = np.clip((start.near - start.far) / _RIVAL_PX, 0.0, 2.0)
    moved = np.clip(np.abs(start.unchecked - start.filled), 0.0, 2.0)
    flags: list[NDArray[np.generic]] = [
        known,
        spread,
        start.lit,
        start.target,
        reach,
        moved,
        start.facet_trust,
    ]
    return torch.from_numpy(np.stack([flag.astype(np.float32) for flag in flags]))
