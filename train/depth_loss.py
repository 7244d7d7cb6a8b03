"""What the disparity network is asked for: a high density at the truth, and who is seen by both cameras."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from polhode.frontend.networks.disparity import Mixture, read_mixture
from polhode.train.depth_batches import DepthBatch

_HIDDEN_WEIGHT = 0.15
"""Of pixels that the other camera does not see: only their surroundings tell."""
_DARK_WEIGHT = 0.5
_NEAR_PX = 1.0
_NEAR_WEIGHT = 0.5
_WILD_SHARE = 0.01
_WILD_WIDTH_PX = 64.0
"""A hundredth of the pixels may lie anywhere: no single one costs without bound."""
_VISIBLE_WEIGHT = 0.3


@dataclass(frozen=True)
class Asked:
    """The pixels (n,) of a batch that the loss is made of: true target, or taken for it."""

    truth: Tensor
    """[px]; NaN beside the target"""
    visible: Tensor
    lit: Tensor
    target: Tensor


def asked_pixels(raw: Tensor, batch: DepthBatch) -> tuple[Mixture, Asked]:
    """What the network's raw outputs (B, OUTPUTS, h, w) say there, and the truth."""
    chosen = torch.isfinite(batch.truth) | batch.target
    outputs, guess = (tensor.permute(0, 2, 3, 1)[chosen] for tensor in (raw, batch.hypotheses))
    asked = Asked(batch.truth[chosen], batch.visible[chosen], batch.lit[chosen], batch.target[chosen])
    return read_mixture(outputs, guess), asked


def depth_loss(mixture: Mixture, asked: Asked) -> Tensor:
    """Mean negative log density of the true disparity and log probability near it, and cross entropy of the
    visibility; a scalar.
    """
    known = torch.isfinite(asked.truth)
    truth = torch.where(known, asked.truth, 0.0)
    density = mixture.log_density(truth).exp()
    cost = -torch.log((1.0 - _WILD_SHARE) * density + _WILD_SHARE / _WILD_WIDTH_PX)
    # Being within a pixel counts by itself: a wrong surface costs more than a coarse fit of the right one.
    near = mixture.mass_within(truth, torch.full_like(truth, _NEAR_PX))
    cost = cost - _NEAR_WEIGHT * torch.log((1.0 - _WILD_SHARE) * near + _WILD_SHARE)
    weight = known.float()
    weight = weight * torch.where(asked.visible, 1.0, _HIDDEN_WEIGHT)
    weight = weight * torch.where(asked.lit, 1.0, _DARK_WEIGHT)
    place = (weight * cost).sum() / weight.sum().clamp(min=1.0)
    seen = functional.binary_cross_entropy_with_logits(
        mixture.visible, asked.visible.float(), reduction="none"
    )
    taken = asked.target.float()
    return place + _VISIBLE_WEIGHT * (seen * taken).sum() / taken.sum().clamp(min=1.0)
