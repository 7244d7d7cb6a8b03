"""The loss of the disparity network: log density of the true disparity, and visibility."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from polhode.frontend.networks.disparity import DisparityMixture, mixture_from_outputs
from polhode.train.disparity.samples import DisparityBatch

_HIDDEN_WEIGHT = 0.15
"""Weight of pixels that the other camera does not see: only their surroundings determine them."""
_DARK_WEIGHT = 0.5
_NEAR_PX = 1.0
_NEAR_WEIGHT = 0.5
_OUTLIER_SHARE = 0.01
_OUTLIER_WIDTH_PX = 64.0
"""A share of the pixels is distributed uniformly over this width, so the loss of a single pixel is
bounded."""
_VISIBLE_WEIGHT = 0.3


@dataclass(frozen=True)
class LossPixels:
    """The pixels (n,) of a batch that the loss sums over: true target, or segmented as target."""

    truth: Tensor
    """[px]; NaN outside the target"""
    visible: Tensor
    lit: Tensor
    target: Tensor


def loss_pixels(raw: Tensor, batch: DisparityBatch) -> tuple[DisparityMixture, LossPixels]:
    """Distribution at these pixels, from the network's raw outputs (B, OUTPUTS, h, w), and the truth."""
    chosen = torch.isfinite(batch.truth) | batch.target
    outputs, guess = (tensor.permute(0, 2, 3, 1)[chosen] for tensor in (raw, batch.hypotheses))
    pixels = LossPixels(batch.truth[chosen], batch.visible[chosen], batch.lit[chosen], batch.target[chosen])
    return mixture_from_outputs(outputs, guess), pixels


def disparity_loss(mixture: DisparityMixture, pixels: LossPixels) -> Tensor:
    """Scalar loss: mean negative log density of the true disparity, mean negative log probability of its
    vicinity, and cross entropy of the visibility.
    """
    known = torch.isfinite(pixels.truth)
    truth = torch.where(known, pixels.truth, 0.0)
    density = mixture.log_density(truth).exp()
    cost = -torch.log((1.0 - _OUTLIER_SHARE) * density + _OUTLIER_SHARE / _OUTLIER_WIDTH_PX)
    # An error below one pixel is rewarded separately: a wrong surface is worse than a coarse fit of the right
    # one.
    near = mixture.mass_within(truth, torch.full_like(truth, _NEAR_PX))
    cost = cost - _NEAR_WEIGHT * torch.log((1.0 - _OUTLIER_SHARE) * near + _OUTLIER_SHARE)
    weight = known.float()
    weight = weight * torch.where(pixels.visible, 1.0, _HIDDEN_WEIGHT)
    weight = weight * torch.where(pixels.lit, 1.0, _DARK_WEIGHT)
    accuracy = (weight * cost).sum() / weight.sum().clamp(min=1.0)
    seen = functional.binary_cross_entropy_with_logits(
        mixture.visible, pixels.visible.float(), reduction="none"
    )
    segmented = pixels.target.float()
    return accuracy + _VISIBLE_WEIGHT * (seen * segmented).sum() / segmented.sum().clamp(min=1.0)
