"""What the disparity network is asked for: a high density at the truth, and who is seen by both cameras."""

import torch
from torch import Tensor
from torch.nn import functional

from frontend.networks.disparity import Mixture
from train.depth_batches import DepthBatch

_HIDDEN_WEIGHT = 0.15
"""Of pixels that the other camera does not see: only their surroundings tell."""
_DARK_WEIGHT = 0.3
_WILD_SHARE = 0.01
_WILD_WIDTH_PX = 64.0
"""A hundredth of the pixels may lie anywhere: no single one costs without bound."""
_VISIBLE_WEIGHT = 0.3


def depth_loss(mixture: Mixture, batch: DepthBatch) -> Tensor:
    """Mean negative log density of the true disparity, and cross entropy of the visibility; a scalar."""
    known = torch.isfinite(batch.truth)
    truth = torch.where(known, batch.truth, batch.hypotheses[:, 0])
    density = mixture.log_density(truth).exp()
    cost = -torch.log((1.0 - _WILD_SHARE) * density + _WILD_SHARE / _WILD_WIDTH_PX)
    weight = known.float()
    weight = weight * torch.where(batch.visible, 1.0, _HIDDEN_WEIGHT)
    weight = weight * torch.where(batch.lit, 1.0, _DARK_WEIGHT)
    place = (weight * cost).sum() / weight.sum().clamp(min=1.0)
    seen = functional.binary_cross_entropy_with_logits(
        mixture.visible, batch.visible.float(), reduction="none"
    )
    asked = batch.target.float()
    return place + _VISIBLE_WEIGHT * (seen * asked).sum() / asked.sum().clamp(min=1.0)
