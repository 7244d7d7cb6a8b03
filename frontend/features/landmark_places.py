"""Places of landmarks in the map of scores of the surface network."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from polhode.frontend.networks.surface import DenseOutput

APART_PX = 1
"""A landmark has the highest score within so many pixels along both axes [px]."""
MIN_SCORE = -2.2
"""Smallest logit of a landmark: a probability of a tenth."""
_SAME_PX = 0.75


@dataclass(frozen=True)
class Places:
    """n landmarks of one image, the highest score first."""

    uv_px: Tensor
    """(n, 2)"""
    log_sigma: Tensor
    """(n,) of the place, each axis [log px]"""
    score: Tensor
    """(n,) logit"""


def find_places(
    dense: DenseOutput, image: int, mask: Tensor, count: int, min_score: float = MIN_SCORE
) -> Places:
    """The ``count`` landmarks with the highest score on the mask (H, W) of an image of the batch."""
    score = dense.score[image]
    side = 2 * APART_PX + 1
    highest = functional.max_pool2d(score[None, None], side, 1, APART_PX)[0, 0]
    row, column = torch.nonzero((score >= highest) & mask & (score > min_score), as_tuple=True)
    value = score[row, column]
    order = value.argsort(descending=True, stable=True)[:count]
    row, column = row[order], column[order]
    offset = dense.offset_px[image, :, row, column].T
    uv = torch.stack([column, row], dim=1) + offset.clamp(-1.5, 1.5)
    return Places(uv, dense.log_sigma[image, row, column], value[order])
