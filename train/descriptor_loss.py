"""What makes descriptors good: each finds its partner among all others, and knows when it will not.

InfoNCE (van den Oord et al., "Representation learning with contrastive predictive coding", 2018), both ways.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from train.task import Batch

SAME_PX = 4.0
"""Points of one frame pair this close to each other are no negatives of one another [px]."""
START_TEMPERATURE = 0.07


class Temperature(nn.Module):
    """What similarities are divided by; learnt, and never below 0.02."""

    def __init__(self) -> None:
        super().__init__()
        self.logarithm = nn.Parameter(torch.tensor(START_TEMPERATURE).log())

    def forward(self) -> Tensor:
        return self.logarithm.exp().clamp(min=0.02)


def descriptor_loss(
    descriptors: Tensor, reliability: Tensor, batch: Batch, temperature: Tensor, weight: float
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss of a batch of ``PatchBatches``: descriptors (n, d), logits (n,) in the order of its patches."""
    m = len(batch["pair"])
    a, b, stray = descriptors[:m].float(), descriptors[m : 2 * m].float(), descriptors[2 * m :].float()
    same = _same_place(batch)
    forward = (a @ b.T).masked_fill(same, -1.0)
    backward = forward.T.masked_fill(same.T, -1.0)
    # Strays were found in the second frames: they compete with the second patches.
    logits_ab = torch.cat([forward, a @ stray.T], dim=1) / temperature
    logits_ba = backward / temperature
    truth = torch.arange(m, device=a.device)
    contrast = 0.5 * (functional.cross_entropy(logits_ab, truth) + functional.cross_entropy(logits_ba, truth))
    right = (logits_ab.argmax(dim=1) == truth) & (logits_ba.argmax(dim=1) == truth)
    label = torch.cat([right, right, right.new_zeros(len(stray))]).float()
    trust = functional.binary_cross_entropy_with_logits(reliability.float(), label)
    found = (logits_ab.argmax(dim=1) == truth).float().mean()
    return contrast + weight * trust, {
        "contrast": contrast,
        "reliability": trust,
        "rank_1": found,
        "temperature": temperature,
    }


def _same_place(batch: Batch) -> Tensor:
    """(m, m): pairs that show nearly the same point, themselves excepted."""
    together = batch["pair"][:, None] == batch["pair"][None, :]
    near = torch.zeros_like(together)
    for name in ("uv_a", "uv_b"):
        near |= torch.cdist(batch[name], batch[name]) < SAME_PX
    same: Tensor = together & near
    return same.fill_diagonal_(False)
